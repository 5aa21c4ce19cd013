"""A stream of play in few pictures and numbers, read once from end to end: what films and stills are made of."""

import math
from typing import NamedTuple

import msgspec
import numpy as np

from gym_open import progress
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.pngs import decode_png
from gym_open.plots import BLUE, GREY, ORANGE
from gym_open.viz.play.images import Coverage
from gym_open.viz.play.streams import ACTION, ENTROPY, LOSS, REWARD, VALUE, Span, Stream
from gym_open.viz.strip import Curve, Plot

_BINS = 800
"""Points of a curve at most: each is the mean of as many steps."""


class Moment(NamedTuple):
    """One step that is shown."""

    step: int
    world: int
    puzzle: Puzzle
    action: int | None
    """That follows; None at the end."""
    image: np.ndarray
    """(84, 84, 3) uint8."""
    state: np.ndarray
    """(objects, 13)."""
    names: tuple[str, ...]
    coverage: np.ndarray
    """(16, 9): steps in each cell until here, far row first."""


class Glance(msgspec.Struct, frozen=True, eq=False):
    """What is shown of a stream."""

    stream: Stream
    every: int
    """Each so many-th step is a moment."""
    moments: list[Moment]
    series: dict[str, np.ndarray]
    """Of each known series, means (bins,) of equally many steps; NaN where nothing is known."""
    at: np.ndarray
    """(bins,) the first step of each."""

    def plots(self) -> list[Plot]:
        """Reward and loss, which world the stream is in, entropy and value: what is known of them."""
        width = len(self.stream.steps) / len(self.at)
        mean = f", means of {width:.0f} steps" if width >= 2 else ""
        found = list[Plot]()
        if REWARD in self.series:
            found.append(Plot(f"intrinsic reward{mean}", [self._curve(REWARD, BLUE)]))
        if LOSS in self.series:
            found.append(Plot(f"world-model loss{mean}", [self._curve(LOSS, BLUE)], level=self.stream.threshold))
        stays = [stay for stay in self.stream.shown_stays() if stay.steps]
        lane = Curve(
            np.array([step for stay in stays for step in (stay.steps.start, stay.steps.stop)]),
            np.array([stay.world for stay in stays for _ in range(2)]),
            GREY,
        )
        found.append(Plot(f"world of the pool, {len(stays)} segment{'s' * (len(stays) != 1)}", [lane], counted=True))
        names = {ENTROPY: (BLUE, "entropy (nats)", "-"), VALUE: (ORANGE, "value", "--")}
        known = [self._curve(name, *names[name]) for name in names if name in self.series]
        return [*found, Plot(f"policy{mean}", known)] if known else found

    def _curve(self, name: str, colour: str, label: str = "", style: str = "-") -> Curve:
        """A series whose last value holds until the end of the last step, as each holds until the next."""
        values = self.series[name]
        return Curve(np.append(self.at, self.stream.steps.stop), np.append(values, values[-1]), colour, label, style)


class _Means:
    """Sums of series in bins of equally many steps."""

    def __init__(self, stream: Stream) -> None:
        self.start, self.total = stream.steps.start, len(stream.steps)
        self.bins = min(_BINS, self.total)
        self.sums = {name: np.zeros((2, self.bins)) for name in (REWARD, LOSS, ENTROPY, VALUE) if name in stream.known}

    def add(self, span: Span) -> None:
        """Add a span's steps; what is not finite counts nowhere."""
        where = (np.asarray(span.steps) - self.start) * self.bins // self.total
        for name, (sums, counts) in self.sums.items():
            there = np.isfinite(span.series[name])
            np.add.at(sums, where[there], span.series[name][there])
            np.add.at(counts, where[there], 1)

    def means(self) -> dict[str, np.ndarray]:
        """Of each series (bins,), NaN where nothing was known."""
        with np.errstate(invalid="ignore"):
            return {name: sums / counts for name, (sums, counts) in self.sums.items()}


def glance(stream: Stream, limit: int) -> Glance:
    """Read a stream, or the part of it that was picked.

    Args:
        stream: to be read.
        limit: of moments: every k-th step is one, k = ceil(steps / limit), and the last.

    Raises:
        ArtefactError: if it is damaged where it was not when it was opened.
    """
    steps, total = stream.steps, len(stream.steps)
    every = math.ceil(total / limit)
    means, coverage, moments = _Means(stream), Coverage(), list[Moment]()
    with progress.bar("read", total) as bar:
        for span in stream.spans(steps):
            means.add(span)
            number = np.arange(len(span.steps))
            shown = number[(span.first_step + number - steps.start) % every == 0]
            if span.steps.stop == steps.stop:
                shown = np.append(shown, len(number))
            moments += _moments(span, shown, coverage)
            bar.advance(len(number))
    at = steps.start + np.arange(means.bins) * total / means.bins
    return Glance(stream, every, moments, means.means(), at)


def others_named(others: int) -> str:
    """Words for the streams of the source that are not shown, and how to see them; none if there are none."""
    return f"{others} other stream{'s' * (others != 1)}: --stream" if others else ""


def _moments(span: Span, shown: np.ndarray, coverage: Coverage) -> list[Moment]:
    """Those of these numbers, 0…T of the span; all of its steps are counted in `coverage`."""
    places, done, found = span.states[1:, span.names.index("agent")], 0, list[Moment]()
    for index, png in zip(shown.tolist(), span.pngs(shown) if shown.size else [], strict=True):
        coverage.add(places[done:index])
        done = index
        action = int(span.series[ACTION][index]) if index < len(places) else None
        found.append(
            Moment(
                step=span.first_step + index, world=span.world, puzzle=span.puzzle, action=action,
                image=decode_png(png), state=span.states[index], names=span.names, coverage=coverage.counts.copy(),
            )
        )  # fmt: skip
    coverage.add(places[done:])
    return found
