"""Play on one page: pictures through time, where the agent was, and the series."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from gym_open.envs.constants import CONTROL_DT_S, PITCH
from gym_open.plots import draw_coverage
from gym_open.viz.play.glance import Glance, glance, others_named
from gym_open.viz.play.streams import Stream
from gym_open.viz.strip import draw_plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

_PICTURES = 7
"""Pictures besides the last."""


def play_page(title: str, streams: Sequence[Stream]) -> tuple[float, float, "Callable[[Figure], None]"]:
    """Width and height in inches of the page of the first stream, and what draws it.

    Args:
        title: of the log or release, printable.
        streams: of which the others are only named.
    """
    play = glance(streams[0], _PICTURES)
    plots = play.plots()

    def paint(figure: "Figure") -> None:
        heights = [2, 1.45 * len(plots) + 0.3]
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
        above.suptitle(_heading(title, play, streams), fontsize=11, x=0.01, ha="left")
        _pictures(above, play)
        left, right = below.subfigures(1, 2, squeeze=False, width_ratios=[1, 3])[0]
        _coverage(left, play)
        axes = right.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
        for each, plot in zip(axes, plots, strict=True):
            draw_plot(each, plot, steps=True)
        axes[-1].set_xlim(play.stream.steps.start, play.stream.steps.stop)
        axes[-1].set_xlabel("steps of the stream")

    return 13.0, 2.6 + 1.7 * len(plots), paint


def _heading(title: str, play: Glance, streams: Sequence[Stream]) -> str:
    steps, others = play.stream.steps, len(streams) - 1
    words = f"{title}, stream {play.stream.number}: steps {steps.start:,} to {steps.stop - 1:,}"
    words += f", {len(steps) * CONTROL_DT_S:,.1f} s" if not play.stream.damage else ", then damaged"
    return words + (f" ({others_named(others)})" if others else "")


def _pictures(figure: "SubFigure", play: Glance) -> None:
    moments = play.moments[: _PICTURES + 1]
    for axes, moment in zip(figure.subplots(1, _PICTURES + 1), [*moments, *[None] * _PICTURES], strict=False):
        axes.set_axis_off()
        if moment:
            axes.imshow(moment.image)
            axes.set_title(f"step {moment.step:,}\nworld {moment.world}", fontsize=8)


def _coverage(figure: "SubFigure", play: Glance) -> None:
    """How long the agent was in each cell, on a log scale: in most it hardly ever is."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import NullFormatter

    counts = play.moments[-1].coverage.astype(float)
    most = max(counts.max(), 2)
    axes = figure.subplots()
    image = draw_coverage(axes, counts, LogNorm(1, most))
    axes.set_title(f"coverage: steps in cells of {100 * PITCH:.1f} cm", fontsize=9)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    axes.tick_params(labelsize=8)
    ticks = [1, most] if most < 10 else None  # of which there would be one
    bar = figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.6, format="{x:,.0f}", ticks=ticks)
    bar.ax.xaxis.set_minor_formatter(NullFormatter())  # else few counts get labels that want formulas
    bar.ax.tick_params(labelsize=8)
    bar.set_label("steps (hatched: never)", fontsize=8)
