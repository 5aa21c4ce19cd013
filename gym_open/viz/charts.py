"""Figures as PNG files, drawn by matplotlib as it comes, whatever a person's own settings."""

import io
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 110
"""At this, twelve inches are about as wide as they are shown: Rerun makes pictures smaller without smoothing."""


def png(width: float, height: float, paint: "Callable[[Figure], None]") -> bytes:
    """A PNG file of `width` × `height` inches that `paint` draws on; `$` in a name is no formula."""
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style.context(["default", {"text.parse_math": False, "axes.spines.top": False, "axes.spines.right": False}]):
        figure = Figure(figsize=(width, height), dpi=_DPI, layout="constrained")
        paint(figure)
        out = io.BytesIO()
        FigureCanvasAgg(figure).print_png(out, metadata={"Software": None})
        return out.getvalue()


def finish(axes: "Axes") -> None:
    """A grid, and a legend if anything has a label, or else the words that there is no data."""
    axes.grid(alpha=0.3, linewidth=0.6)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=9)
    else:
        axes.text(0.5, 0.5, "no data", transform=axes.transAxes, ha="center", color="#777777")
