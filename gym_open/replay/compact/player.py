"""Simulate the episodes of a compact release again, in threads.

An episode begins with the layout of its world, or where an earlier episode ended, perhaps of another stream. Threads
play episodes at the same time.
"""

import functools
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np

from gym_open.envs.recorder import record
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, GymOpenError
from gym_open.formats.compact import Compact
from gym_open.formats.compact.layout import EPISODES, EpisodeRow
from gym_open.formats.releases.frames import frame_numbers
from gym_open.hardware import usable_cores

T = TypeVar("T")


class Stored(NamedTuple):
    """What a compact release stores of an episode of T steps."""

    number: int
    """In the order in which episodes were played."""
    row: EpisodeRow
    actions: np.ndarray
    """(T,) uint8."""
    learned: dict[str, np.ndarray]
    """(T,) float32: the explorer's own values, by feature."""


class PlayedEpisode(msgspec.Struct, frozen=True, eq=False):
    """A simulated episode of T steps."""

    stored: Stored
    numbers: dict[str, np.ndarray]
    """All features except image and bookkeeping, with T + 1 rows each."""
    images: np.ndarray
    """(T + 1, 84, 84, 3) uint8; (0, …) if they were not drawn."""
    states: list[np.ndarray]
    """Integration state at each of the row's keyframes."""


def stored_episodes(compact: Compact, *, columns: bool = True) -> Iterator[Stored]:
    """Read what is stored of every episode, in the order in which they were played.

    Raises:
        ArtefactError: if a file is damaged.
    """
    with ExitStack() as files:
        actions = files.enter_context(compact.actions())
        names = compact.columns if columns else []
        learned = {name: files.enter_context(compact.column(name)) for name in names}
        for number, row in enumerate(compact.episodes):
            values = {name: file.take(row.steps) for name, file in learned.items()}
            yield Stored(number, row, actions.take(row.steps), values)


class CompactPlayer:
    """Plays episodes of one compact release, in any order. Its methods may be called by several threads.

    An episode that begins where another one ended needs that one's last state. If that one was not played yet, it is
    simulated without images, and so is what it continues itself.

    Raises:
        ArtefactError: if its objects are not those of this version's world.
    """

    def __init__(self, compact: Compact) -> None:
        self._compact = compact
        self._before = compact.before
        needed = {before for before in self._before if before is not None}
        self._ends: dict[int, Future[np.ndarray]] = {number: Future() for number in sorted(needed)}
        """Last state of each episode that another one continues: 3 kB."""
        self._begun: set[int] = set()
        """Numbers of those that a thread plays or has played."""
        self._lock = threading.Lock()
        given = iter(compact.states)
        self._given = {i: next(given) for i, row in enumerate(compact.episodes) if row.start == "state"}
        self._own = threading.local()
        there, expected = tuple(compact.release_info["gym_open"]["objects"]), World().inventory
        if there != expected:
            raise ArtefactError(
                f"{compact.root}: its {len(there)} objects are not the {len(expected)} of this version's world; use "
                "the version in its provenance"
            )

    def play(self, stored: Stored, *, images: bool = True) -> PlayedEpisode:
        """Simulate an episode.

        Raises:
            ArtefactError: if the actions or a stored state cannot be simulated.
        """
        with self._lock:
            self._begun.add(stored.number)
        try:
            played, end = self._play_from(stored, self._start_of(stored.number), images=images)
        except BaseException as error:
            self._finish(stored.number, error=error)
            raise
        self._finish(stored.number, end=end)
        return played

    def _finish(self, number: int, *, end: np.ndarray | None = None, error: BaseException | None = None) -> None:
        """Tell those that wait for the last state of an episode."""
        with self._lock:
            future = self._ends.get(number)
            if future is None or future.done():
                return
            if end is not None:
                future.set_result(end)
            else:
                future.set_exception(error)

    def _start_of(self, number: int) -> np.ndarray | None:
        """The state in which an episode begins; None for a layout."""
        before = self._before[number]
        if before is None:
            return self._given.get(number)
        chain: list[int] = []
        with self._lock:
            at: int | None = before
            while at is not None and at not in self._begun:
                self._begun.add(at)
                chain.append(at)
                at = self._before[at]
        for one in reversed(chain):  # each continues the one after it in the chain
            self.play(self._stored(one), images=False)
        return self._ends[before].result()

    def _stored(self, number: int) -> Stored:
        first, row = int(self._firsts[number]), self._compact.episodes[number]
        return Stored(number, row, self._actions[first : first + row.steps], {})

    @functools.cached_property
    def _firsts(self) -> np.ndarray:
        return np.cumsum([0, *(row.steps for row in self._compact.episodes)])

    @functools.cached_property
    def _actions(self) -> np.ndarray:
        with self._compact.actions() as file:
            return file.take(self._compact.info.steps)

    def _play_from(self, stored: Stored, start: np.ndarray | None, *, images: bool) -> tuple[PlayedEpisode, np.ndarray]:
        """Simulate an episode from a state, or from its layout, and return it and its last state."""
        row, world = stored.row, self._world()
        try:
            world.load(self._compact.puzzles[row.stream, row.world])
            if start is not None:
                world.restore_state(start)
            made = _record(world, stored, images=images)
        except GymOpenError as error:
            raise ArtefactError(
                f"{self._compact.root / EPISODES}: episode {stored.number} cannot be simulated: {error}"
            ) from error
        return made, world.save_state()

    def _world(self) -> World:
        """A world for this thread alone."""
        if not hasattr(self._own, "world"):
            self._own.world = World()
        return self._own.world


def _record(world: World, stored: Stored, *, images: bool) -> PlayedEpisode:
    """Take the actions in a world that is in the episode's first state."""
    states, frames = [world.object_state()[None]], [world.observe()[None]][: int(images)]
    contacts, impulses, kept = [np.empty((0, 2), np.int64)], [np.empty(0)], []
    at = 0
    for stop in [*stored.row.keyframes, stored.row.steps]:
        made = record(world, stored.actions[at:stop], images=images)
        states.append(made.states)
        contacts.append(made.contacts)
        impulses.append(made.impulses)
        frames.append(made.images)
        kept.append(world.save_state())
        at = stop
    numbers = frame_numbers(
        stored.actions.astype(np.int64), np.concatenate(states), world.inventory.index("agent"),
        np.concatenate(contacts), np.concatenate(impulses), stored.learned,
    )  # fmt: skip
    return PlayedEpisode(stored, numbers, np.concatenate(frames), kept[:-1])


def in_order(items: Iterable[Stored], task: Callable[[Stored], T], workers: int | None = None) -> Iterator[T]:
    """Do a task for every episode in threads, and return the results in order; few episodes are in memory."""
    threads = workers or usable_cores()
    waiting: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for item in items:
            waiting.append(pool.submit(task, item))
            if len(waiting) > threads + 1:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
