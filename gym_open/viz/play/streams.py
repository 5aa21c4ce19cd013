"""Logs and releases as one thing to look at: streams of spans, a span being uninterrupted steps in one world."""

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
"""Numbers a step, by the names they have in a recording."""
PART = "reward_part/"
"""What a part of the intrinsic reward is called there, with its name after it."""
PIECE = 1000
"""Steps that are in memory at a time."""
GLANCE = 64
"""Steps that are read to see what is recorded at all."""


class Stay(NamedTuple):
    """A segment: steps in a world without interruption."""

    number: int
    world: int
    steps: range
    """Of the stream."""
    ended: str | None
    """None if it goes on behind what is here."""
    loss_at_entry: float
    """Loss of the world when it was entered: infinite if it never was before, NaN if not known."""
    loss_at_exit: float


class Span(msgspec.Struct, frozen=True, eq=False):
    """T steps and T + 1 observations."""

    segment: int
    world: int
    puzzle: Puzzle
    continued: bool
    """Whether the segment went on from where the world had been left."""
    first_step: int
    names: tuple[str, ...]
    states: np.ndarray
    """(T + 1, objects, 13)."""
    series: dict[str, np.ndarray]
    """Each (T,): action, reward, its parts, loss, entropy, value, number of contacts."""
    pngs: Callable[[np.ndarray], list[bytes]]
    """PNG files of the observations of these numbers, 0…T."""
    stuck: Sequence[Stuck]
    """What began or ceased to be stuck in it."""
    begins: bool
    """Whether the segment is shown from here on."""
    contacts: Sequence[tuple[Contact, ...]] | None = None
    """T of them, if what is looked at tells more than their number."""
    depth: np.ndarray | None = None
    """(T + 1, 84, 84) float32 metres, if recorded."""
    segmentation: np.ndarray | None = None
    """(T + 1, 84, 84) int32 geom ids, if recorded."""

    @property
    def steps(self) -> range:
        """Numbers of the steps in the stream."""
        return range(self.first_step, self.first_step + len(self.states) - 1)


class Stream(msgspec.Struct, frozen=True, eq=False):
    """One stream of play, or part of one."""

    number: int
    steps: range
    """Those to be shown."""
    config: Mapping[str, Any]
    """What made it."""
    worlds: int
    """Of the pool."""
    reward_parts: tuple[str, ...]
    switches: Sequence[Switch]
    """All of the stream."""
    stays: Sequence[Stay]
    """All of the stream."""
    known: frozenset[str]
    """Series that hold anything, as `known_of` tells of where the stream begins."""
    spans: Callable[[range], Iterator[Span]]
    """Those that hold these steps, cut to them."""
    depth: bool = False
    segmentation: bool = False
    """Whether they are recorded."""
    geoms: Sequence[str] = ()
    """What the geoms of a segmentation are called, by number, if that is known."""
    damage: str | None = None
    """Why nothing comes after the last step, if more was to come."""

    @property
    def name(self) -> str:
        """Entity that all of the stream is under."""
        return f"stream_{self.number}"

    @property
    def threshold(self) -> float | None:
        """World-model loss under which a world is learned, if the curriculum looks at it."""
        curriculum = self.config.get("curriculum")
        if not isinstance(curriculum, Mapping) or curriculum.get("rule") != "loss":
            return None
        threshold = curriculum.get("threshold")
        if not isinstance(threshold, int | float) or not abs(threshold) <= sys.float_info.max:  # NaN is not, either
            return None
        return float(threshold)

    def shown_stays(self) -> list[Stay]:
        """Segments that have a step among those to be shown."""
        return [stay for stay in self.stays if overlap(stay.steps, self.steps)]

    def shown_switches(self) -> list[Switch]:
        """Switches within the steps to be shown, the one at their end included."""
        return [item for item in self.switches if self.steps.start <= item.step <= self.steps.stop]

    def with_losses(self) -> list[Switch]:
        """Of all switches up to the end of what is shown, those that tell a loss of any world that was visited."""
        before = (item for item in self.switches if item.step <= self.steps.stop)
        return [item for item in before if any(map(math.isfinite, item.world_losses))]


def known_of(series: Mapping[str, np.ndarray]) -> frozenset[str]:
    """Names of the series that hold anything but NaN; the reward, if it is not 0 for want of any part."""
    known = {name for name, values in series.items() if not np.isnan(values).all()}
    has_parts = any(name.startswith(PART) for name in series)
    return frozenset(known if has_parts or series[REWARD].any() else known - {REWARD})


def overlap(a: range, b: range) -> range:
    """The steps that are in both; empty if none is."""
    return range(max(a.start, b.start), max(a.start, b.start, min(a.stop, b.stop)))


def chosen(streams: Iterable[Stream], choice: Choice, source: Path) -> list[Stream]:
    """The streams that `choice` picks, cut to the steps that it picks.

    Raises:
        UsageError: if there is no such stream, segment or step.
    """
    there = list(streams)
    numbers = [stream.number for stream in there]
    if choice.stream is not None and choice.stream not in numbers:
        raise UsageError(f"--stream: {source} has the streams {_listed(numbers)}, got {choice.stream}")
    picked = [stream for stream in there if choice.stream in (None, stream.number)]
    cut = [msgspec.structs.replace(stream, steps=_steps(stream, choice)) for stream in picked]
    if found := [stream for stream in cut if stream.steps]:
        return found
    held = "; ".join(
        f"stream {stream.number}: steps {stream.steps.start}:{stream.steps.stop}, segments "
        f"{_listed([stay.number for stay in stream.stays])}"
        + "".join(
            f", of which {stay.number} is steps {stay.steps.start}:{stay.steps.stop}"
            for stay in stream.stays
            if stay.number == choice.segment
        )
        for stream in picked
    )
    raise UsageError(f"{source}: nothing in it is what --segment and --steps pick; it holds {held}")


def _steps(stream: Stream, choice: Choice) -> range:
    steps = stream.steps
    if choice.steps is not None:
        steps = overlap(steps, choice.steps)
    if choice.segment is not None:
        of_segment = [stay.steps for stay in stream.stays if stay.number == choice.segment]
        steps = overlap(steps, of_segment[0]) if of_segment else range(0)
    return steps


def _listed(numbers: Sequence[int]) -> str:
    """Such as `0 to 3`; of any gap nothing is said."""
    return f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else ", ".join(map(str, numbers)) or "none"


def stays_of(first: Stay, switches: Iterable[Switch], stop: int) -> list[Stay]:
    """The segments that the switches of a stream make.

    Args:
        first: number, world and first step of the one that the switches begin in; the rest of it is not looked at.
        switches: in order.
        stop: where the stream ends.
    """
    found: list[Stay] = []
    number, world, start, entry = first.number, first.world, first.steps.start, math.nan
    for item in switches:
        if item.reason != "start":
            found.append(Stay(number, world, range(start, item.step), item.reason, entry, _loss(item, world)))
            number, world, start = number + 1, item.to_world, item.step
        entry = _loss(item, item.to_world)
    if world >= 0 and start <= stop:
        found.append(Stay(number, world, range(start, stop), None, entry, math.nan))
    return found


def _loss(switch: Switch, world: int) -> float:
    return switch.world_losses[world] if 0 <= world < len(switch.world_losses) else math.nan
