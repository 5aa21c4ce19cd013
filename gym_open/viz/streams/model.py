"""The common form of logs and releases: streams of spans, where a span is a run of uninterrupted steps in one world."""

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.errors import UsageError
from gym_open.formats.logs import Stuck, Switch
from gym_open.viz.config import Choice

REWARD, LOSS, ENTROPY, VALUE, CONTACTS, ACTION = (
    "intrinsic_reward", "world_model_loss", "entropy", "value", "contacts", "action",
)  # fmt: skip
"""Series: numbers of each step, by their names in a recording."""
PART = "reward_part/"
"""Prefix of the names of parts of the intrinsic reward."""
SPAN_STEPS = 1000
"""Limit of steps in memory."""
PREVIEW_STEPS = 64
"""Steps that are read to find out what was recorded."""


class ShownSegment(NamedTuple):
    """A segment: uninterrupted steps in one world between switches."""

    number: int
    world: int
    steps: range
    """Steps of the stream."""
    ended: str | None
    """Reason of the end; None if the segment goes on after the end of the source."""
    loss_at_entry: float
    """Loss of the world at the start: infinite before its first visit, NaN if unknown."""
    loss_at_exit: float
    """Loss of the world at the end; NaN if unknown."""


class Span(msgspec.Struct, frozen=True, eq=False):
    """T uninterrupted steps in one world, and T + 1 observations."""

    segment: int
    world: int
    puzzle: Puzzle
    continued: bool
    """Whether the segment began with the last state of its world, not with the puzzle's layout."""
    first_step: int
    names: tuple[str, ...]
    states: np.ndarray
    """(T + 1, objects, 13)."""
    series: dict[str, np.ndarray]
    """Each (T,): action, reward, parts of the reward, loss, entropy, value, number of contacts."""
    pngs: Callable[[np.ndarray], list[bytes]]
    """Gives PNG files of the observations with these numbers, 0…T."""
    stuck: Sequence[Stuck]
    """Objects that got stuck or free again."""
    begins: bool
    """Whether this is the first shown span of its segment."""
    contacts: Sequence[tuple[Contact, ...]] | None = None
    """Contacts of each step; None if the source has only their number."""
    depth: np.ndarray | None = None
    """(T + 1, 84, 84) float32 metres, if recorded."""
    segmentation: np.ndarray | None = None
    """(T + 1, 84, 84) int32 geom ids, if recorded."""

    @property
    def steps(self) -> range:
        """Numbers of the steps in the stream."""
        return range(self.first_step, self.first_step + len(self.states) - 1)


class ShownStream(msgspec.Struct, frozen=True, eq=False):
    """One stream of a log or release, or its selected part."""

    number: int
    steps: range
    """Steps to show."""
    config: Mapping[str, Any]
    """Configuration of the exploration run."""
    worlds: int
    """Number of worlds in the pool."""
    reward_parts: tuple[str, ...]
    switches: Sequence[Switch]
    """All switches of the stream, also those outside `steps`."""
    segments: Sequence[ShownSegment]
    """All segments of the stream, also those outside `steps`."""
    known: frozenset[str]
    """Names of the series with data; see `known_of`."""
    spans: Callable[[range], Iterator[Span]]
    """Reads the spans of a range of steps."""
    depth: bool = False
    """Whether depth was recorded."""
    segmentation: bool = False
    """Whether segmentation was recorded."""
    geoms: Sequence[str] = ()
    """Names of the segmentation's geoms by number, if known."""
    damage: str | None = None
    """Why steps after the last one are missing; None if the source is complete."""

    @property
    def name(self) -> str:
        """Entity of the stream."""
        return f"stream_{self.number}"

    @property
    def threshold(self) -> float | None:
        """World-model loss below which a world counts as learned, if the curriculum uses the loss."""
        curriculum = self.config.get("curriculum")
        if not isinstance(curriculum, Mapping) or curriculum.get("rule") != "loss":
            return None
        threshold = curriculum.get("threshold")
        if not isinstance(threshold, int | float) or not abs(threshold) <= sys.float_info.max:  # refuses NaN, too
            return None
        return float(threshold)

    def shown_segments(self) -> list[ShownSegment]:
        """Segments with at least one shown step."""
        return [segment for segment in self.segments if overlap(segment.steps, self.steps)]

    def shown_switches(self) -> list[Switch]:
        """Switches within the shown steps, including a switch at their end."""
        return [item for item in self.switches if self.steps.start <= item.step <= self.steps.stop]

    def with_losses(self) -> list[Switch]:
        """Switches up to the end of the shown steps that have a loss of at least one world."""
        before = (item for item in self.switches if item.step <= self.steps.stop)
        return [item for item in before if any(map(math.isfinite, item.world_losses))]


def known_of(series: Mapping[str, np.ndarray]) -> frozenset[str]:
    """Names of the series with values other than NaN; a reward of only zeros counts only if it has parts."""
    known = {name for name, values in series.items() if not np.isnan(values).all()}
    has_parts = any(name.startswith(PART) for name in series)
    return frozenset(known if has_parts or series[REWARD].any() else known - {REWARD})


def overlap(a: range, b: range) -> range:
    """The steps in both ranges; empty if there are none."""
    return range(max(a.start, b.start), max(a.start, b.start, min(a.stop, b.stop)))


def chosen(streams: Iterable[ShownStream], choice: Choice, source: Path) -> list[ShownStream]:
    """Select streams, and cut them to the selected steps.

    Raises:
        UsageError: if there is no such stream, segment or step.
    """
    opened = list(streams)
    numbers = [stream.number for stream in opened]
    if choice.stream is not None and choice.stream not in numbers:
        raise UsageError(f"--stream: {source} has the streams {_listed(numbers)}, got {choice.stream}")
    picked = [stream for stream in opened if choice.stream in (None, stream.number)]
    cut = [msgspec.structs.replace(stream, steps=_steps(stream, choice)) for stream in picked]
    if found := [stream for stream in cut if stream.steps]:
        return found
    held = "; ".join(
        f"stream {stream.number}: steps {stream.steps.start}:{stream.steps.stop}, segments "
        f"{_listed([segment.number for segment in stream.segments])}"
        + "".join(
            f", of which {segment.number} is steps {segment.steps.start}:{segment.steps.stop}"
            for segment in stream.segments
            if segment.number == choice.segment
        )
        for stream in picked
    )
    raise UsageError(f"{source}: no step matches --segment and --steps; it has {held}")


def _steps(stream: ShownStream, choice: Choice) -> range:
    steps = stream.steps
    if choice.steps is not None:
        steps = overlap(steps, choice.steps)
    if choice.segment is not None:
        of_segment = [segment.steps for segment in stream.segments if segment.number == choice.segment]
        steps = overlap(steps, of_segment[0]) if of_segment else range(0)
    return steps


def _listed(numbers: Sequence[int]) -> str:
    """Describe a range of numbers, such as `0 to 3`, regardless of gaps."""
    return f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else ", ".join(map(str, numbers)) or "none"


def segments_of(first: ShownSegment, switches: Iterable[Switch], stop: int) -> list[ShownSegment]:
    """Derive the segments of a stream from its switches.

    Args:
        first: the first segment; only its number, world and first step are used.
        switches: switches in order.
        stop: end of the stream.
    """
    found: list[ShownSegment] = []
    number, world, start, entry = first.number, first.world, first.steps.start, math.nan
    for item in switches:
        if item.reason != "start":
            found.append(ShownSegment(number, world, range(start, item.step), item.reason, entry, _loss(item, world)))
            number, world, start = number + 1, item.to_world, item.step
        entry = _loss(item, item.to_world)
    if world >= 0 and start <= stop:
        found.append(ShownSegment(number, world, range(start, stop), None, entry, math.nan))
    return found


def _loss(switch: Switch, world: int) -> float:
    return switch.world_losses[world] if 0 <= world < len(switch.world_losses) else math.nan
