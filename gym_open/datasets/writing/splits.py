"""Train and val share no world (or no stream): never split by step, since neighbouring frames are near copies."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

from gym_open import seeding
from gym_open.datasets.config import ReleaseConfig
from gym_open.formats.releases.layout import SPLITS, Split

if TYPE_CHECKING:
    from gym_open.datasets.writing.sources import SourceStream

Unit = str
"""What is never in two splits: the digest of a layout, or the number of a stream."""


class Share(NamedTuple):
    """How much of something there is in a split."""

    episodes: int = 0
    frames: int = 0

    def plus(self, episodes: int, frames: int) -> "Share":
        """With so much more."""
        return Share(self.episodes + episodes, self.frames + frames)


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


def units_of(config: ReleaseConfig, streams: "Iterable[SourceStream]") -> set[Unit]:
    """All worlds that were visited, or all streams, as `config.split_by` says."""
    return {
        unit_of(config.split_by, stream.stream, stream.log.puzzles[switch.to_world].digest)
        for stream in streams
        for switch in stream.log.switches
        if switch.to_world >= 0
    }


def shares_of(
    config: ReleaseConfig, streams: "Iterable[SourceStream]", splits: Mapping[Unit, Split]
) -> dict[Split, Share]:
    """How many episodes and frames the streams make, told from their switches before anything else is read."""
    shares: dict[Split, Share] = {split: Share() for split in SPLITS}
    for stream in streams:
        for entered, left in zip(stream.log.switches, stream.log.switches[1:], strict=False):
            steps = left.step - entered.step
            pieces = max(1, -(-steps // config.max_episode_steps))
            puzzle = stream.log.puzzles[entered.to_world].digest
            split = splits[unit_of(config.split_by, stream.stream, puzzle)]
            shares[split] = shares[split].plus(pieces, steps + pieces)
    return shares
