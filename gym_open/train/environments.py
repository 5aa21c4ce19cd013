"""Vector environment for PPO: each environment draws its puzzles, resets itself, and can be saved and restored."""

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from gymnasium.vector import AutoresetMode

from gym_open import seeding
from gym_open.envs.env import EnvSnapshot
from gym_open.envs.options import WorldOptions
from gym_open.envs.puzzles import Task
from gym_open.envs.state import STATE_SIZE, state_vector
from gym_open.envs.vector import OpenVectorEnv


@dataclass(frozen=True)
class FinishedEpisode:
    """An episode that has ended."""

    total: float
    length: int
    success: bool
    """Whether it ended because the task was solved."""


@dataclass(frozen=True)
class VectorStep:
    """Result of one step of all environments; arrays (N,)."""

    rewards: np.ndarray
    terminations: np.ndarray
    truncations: np.ndarray
    last_seen: dict[int, np.ndarray]
    """Last observation of each truncated episode, by environment."""
    episodes: list[FinishedEpisode]
    """Episodes that ended in this step."""


class TrainingEnvironments:
    """N environments of one task in an `OpenVectorEnv`, with puzzles from the training distribution.

    Args:
        task: task of all environments.
        num_envs: N.
        seed: root seed of the puzzles.
        states: observe the simulator state instead of images.
        threads: number of threads that step the environments.
        world: options of their worlds; None means the published world.

    Attributes:
        seen: observations for the next actions, (N, 84, 84, 3) uint8 or (N, `STATE_SIZE`) float32.
    """

    def __init__(
        self, task: Task, num_envs: int, seed: int, *, states: bool = False, threads: int = 1,
        world: WorldOptions | None = None,
    ) -> None:  # fmt: skip
        self._venv = OpenVectorEnv(
            num_envs, task, world=world, autoreset_mode=AutoresetMode.DISABLED, copy=False, threads=threads
        )
        self._states = np.empty((num_envs, STATE_SIZE), np.float32) if states else None
        self.totals, self.lengths = np.zeros(num_envs), np.zeros(num_envs, dtype=np.int64)
        self._images, _ = self._venv.reset(seed=[seeding.integer(seed, "policy", "env", i) for i in range(num_envs)])
        self.seen = self._look()

    def step(self, actions: np.ndarray) -> VectorStep:
        """Take one action, (N,) int, per environment. Where an episode ends, `seen` is the first of the next one."""
        _, rewards, terminations, truncations, infos = self._venv.step(actions)
        after = VectorStep(rewards.astype(np.float32), terminations.copy(), truncations.copy(), {}, [])
        self.totals += rewards
        self.lengths += 1
        ended = terminations | truncations
        if ended.any():
            last = self._look()
            for i in ended.nonzero()[0].tolist():
                success = bool(terminations[i] and not infos["in_danger"][i])
                after.episodes.append(FinishedEpisode(float(self.totals[i]), int(self.lengths[i]), success))
                if truncations[i]:
                    after.last_seen[i] = last[i].copy()
            self.totals[ended], self.lengths[ended] = 0, 0
            self._venv.reset(options={"reset_mask": ended})
        self.seen = self._look()
        return after

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs, ready for JSON."""
        snapshots = [msgspec.to_builtins(env.snapshot()) for env in self._venv.envs]
        return {"envs": snapshots, "totals": self.totals.tolist(), "lengths": self.lengths.tolist()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned, bit for bit."""
        for i, (env, snapshot) in enumerate(zip(self._venv.envs, state["envs"], strict=True)):
            self._images[i] = env.restore(msgspec.convert(snapshot, EnvSnapshot))
        self.totals[:], self.lengths[:] = state["totals"], state["lengths"]
        self.seen = self._look()

    def _look(self) -> np.ndarray:
        """Current observations. The next step overwrites the same array."""
        if self._states is None:
            return self._images
        for i, env in enumerate(self._venv.envs):
            self._states[i] = state_vector(env.world)
        return self._states
