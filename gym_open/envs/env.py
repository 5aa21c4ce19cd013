"""The Gymnasium environments: one class, five ids."""

from typing import Any, ClassVar

import gymnasium
import msgspec
import numpy as np
from gymnasium import spaces

from gym_open.envs import constants as c
from gym_open.envs.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzles import Puzzle, PuzzleError, Task
from gym_open.envs.tasks import judge, rewarded, step_budget
from gym_open.envs.world import World


class EnvSnapshot(msgspec.Struct, frozen=True):
    """All that an environment's future depends on, as plain data that JSON keeps exactly."""

    puzzle: Puzzle
    world: list[float]
    """`World.save_state`."""
    steps: int
    """Steps taken in this episode."""
    episode_return: float
    """Rewards of this episode so far."""
    hits: int
    """Goals hit in this episode."""
    rng: dict[str, Any]
    """State of the generator that draws puzzles."""


class OpenEnv(gymnasium.Env[np.ndarray, np.int64]):
    """A puzzle on the table, seen as an (84, 84, 3) uint8 image and played with nine actions.

    Each reset draws a new training puzzle, or takes `options={"puzzle": Puzzle}`. `info` names the layout's digest and,
    after a step, the goals hit in it. The sandbox pays nothing and never ends; the tasks are truncated at their budget.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / c.CONTROL_DT_S),
    }

    def __init__(
        self, task: Task = "sandbox", *, sandbox: SandboxConfig | None = None, render_mode: str | None = None
    ) -> None:
        self.task: Task = task
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
        self.action_space = spaces.Discrete(c.N_ACTIONS)
        self.world = World()
        self._sandbox = sandbox or SandboxConfig()
        self._steps = 0
        self._return = 0.0
        self._hits = 0

    @property
    def puzzle(self) -> Puzzle:
        """The puzzle being played."""
        return self.world.puzzle

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode on a drawn puzzle, or on `options["puzzle"]`.

        Raises:
            PuzzleError: if an option is unknown, or its puzzle is none or another task's.
        """
        super().reset(seed=seed)
        self._begin(self._chosen(options or {}) or sample_puzzle(self.task, self.np_random, self._sandbox))
        return self.world.observe(), {"puzzle_digest": self.puzzle.digest}

    def step(self, action: np.int64 | int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take one action: 0 nothing, 1–8 a move of one cell (1 is +x, then counter-clockwise)."""
        outcome = self.world.step(int(action))
        verdict = judge(self.task, self.puzzle, self._hits, outcome)
        self._steps += 1
        self._hits += len(outcome.hits)
        self._return += verdict.reward
        out_of_budget = self.task != "sandbox" and self._steps >= step_budget(self.task)
        truncated = out_of_budget and not verdict.terminated
        info = {"puzzle_digest": self.puzzle.digest, "hits": outcome.hits, "in_danger": outcome.in_danger}
        return self.world.observe(), verdict.reward, verdict.terminated, truncated, info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The observation once more, for `render_mode="rgb_array"`."""
        return self.world.observe() if self.render_mode == "rgb_array" else None

    def snapshot(self) -> EnvSnapshot:
        """All that is needed to go on from here, bit for bit, in another process."""
        state = self.np_random.bit_generator.state
        return EnvSnapshot(
            puzzle=self.puzzle,
            world=self.world.save_state().tolist(),
            steps=self._steps,
            episode_return=self._return,
            hits=self._hits,
            rng=dict(state),
        )

    def restore(self, snapshot: EnvSnapshot) -> np.ndarray:
        """Go back to a snapshot and return the observation there."""
        self._begin(snapshot.puzzle)
        self.world.restore_state(np.array(snapshot.world))
        self._steps, self._return, self._hits = snapshot.steps, snapshot.episode_return, snapshot.hits
        self.np_random.bit_generator.state = snapshot.rng
        return self.world.observe()

    def _begin(self, puzzle: Puzzle) -> None:
        self.world.load(puzzle, recolour_hits=rewarded(self.task))
        self._steps, self._return, self._hits = 0, 0.0, 0

    def _chosen(self, options: dict[str, Any]) -> Puzzle | None:
        if unknown := set(options) - {"puzzle"}:
            raise PuzzleError(f"reset options: unknown {sorted(unknown)}; the only one is 'puzzle'")
        puzzle = options.get("puzzle")
        if puzzle is not None and not isinstance(puzzle, Puzzle):
            raise PuzzleError(f"reset option 'puzzle': expected a Puzzle, got {type(puzzle).__name__}")
        if puzzle is not None and puzzle.task != self.task:
            raise PuzzleError(
                f"reset option 'puzzle': one of task {puzzle.task!r} given to a {self.task!r} environment"
            )
        return puzzle
