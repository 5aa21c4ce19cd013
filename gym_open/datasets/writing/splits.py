"""Train and val share no world (or no stream): never split by step, since neighbouring frames are near copies."""

from collections.abc import Iterable, Mapping
from typing import Literal

from gym_open import seeding
from gym_open.formats.releases.layout import Split

Unit = str
"""What is never in two splits: the digest of a layout, or the number of a stream."""


def unit_of(split_by: Literal["stream", "world"], stream: int, puzzle: str) -> Unit:
    """The unit that a stream's segment in the layout `puzzle` belongs to."""
    return puzzle if split_by == "world" else str(stream)


def assign(
    units: Iterable[Unit], val_fraction: float, seed: int, known: Mapping[Unit, Split] | None = None
) -> dict[Unit, Split]:
    """Split of every unit: `known` ones stay where they are, new ones are drawn among themselves by the seed.

    `val_fraction` of the new ones, rounded half up, go to val; one at least of all is in train, and one in val if there
    are two or more and `val_fraction` is not 0.
    """
    known = known or {}
    new = sorted(set(units) - set(known))
    least = int(val_fraction > 0 and len(new) + len(known) > 1 and "val" not in known.values())
    most = len(new) - ("train" not in known.values())
    count = max(0, min(max(int(val_fraction * len(new) + 0.5), least), most))
    order = seeding.generator(seed, "release", "val").permutation(len(new))
    held = {new[i] for i in order[:count]}
    return {**known, **{unit: "val" if unit in held else "train" for unit in new}}
