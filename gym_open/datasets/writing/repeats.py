"""Find streams that repeat each other: a log that continues another one, or the same run under two names."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gym_open.datasets.writing.sources import SourceStream
from gym_open.errors import UsageError
from gym_open.formats.releases import Release

_STEPS = 256
"""Number of steps at the beginning of each stream that are compared."""


class _Beginning(NamedTuple):
    """The beginning of a stream."""

    where: Path
    actions: np.ndarray
    """(T,) int64, T ≤ 256."""
    states: np.ndarray
    """(T + 1, D) float32: states of all objects."""

    def is_of(self, other: "_Beginning") -> bool:
        """Whether one of the two is the beginning of the other."""
        steps = min(len(self.actions), len(other.actions))
        return np.array_equal(self.actions[:steps], other.actions[:steps]) and np.array_equal(
            self.states[: steps + 1], other.states[: steps + 1]
        )


def check_distinct(streams: Sequence[SourceStream], after: Release | None) -> None:
    """Raise UsageError if two streams of one explorer begin with the same steps, so that episodes would occur twice.

    Args:
        streams: streams for a release.
        after: the release to which they are appended.
    """
    known: dict[tuple[str, str], list[_Beginning]] = {}
    for key, beginning in _of_release(after) if after else ():
        known.setdefault(key, []).append(beginning)
    for stream in streams:
        first = next(stream.log.segments(_STEPS), None)
        if first is None:
            continue
        states = first.object_state.astype(np.float32).reshape(len(first.object_state), -1)
        beginning = _Beginning(stream.log.path, first.actions, states)
        same = known.setdefault((stream.explorer, first.puzzle.digest), [])
        for other in same:
            if beginning.is_of(other):
                raise UsageError(
                    f"{stream.log.path}: begins with the same steps as {other.where}, by the same explorer; its "
                    "episodes would occur twice: give only the longer of the two"
                )
        same.append(beginning)


def _of_release(release: Release) -> Iterator[tuple[tuple[str, str], _Beginning]]:
    rows = release.episodes.sort_values("first_step").drop_duplicates("stream")
    for row in rows.to_dict("records"):
        first = row["dataset_from_index"]
        values = release.numbers(first, first + min(row["steps"], _STEPS) + 1)
        actions, states = values["action.index"][:-1], values["observation.environment_state"]
        yield (row["explorer"], row["puzzle"]), _Beginning(release.root, actions, states)
