"""A stream in few images and means of its series, read once from start to end: the data of films and pages."""

import math
from typing import NamedTuple

import msgspec
import numpy as np

from gym_open import progress
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.pngs import decode_png
from gym_open.plots import BLUE, GREY, ORANGE
from gym_open.viz.streams.images import CoverageMap
from gym_open.viz.streams.model import ACTION, ENTROPY, LOSS, REWARD, VALUE, ShownStream, Span
from gym_open.viz.strip import Plot, PlotLine

_BINS = 800
"""Limit of points per line; each point is the mean over equally many steps."""


class ShownStep(NamedTuple):
    """One step that a film or page shows."""

    step: int
    world: int
    puzzle: Puzzle
    action: int | None
    """The action that follows; None at the end."""
    image: np.ndarray
    """Observation, (84, 84, 3) uint8."""
    state: np.ndarray
    """(objects, 13)."""
    names: tuple[str, ...]
    """Names of the objects."""
    coverage: np.ndarray
    """Steps in each cell so far, (16, 9), far row first."""


class StreamPreview(msgspec.Struct, frozen=True, eq=False):
    """Some steps of a stream, and its series as means."""

    stream: ShownStream
    every: int
    """Number of steps from one shown step to the next."""
    steps: list[ShownStep]
    series: dict[str, np.ndarray]
    """Means of each known series, (bins,), each over equally many steps; NaN where the values are unknown."""
    at: np.ndarray
    """First step of each bin, (bins,)."""

    def plots(self) -> list[Plot]:
        """Plots of reward, loss, the current world, and entropy and value, without unknown series."""
        width = len(self.stream.steps) / len(self.at)
        mean = f", means of {width:.0f} steps" if width >= 2 else ""
        found = list[Plot]()
        if REWARD in self.series:
            found.append(Plot(f"intrinsic reward{mean}", [self._line(REWARD, BLUE)]))
        if LOSS in self.series:
            found.append(Plot(f"world-model loss{mean}", [self._line(LOSS, BLUE)], level=self.stream.threshold))
        segments = [segment for segment in self.stream.shown_segments() if segment.steps]
        lane = PlotLine(
            np.array([step for segment in segments for step in (segment.steps.start, segment.steps.stop)]),
            np.array([segment.world for segment in segments for _ in range(2)]),
            GREY,
        )
        title = f"world of the pool, {len(segments)} segment{'s' * (len(segments) != 1)}"
        found.append(Plot(title, [lane], whole_numbers=True))
        names = {ENTROPY: (BLUE, "entropy (nats)", "-"), VALUE: (ORANGE, "value", "--")}
        known = [self._line(name, *names[name]) for name in names if name in self.series]
        return [*found, Plot(f"policy{mean}", known)] if known else found

    def _line(self, name: str, colour: str, label: str = "", style: str = "-") -> PlotLine:
        """A series as a line that holds each value until the next, and the last one until the stream ends."""
        values = self.series[name]
        return PlotLine(np.append(self.at, self.stream.steps.stop), np.append(values, values[-1]), colour, label, style)


class _BinnedSums:
    """Sums of series in bins of equally many steps."""

    def __init__(self, stream: ShownStream) -> None:
        self.start, self.total = stream.steps.start, len(stream.steps)
        self.bins = min(_BINS, self.total)
        self.sums = {name: np.zeros((2, self.bins)) for name in (REWARD, LOSS, ENTROPY, VALUE) if name in stream.known}

    def add(self, span: Span) -> None:
        """Add the finite values of a span."""
        where = (np.asarray(span.steps) - self.start) * self.bins // self.total
        for name, (sums, counts) in self.sums.items():
            finite = np.isfinite(span.series[name])
            np.add.at(sums, where[finite], span.series[name][finite])
            np.add.at(counts, where[finite], 1)

    def means(self) -> dict[str, np.ndarray]:
        """Means of each series, (bins,); NaN for bins without a finite value."""
        with np.errstate(invalid="ignore"):
            return {name: sums / counts for name, (sums, counts) in self.sums.items()}


def preview(stream: ShownStream, limit: int) -> StreamPreview:
    """Read a stream, or its selected part.

    Args:
        stream: the stream.
        limit: of shown steps: every k-th step, k = ceil(steps / limit), and the last one.

    Raises:
        ArtefactError: if the source is damaged, although it was not when it was opened.
    """
    steps, total = stream.steps, len(stream.steps)
    every = math.ceil(total / limit)
    sums, coverage, shown_steps = _BinnedSums(stream), CoverageMap(), list[ShownStep]()
    with progress.bar("read", total) as bar:
        for span in stream.spans(steps):
            sums.add(span)
            number = np.arange(len(span.steps))
            shown = number[(span.first_step + number - steps.start) % every == 0]
            if span.steps.stop == steps.stop:
                shown = np.append(shown, len(number))
            shown_steps += _shown_steps(span, shown, coverage)
            bar.advance(len(number))
    at = steps.start + np.arange(sums.bins) * total / sums.bins
    return StreamPreview(stream, every, shown_steps, sums.means(), at)


def others_named(others: int) -> str:
    """Say how many streams of the source are not shown, and which option shows them; empty if there are none."""
    return f"{others} other stream{'s' * (others != 1)}: --stream" if others else ""


def _shown_steps(span: Span, shown: np.ndarray, coverage: CoverageMap) -> list[ShownStep]:
    """The steps with the numbers `shown` (0…T) of a span; `coverage` counts all steps of the span."""
    places, counted, found = span.states[1:, span.names.index("agent")], 0, list[ShownStep]()
    for index, png in zip(shown.tolist(), span.pngs(shown) if shown.size else [], strict=True):
        coverage.add(places[counted:index])
        counted = index
        action = int(span.series[ACTION][index]) if index < len(places) else None
        found.append(
            ShownStep(
                step=span.first_step + index, world=span.world, puzzle=span.puzzle, action=action,
                image=decode_png(png), state=span.states[index], names=span.names, coverage=coverage.counts.copy(),
            )
        )  # fmt: skip
    coverage.add(places[counted:])
    return found
