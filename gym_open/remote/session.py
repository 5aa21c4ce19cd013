"""The paper's environment in this process: one world with the methods of the supplement."""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from gym_open.envs import constants as c
from gym_open.envs.physics.model import kind_of
from gym_open.envs.puzzles import TASKS, Puzzle
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.puzzles.puzzle_config import from_puzzle_config
from gym_open.envs.tasks import judge, rewarded, step_budget
from gym_open.envs.world import StepOutcome, World
from gym_open.errors import UsageError
from gym_open.remote.protocol import Debug, ObjectInformation, Observation, StepResult

# Model names and colour ids are the original's, as far as it has them.
_MODEL_NAME = {"heavy": "prim_cube", "light": "prim_cube", "rectangle": "prim_rectangle", "cone": "prim_cone"}
_SPHERE = "prim_sphere"
_COLOR_ID = {"heavy": 1, "light": 2, "agent": 3, "push": 4, "yellow": 6, "green": 8, "rectangle": 10, "cone": 11}
_HIT_COLOR_ID = {"yellow": 7, "green": 9}

Draw = Callable[[np.random.Generator], Puzzle]


class Session:
    """One world with the paper's methods. A wrong argument raises UsageError or PuzzleError, and changes nothing."""

    def __init__(self, *, debug: bool = False) -> None:
        self._world = World()
        self._masses = [float(self._world.model.body(name).mass[0]) for name in self._world.inventory]
        self._debug = debug
        self._rng, _ = seeding.np_random(None)
        self._draw: Draw | None = None
        """Draws a puzzle of the last requested kind."""
        self._images = False
        self._rewards = True
        self._skip_frame = True
        self._substeps_left = 0
        """Substeps left in the current move; only without `skip_frame`."""
        self._fresh = True
        self._steps = 0
        self._hit: set[str] = set()
        self._done = False

    def change_puzzle(self, mode: Any, task: Any, puzzle_config: Any) -> None:
        """Draw a puzzle and lay it out: a sandbox by `puzzle_config` (mode 0), or one of the tasks 1–4 (mode 1)."""
        draw = _draw(mode, task, puzzle_config)
        self._begin(draw(self._rng))
        self._draw = draw

    def set_observation(self, output: Any) -> None:
        """Set whether observations hold the image; they always hold the objects' states."""
        self._images = _flag("set_observation: output", output)

    def configure(self, first: Any, action_space: Any, skip_frame: Any) -> None:
        """Set whether a step is a whole move or one substep."""
        if first is not False:
            raise UsageError(f"configure_env: first argument: expected False, as in the paper, got {first!r}")
        if action_space != "full":
            raise UsageError(f"configure_env: action_space: expected 'full' (nine actions), got {action_space!r}")
        skip_frame = _flag("configure_env: skip_frame", skip_frame)
        if self._substeps_left and skip_frame:
            raise UsageError(
                f"configure_env: skip_frame: a move is unfinished, {self._substeps_left} substeps of it are left; "
                "step to its end, or reset, first"
            )
        self._skip_frame = skip_frame

    def turn_off_reward(self, off: Any) -> None:
        """Turn rewards off: then rewards are 0, no episode ends, and goals keep their colours.

        Goals' colours change with the next layout. Before the first step of an episode, this is the current layout.
        """
        self._rewards = not _flag("turn_off_reward: value", off)
        if self._draw and self._fresh:
            self._begin(self._world.puzzle)

    def reset(self, seed: Any = None) -> Observation:
        """Start the same puzzle again; with a seed, start a puzzle of the same kind, determined by the seed."""
        draw = self._known()
        if seed is None:
            self._begin(self._world.puzzle)
        else:
            self._rng, _ = seeding.np_random(_whole("reset: seed", seed, 0, 2**63 - 1))
            self._begin(draw(self._rng))
        return self._observe()

    def step(self, action: Any) -> StepResult:
        """Take a step. After the end of an episode, the world goes on, rewards are 0, and done stays true."""
        self._known()
        task = self._world.puzzle.task
        action = _whole("step: action", action, 0, c.N_ACTIONS - 1)
        self._fresh = False
        if self._substeps_left == 0:
            self._steps += 1
        outcome = self._world.step(action) if self._skip_frame else self._substep(action)
        reward, truncated = 0.0, False
        if self._rewards and rewarded(task) and not self._done:
            verdict = judge(task, self._world.puzzle, len(self._hit), outcome)
            out_of_budget = self._steps >= step_budget(task) and self._substeps_left == 0
            reward, truncated = verdict.reward, out_of_budget and not verdict.terminated
            self._done = verdict.terminated or truncated
        self._hit.update(outcome.hits)
        done = self._done and self._rewards
        return self._observe(), reward, done, self._note(outcome, truncated)

    def warm_up(self) -> None:
        """Take a step and an observation, so that all code is compiled."""
        self._begin(sample_puzzle("avoidance", self._rng))
        self._world.step(1)
        self._world.observe()

    def close(self) -> None:
        """Do nothing: this process holds no session on a server."""

    def _substep(self, action: int) -> StepOutcome:
        """Simulate one substep, of the current move, of a new move, or without a move."""
        speed = self._world.data.qvel
        if self._substeps_left == 0 and action != 0:
            speed[0] += c.MOVE_SPEED * c.MOVES[action][0]
            speed[1] += c.MOVE_SPEED * c.MOVES[action][1]
            self._substeps_left = c.SUBSTEPS
        outcome = self._world.advance(1)
        if self._substeps_left:
            self._substeps_left -= 1
            if self._substeps_left == 0:  # as at the end of `World.step`
                speed[:6] = 0, 0, min(speed[2], 0.0), 0, 0, 0
        return outcome

    def _known(self) -> Draw:
        if self._draw is None:
            raise UsageError("there is no puzzle yet: call add_change_puzzle first")
        return self._draw

    def _begin(self, puzzle: Puzzle) -> None:
        self._world.load(puzzle, recolour_hits=self._recolours(puzzle))
        self._fresh, self._done = True, False
        self._steps = self._substeps_left = 0
        self._hit = set()

    def _recolours(self, puzzle: Puzzle) -> bool:
        return self._rewards and rewarded(puzzle.task)

    def _observe(self) -> Observation:
        world = self._world
        states = world.object_state().tolist()
        found = {
            i: self._object(name, states[i], self._masses[i])
            for i, name in enumerate(world.inventory)
            if world.present[i]
        }
        if not self._images:
            return {"object_information": found}
        return {"image": world.observe(), "object_information": found}

    def _object(self, name: str, state: list[float], mass: float) -> ObjectInformation:
        kind = kind_of(name)
        changed = name in self._hit and self._recolours(self._world.puzzle)
        x, y, z, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz = state
        return {
            "position": (x, y, z),
            "rotation": (qw, qx, qy, qz),
            "velocity": (vx, vy, vz),
            "angular_velocity": (wx, wy, wz),
            "mass": mass,
            "model_name": _MODEL_NAME.get(kind, _SPHERE),
            "color_id": _HIT_COLOR_ID[kind] if changed else _COLOR_ID[kind],
        }

    def _note(self, outcome: StepOutcome, truncated: bool) -> Debug:
        puzzle = self._world.puzzle
        note: Debug = {
            "puzzle_digest": puzzle.digest,
            "hits": outcome.hits,
            "in_danger": outcome.in_danger,
            "truncated": truncated,
        }
        if self._debug:
            note["contacts"], note["puzzle"] = outcome.contacts, puzzle
        return note


def _draw(mode: Any, task: Any, puzzle_config: Any) -> Draw:
    if mode == 0:
        if task not in (None, 0, 1):
            raise UsageError(f"add_change_puzzle: task: expected none or 0 for a sandbox (mode 0), got {task!r}")
        if not isinstance(puzzle_config, dict):
            raise UsageError(
                "add_change_puzzle: puzzle_config: mode 0 (sandbox) needs a dictionary of counts, for example "
                f"{{'main_sphere': 1, 'touch_sphere': 2, 'cube': 2}}, got {puzzle_config!r}"
            )
        return lambda rng: from_puzzle_config(puzzle_config, rng)
    if mode == 1:
        if puzzle_config is not None:
            raise UsageError(
                "add_change_puzzle: puzzle_config: only for mode 0 (sandbox); leave it out, tasks have recipes"
            )
        chosen = TASKS[_whole("add_change_puzzle: task", task, 1, len(TASKS)) - 1]
        return lambda rng: sample_puzzle(chosen, rng)
    raise UsageError(f"add_change_puzzle: mode: expected 0 (sandbox) or 1 (one of the tasks 1-4), got {mode!r}")


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise UsageError(f"{name}: expected True or False, got {value!r}")
    return value


def _whole(name: str, value: Any, least: int, most: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or not least <= number <= most:
        raise UsageError(f"{name}: expected a whole number from {least} to {most}, got {value!r}")
    return number
