"""A stream on one page: images over time, coverage, and series."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from gym_open.envs.constants import CONTROL_DT_S, PITCH
from gym_open.plots import draw_coverage
from gym_open.viz.streams.model import ShownStream
from gym_open.viz.streams.preview import StreamPreview, others_named, preview
from gym_open.viz.strip import draw_plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

_IMAGES = 7
"""Number of images, without the last one."""


def play_page(title: str, streams: Sequence[ShownStream]) -> tuple[float, float, "Callable[[Figure], None]"]:
    """Width and height in inches of the page of the first stream, and a function that draws it.

    Args:
        title: title of the log or release, printable.
        streams: the streams; the heading says how many others there are.
    """
    shown = preview(streams[0], _IMAGES)
    plots = shown.plots()

    def paint(figure: "Figure") -> None:
        heights = [2, 1.45 * len(plots) + 0.3]
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
        above.suptitle(_heading(title, shown, streams), fontsize=11, x=0.01, ha="left")
        _images(above, shown)
        left, right = below.subfigures(1, 2, squeeze=False, width_ratios=[1, 3])[0]
        _coverage(left, shown)
        axes = right.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
        for each, plot in zip(axes, plots, strict=True):
            draw_plot(each, plot, steps=True)
        axes[-1].set_xlim(shown.stream.steps.start, shown.stream.steps.stop)
        axes[-1].set_xlabel("steps of the stream")

    return 13.0, 2.6 + 1.7 * len(plots), paint


def _heading(title: str, shown: StreamPreview, streams: Sequence[ShownStream]) -> str:
    steps, others = shown.stream.steps, len(streams) - 1
    words = f"{title}, stream {shown.stream.number}: steps {steps.start:,} to {steps.stop - 1:,}"
    words += f", {len(steps) * CONTROL_DT_S:,.1f} s" if not shown.stream.damage else ", then damaged"
    return words + (f" ({others_named(others)})" if others else "")


def _images(figure: "SubFigure", shown: StreamPreview) -> None:
    steps = shown.steps[: _IMAGES + 1]
    for axes, step in zip(figure.subplots(1, _IMAGES + 1), [*steps, *[None] * _IMAGES], strict=False):
        axes.set_axis_off()
        if step:
            axes.imshow(step.image)
            axes.set_title(f"step {step.step:,}\nworld {step.world}", fontsize=8)


def _coverage(figure: "SubFigure", shown: StreamPreview) -> None:
    """Steps of the agent in each cell, on a log scale, because most cells have few."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import NullFormatter

    counts = shown.steps[-1].coverage.astype(float)
    most = max(counts.max(), 2)
    axes = figure.subplots()
    image = draw_coverage(axes, counts, LogNorm(1, most))
    axes.set_title(f"coverage: steps in cells of {100 * PITCH:.1f} cm", fontsize=9)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    axes.tick_params(labelsize=8)
    ticks = [1, most] if most < 10 else None  # the formatter would give only one tick
    bar = figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.6, format="{x:,.0f}", ticks=ticks)
    bar.ax.xaxis.set_minor_formatter(NullFormatter())  # labels of minor ticks would need formulas
    bar.ax.tick_params(labelsize=8)
    bar.set_label("steps (hatched: never)", fontsize=8)
