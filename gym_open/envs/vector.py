"""A vector environment: many worlds over one model, in threads instead of processes, without messages between them.

A thread takes a few worlds at a time, and steps and draws them in one compiled call. Timing decides which thread takes
which worlds. The result does not depend on timing, because no world depends on another.
"""

import operator
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array

from gym_open.envs import constants as c
from gym_open.envs.env import Look, ObservationMode, OpenEnv, show_states
from gym_open.envs.fleet import Fleet
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.stepper import StepOutcome
from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.generators import SandboxConfig
from gym_open.errors import UsageError

_PORTIONS = 4
"""Portions of worlds per thread and step: more portions balance the work better, fewer have less overhead."""


class OpenVectorEnv(VectorEnv[Any, np.ndarray, np.ndarray]):
    """N environments, each with its own puzzle: the same bits as N `OpenEnv` in a `SyncVectorEnv` with equal seeds.

    Infos have Gymnasium's vector form. `reset(options={"puzzles": [...]})` gives each world its own puzzle.

    Args:
        num_envs: number of worlds.
        task: see `OpenEnv`.
        sandbox: see `OpenEnv`.
        world: see `OpenEnv`.
        observation: see `OpenEnv`.
        rewards: see `OpenEnv`.
        render_mode: see `OpenEnv`.
        render_look: see `OpenEnv`.
        render_size: see `OpenEnv`.
        max_episode_steps: see `OpenEnv`.
        autoreset_mode: Gymnasium's `AutoresetMode`: what happens after the end of an episode.
        copy: whether `reset` and `step` return new arrays. If False, the next step overwrites the returned arrays.
        threads: number of threads that step worlds, with the caller's thread; None means one per usable core.

    Raises:
        UsageError: if an argument is out of bounds or not one of its choices.
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: Task = "sandbox",
        *,
        sandbox: SandboxConfig | None = None,
        world: WorldOptions | None = None,
        observation: ObservationMode = "image",
        rewards: bool = True,
        render_mode: str | None = None,
        render_look: Look = "observation",
        render_size: tuple[int, int] = (640, 480),
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        threads: int | None = None,
    ) -> None:
        for name, value in (("num_envs", num_envs), ("threads", threads)):
            if value is not None and value < 1:
                raise UsageError(f"{name}: expected 1 or more, got {value}")
        self.num_envs, self.copy, self.render_mode = num_envs, copy, render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**OpenEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.envs = [
            OpenEnv(
                task,
                sandbox=sandbox,
                world=world,
                observation=observation,
                rewards=rewards,
                render_mode=render_mode,
                render_look=render_look,
                render_size=render_size,
                max_episode_steps=max_episode_steps,
            )
            for _ in range(num_envs)
        ]
        one = self.envs[0]
        self.single_observation_space, self.single_action_space = one.observation_space, one.action_space
        self.observation_space = batch_space(one.observation_space, num_envs)
        self.action_space = batch_space(one.action_space, num_envs)
        self._fleet = Fleet([env.world for env in self.envs])
        self._observations: Any = create_empty_array(one.observation_space, num_envs)
        self._images = self._observations["image"] if observation == "dict" else self._observations
        self._present = np.zeros((num_envs, len(one.world.inventory)), bool)
        self._rewards = np.zeros(num_envs)
        self._terminations, self._truncations = np.zeros(num_envs, bool), np.zeros(num_envs, bool)
        self._actions = np.zeros(num_envs, np.int64)
        self._infos = _empty_infos(num_envs, len(one.world.inventory))
        self._last: list[tuple[Any, dict[str, Any]] | None] = [None] * num_envs
        self._everyone = np.ones(num_envs, bool)
        self._begun = False
        self._threads = min(threads or _cores(), num_envs)
        self._pool = ThreadPoolExecutor(self._threads, "world")
        size = -(-num_envs // (self._threads * _PORTIONS)) if self._threads > 1 else num_envs
        self._portions = [(i, min(i + size, num_envs)) for i in range(0, num_envs, size)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in each world.

        Args:
            seed: seed of the first world, and each further world has the next integer; or a list with one per world.
            options: `reset_mask`, (N,) bool: the worlds to reset; `puzzles`: one per world. All other options are
                passed to each world's `reset`.

        Raises:
            ValueError: if seeds, puzzles or mask do not have one entry per world.
            ResetNeeded: if the first reset does not reset all worlds.
            PuzzleError: if an option is refused.
            ClosedEnvironmentError: after `close`.
        """
        if self.closed:
            raise ClosedEnvironmentError("the worlds are closed: make a new vector environment")
        rest = dict(options or {})
        mask = np.asarray(rest.pop("reset_mask", self._everyone))
        puzzles = rest.pop("puzzles", None)
        seeds = _seeds(seed, self.num_envs)
        for name, given in (("seed", seeds), ("options['puzzles']", puzzles), ("options['reset_mask']", mask)):
            if given is not None and len(given) != self.num_envs:
                raise ValueError(f"{name}: expected {self.num_envs}, one for each world, got {len(given)}")
        if mask.dtype != bool:
            raise ValueError(f"options['reset_mask']: expected bool, got {mask.dtype}")
        if not (self._begun or mask.all()):
            raise ResetNeeded("options['reset_mask']: the first reset must reset all worlds")

        def work(first: int, last: int) -> None:
            for i in range(first, last):
                if mask[i]:
                    self._reset(i, seeds[i], rest if puzzles is None else {**rest, "puzzle": puzzles[i]})

        self._in_threads(work)
        self._begun = True
        self._terminations[mask], self._truncations[mask] = False, False
        return self._all_observations(), self._all_infos(mask)

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one step in each world, by (N,) integers. `autoreset_mode` decides what happens to finished worlds.

        Raises:
            ValueError: if the actions have another shape, are not integers, or are not all from 0 to 8.
            ResetNeeded: before the first `reset`, or if an ended world was not reset.
            ClosedEnvironmentError: after `close`.
        """
        self._actions[:] = self._checked(actions)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            self._actions[self._ended()] = -1
        self._in_threads(self._step_some)
        infos = self._all_infos(self._everyone)
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            for i in (self._terminations | self._truncations).nonzero()[0].tolist():
                observation, info = self._last[i] or (None, {})
                infos = self._add_info(infos, {"final_obs": observation, "final_info": info}, i)
        rewards, terminations = self._kept(self._rewards), self._kept(self._terminations)
        return self._all_observations(), rewards, terminations, self._kept(self._truncations), infos

    def render(self) -> tuple[np.ndarray | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The result of `render` of each world."""
        return tuple(env.render() for env in self.envs)

    def close_extras(self, **_: Any) -> None:
        """End the threads and close the worlds."""
        if not hasattr(self, "_pool"):
            return  # Gymnasium 1.2 also closes an object whose constructor raised
        self._pool.shutdown()
        for env in self.envs:
            env.close()

    def _step_some(self, first: int, last: int) -> None:
        """Step some of the worlds; worlds with a negative action are reset instead."""
        self._fleet.step(first, last, self._actions, self._images)
        for i in range(first, last):
            if self._actions[i] < 0:
                self._reset(i, None, {})
                self._rewards[i], self._terminations[i], self._truncations[i] = 0.0, False, False
                continue
            env = self.envs[i]
            outcome = env.world.stepper.outcome()
            self._rewards[i], terminated, truncated = env.score(outcome)
            self._terminations[i], self._truncations[i] = terminated, truncated
            if (terminated or truncated) and self.autoreset_mode == AutoresetMode.SAME_STEP:
                self._last[i] = env.observe(), env.info(outcome)
                self._reset(i, None, {})
                continue
            self._note(i, env.puzzle.digest, outcome)

    def _reset(self, i: int, seed: int | None, options: dict[str, Any]) -> None:
        env = self.envs[i]
        env.begin(seed, options)
        env.world.observe(self._images[i])
        env.world.object_state()  # also writes it to the board
        self._note(i, env.puzzle.digest, env.world.advance(0))

    def _note(self, i: int, digest: str, outcome: StepOutcome) -> None:
        infos = self._infos
        infos["puzzle_digest"][i] = digest
        infos["contacts"][i], infos["hits"][i] = outcome.contacts, outcome.hits
        infos["in_danger"][i] = outcome.in_danger

    def _all_infos(self, mask: np.ndarray) -> dict[str, Any]:
        """Infos of all worlds; `mask` marks the worlds whose infos are new."""
        self._infos["object_state"][:] = self._fleet.boards["states"]
        infos: dict[str, Any] = {}
        for name, values in self._infos.items():
            infos[name], infos[f"_{name}"] = self._kept(values), mask.copy()
        return infos

    def _ended(self) -> np.ndarray:
        """(N,) whether each episode has ended. The environments know it, also after a `restore`."""
        return np.array([env.ended for env in self.envs])

    def _kept(self, values: Any) -> Any:
        if not self.copy:
            return values
        return {name: array.copy() for name, array in values.items()} if isinstance(values, dict) else values.copy()

    def _all_observations(self) -> Any:
        """Observations of all worlds; the images are already written."""
        if isinstance(self._observations, dict):
            for i, env in enumerate(self.envs):
                self._present[i] = env.world.present
            show_states(self._fleet.boards["states"], self._present, self._observations["object_state"])
            self._observations["present"][:] = self._present
        return self._kept(self._observations)

    def _in_threads(self, work: Callable[[int, int], None]) -> None:
        """Call `work` for all worlds, one portion at a time, on all threads, and wait for the end."""
        portions = iter(self._portions)

        def run() -> None:
            for first, last in portions:  # the next free thread takes the next portion
                work(first, last)

        others = [self._pool.submit(run) for _ in range(self._threads - 1)]
        try:
            run()
        finally:
            for other in others:
                other.result()

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        if self.closed:
            raise ClosedEnvironmentError("the worlds are closed: make a new vector environment")
        if not self._begun:
            raise ResetNeeded("the worlds have no puzzle: call reset before step")
        if self.autoreset_mode == AutoresetMode.DISABLED and (over := self._ended()).any():
            ended = over.nonzero()[0].tolist()
            raise ResetNeeded(f'worlds {ended} have ended: reset them with options={{"reset_mask": …}} before step')
        given = np.asarray(actions)
        if given.shape != (self.num_envs,) or given.dtype.kind not in "iu":
            raise ValueError(
                f"actions: expected {self.num_envs} whole numbers, one for each world, got shape {given.shape} of "
                f"{given.dtype}"
            )
        wrong = (given < 0) | (given >= c.N_ACTIONS)
        if wrong.any():
            i = int(wrong.argmax())
            raise ValueError(f"actions: expected 0 to {c.N_ACTIONS - 1}, got {given[i]} for world {i}")
        return given


def _cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _empty_infos(n: int, objects: int) -> dict[str, np.ndarray]:
    return {
        "puzzle_digest": np.full(n, None),
        "object_state": np.zeros((n, objects, 13)),
        "contacts": np.full(n, None),
        "hits": np.full(n, None),
        "in_danger": np.zeros(n, bool),
    }


def _seeds(seed: int | Sequence[int | None] | None, n: int) -> list[int | None]:
    if seed is None:
        return [None] * n
    if isinstance(seed, (Sequence, np.ndarray)):
        return [None if one is None else operator.index(one) for one in seed]
    return [operator.index(seed) + i for i in range(n)]
