"""Train and val share no world (or no stream): never split by step, since neighbouring frames are near copies."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal

from gym_open import seeding
from gym_open.datasets.config import ReleaseConfig

if TYPE_CHECKING:
    from gym_open.formats.logs.reader import Log

Split = Literal["train", "val"]


def held_out(config: ReleaseConfig, logs: "Sequence[Log]") -> frozenset[str]:
    """Layout digests (or stream numbers, as text) that make up val.

    `val_fraction` of those that were visited, rounded half up, chosen by the seed; one at least stays in train.
    """
    units = sorted(set(_units(config, logs)))
    count = min(int(config.val_fraction * len(units) + 0.5), len(units) - 1)
    order = seeding.generator(config.seed, "release", "val").permutation(len(units))
    return frozenset(units[i] for i in order[: max(count, 0)])


def _units(config: ReleaseConfig, logs: "Sequence[Log]") -> Iterable[str]:
    for log in logs:
        if config.split_by == "stream":
            yield str(log.stream)
        else:
            yield from (log.puzzles[switch.to_world].digest for switch in log.switches if switch.to_world >= 0)


def split_of(config: ReleaseConfig, stream: int, puzzle: str, val: frozenset[str]) -> Split:
    """The split of a stream's segment whose layout digest is `puzzle`."""
    return "val" if (puzzle if config.split_by == "world" else str(stream)) in val else "train"
