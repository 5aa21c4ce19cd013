"""Environments side by side for PPO: each draws its puzzles, begins anew by itself, and can be snapshot."""

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from gym_open import seeding
from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.env import EnvSnapshot, OpenEnv
from gym_open.envs.puzzles import Task


@dataclass(frozen=True)
class Episode:
    """One attempt at a puzzle that has ended."""

    total: float
    length: int
    success: bool
    """It ended because its task was done: it terminated with more reward than nothing."""


@dataclass(frozen=True)
class Transitions:
    """What one action of every environment led to; arrays (N,)."""

    rewards: np.ndarray
    terminations: np.ndarray
    truncations: np.ndarray
    last_images: dict[int, np.ndarray]
    """Last picture of each episode that was truncated, by environment."""
    episodes: list[Episode]
    """Episodes that ended."""


class Tables:
    """N environments of one task, stepped in a loop; puzzles come from the training distribution.

    Like gymnasium's `SyncVectorEnv` with `SAME_STEP` autoreset, without its copies, and with snapshots.

    Attributes:
        images: what the next actions will be taken on, (N, 84, 84, 3) uint8.
    """

    def __init__(self, task: Task, num_envs: int, seed: int) -> None:
        self.envs = [OpenEnv(task) for _ in range(num_envs)]
        self.images = np.empty((num_envs, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
        self.totals, self.lengths = np.zeros(num_envs), np.zeros(num_envs, dtype=np.int64)
        for i, env in enumerate(self.envs):
            self.images[i], _ = env.reset(seed=seeding.integer(seed, "policy", "env", i))

    def step(self, actions: np.ndarray) -> Transitions:
        """Act once in every environment, (N,) int; where an episode ends, `images` is the first of the next one."""
        n = len(self.envs)
        rewards, terminations, truncations = np.zeros(n, np.float32), np.zeros(n, bool), np.zeros(n, bool)
        last_images, episodes = {}, []
        for i, (env, action) in enumerate(zip(self.envs, actions.tolist(), strict=True)):
            image, reward, terminations[i], truncations[i], _ = env.step(action)
            rewards[i] = reward
            self.totals[i] += float(reward)
            self.lengths[i] += 1
            if terminations[i] or truncations[i]:
                success = bool(terminations[i]) and self.totals[i] > 0
                episodes.append(Episode(float(self.totals[i]), int(self.lengths[i]), success))
                self.totals[i], self.lengths[i] = 0, 0
                if truncations[i]:
                    last_images[i] = image.copy()
                image, _ = env.reset()
            self.images[i] = image
        return Transitions(rewards, terminations, truncations, last_images, episodes)

    def state(self) -> dict[str, Any]:
        """Everything that going on needs, JSON-ready."""
        snapshots = [msgspec.to_builtins(env.snapshot()) for env in self.envs]
        return {"envs": snapshots, "totals": self.totals.tolist(), "lengths": self.lengths.tolist()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave, bit for bit."""
        for i, (env, snapshot) in enumerate(zip(self.envs, state["envs"], strict=True)):
            self.images[i] = env.restore(msgspec.convert(snapshot, EnvSnapshot))
        self.totals[:], self.lengths[:] = state["totals"], state["lengths"]
