"""Assign worlds (or streams) to train and val. Splits never go by step, since neighbouring frames are near copies."""

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

from gym_open import seeding
from gym_open.formats.releases.layout import Split

Unit = str
"""A unit is never in two splits: the digest of a layout, or the number of a stream."""


class Share(NamedTuple):
    """Number of episodes and frames."""

    episodes: int = 0
    frames: int = 0

    def plus(self, episodes: int, frames: int) -> "Share":
        """The sum with more episodes and frames."""
        return Share(self.episodes + episodes, self.frames + frames)


def unit_of(split_by: Literal["stream", "world"], stream: int, puzzle: str) -> Unit:
    """The unit of a stream's segment in the layout `puzzle`."""
    return puzzle if split_by == "world" else str(stream)


def assign(
    units: Iterable[Unit], val_fraction: float, seed: int, known: Mapping[Unit, Split] | None = None
) -> dict[Unit, Split]:
    """Assign a split to every unit: `known` units keep theirs, and the seed draws the splits of new units.

    `val_fraction` of the new units, rounded half up, go to val. At least one of all units is in train; at least one is
    in val if there are two or more units and `val_fraction` is not 0.
    """
    known = known or {}
    new = sorted(set(units) - set(known))
    least = int(val_fraction > 0 and len(new) + len(known) > 1 and "val" not in known.values())
    most = len(new) - ("train" not in known.values())
    count = max(0, min(max(int(val_fraction * len(new) + 0.5), least), most))
    order = seeding.generator(seed, "release", "val").permutation(len(new))
    held = {new[i] for i in order[:count]}
    return {**known, **{unit: "val" if unit in held else "train" for unit in new}}
