"""Plots below a film's image: they are drawn once, and only a cursor moves."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from gym_open.plots import VERMILION, plain_style, write_in_middle
from gym_open.viz.film import PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DPI = 100
_CURSOR = (25, 25, 25)


class PlotLine(msgspec.Struct, frozen=True, eq=False):
    """A line of a plot."""

    x: np.ndarray
    y: np.ndarray
    colour: str
    """As matplotlib names it."""
    label: str = ""
    style: str = "-"
    """As matplotlib names it."""


class Plot(msgspec.Struct, frozen=True, eq=False):
    """Lines over one axis of steps, with an optional threshold."""

    title: str
    """With the unit."""
    lines: list[PlotLine]
    level: float | None = None
    """The threshold."""
    whole_numbers: bool = False
    """Whether the values are whole numbers."""


def draw_plot(axes: "Axes", plot: Plot, *, steps: bool = False) -> None:
    """Draw one plot, without values that are not finite; if none is finite, a text says so.

    Args:
        axes: where to draw.
        plot: what to draw.
        steps: whether the axis counts steps, so that each value holds until the next.
    """
    drawn = False
    for line in plot.lines:
        if np.isfinite(line.y).any():
            drawn = True
            axes.plot(
                line.x, line.y, line.style, color=line.colour, label=line.label or None, linewidth=1.4,
                markersize=3, drawstyle="steps-post" if steps else "default",
            )  # fmt: skip
    if plot.level is not None:
        axes.axhline(plot.level, color=VERMILION, linestyle="--", linewidth=1.2, label="threshold")
    if not drawn:
        write_in_middle(axes)
    if steps:
        axes.locator_params(axis="x", integer=True)
    if plot.whole_numbers:
        axes.locator_params(axis="y", integer=True)
        axes.margins(y=0.2)
        axes.set_ylim(min(axes.get_ylim()[0], -0.5), max(axes.get_ylim()[1], 1.5))
    axes.set_title(plot.title, fontsize=9, loc="left")
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0)


class Strip:
    """Plots one below the other, over one axis of steps."""

    def __init__(self, plots: Sequence[Plot], width: int, height: int, span: tuple[float, float], label: str) -> None:
        """Draw the plots.

        Args:
            plots: from top to bottom.
            width: width of the strip in pixels.
            height: height of one plot in pixels.
            span: first and last step.
            label: label of the axis of steps.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        with plain_style():
            figure = Figure(
                figsize=(width / _DPI, height * len(plots) / _DPI), dpi=_DPI, layout="constrained",
                facecolor="#{:02x}{:02x}{:02x}".format(*PAPER),
            )  # fmt: skip
            rows: list[Axes] = list(figure.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0])
            for axes, plot in zip(rows, plots, strict=True):
                draw_plot(axes, plot, steps=True)
                axes.set_xlim(span[0], max(span[1], span[0] + 1))
            rows[-1].set_xlabel(label, fontsize=8)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        self._strip = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        boxes = [axes.get_window_extent() for axes in rows]
        tall = len(self._strip)
        self._areas = [(int(box.x0), int(box.x1), tall - int(box.y1), tall - int(box.y0)) for box in boxes]
        self._span = span[0], max(span[1], span[0] + 1)

    def at(self, step: float) -> np.ndarray:
        """The strip with its cursor at a step, (plots × height, width, 3) uint8."""
        strip = self._strip.copy()
        share = np.clip((step - self._span[0]) / (self._span[1] - self._span[0]), 0, 1)
        for left, right, top, bottom in self._areas:
            x = left + round(share * (right - left))
            strip[top:bottom, max(x - 1, 0) : x + 1] = _CURSOR
        return strip
