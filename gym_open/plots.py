"""Figures by matplotlib: one palette, one plain style, PNG files, coverage maps, and what to show without data.

A figure follows from its data alone: the user's own matplotlib settings do not count, and its file holds no date.
"""

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

BLUE, SKY, ORANGE, VERMILION, GREEN, PURPLE, YELLOW, BLACK, GREY = (
    "#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#F0E442", "#000000", "#777777",
)  # fmt: skip
"""Okabe and Ito's palette, which colour-blind readers can tell apart, and a grey."""
_AGENT_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, YELLOW, "#999999")
_AGENT_LINES = ("-", "--", "-.", ":")
_WEST, _NORTH = CELL_0[0] - PITCH / 2, CELL_0[1] + PITCH / 2
CELLS_EXTENT = (_WEST, _WEST + COLUMNS * PITCH, _NORTH - ROWS * PITCH, _NORTH)
"""West, east, south and north edge of the placement grid, in metres."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Three bytes of a colour that is given as `#RRGGBB`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def agent_style(number: int) -> tuple[str, str]:
    """Return colour and line style of the agent with this number; the ninth has the colour of the first again."""
    return _AGENT_COLOURS[number % len(_AGENT_COLOURS)], _AGENT_LINES[number % len(_AGENT_LINES)]


@contextmanager
def plain_style(settings: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Use matplotlib's default style, without top and right spines; a `$` in a name starts no formula.

    Args:
        settings: further matplotlib settings (`rcParams`), by name.
    """
    from matplotlib import style

    plain: dict[str, Any] = {"text.parse_math": False, "axes.spines.top": False, "axes.spines.right": False}
    with style.context(["default", {**plain, **(settings or {})}]):
        yield


def png(figure: "Figure") -> bytes:
    """The figure as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = io.BytesIO()
    FigureCanvasAgg(figure).print_png(out, metadata={"Software": None})
    return out.getvalue()


def draw_png(
    width: float,
    height: float,
    paint: "Callable[[Figure], None]",
    *,
    dpi: int = 110,
    settings: Mapping[str, Any] | None = None,
) -> bytes:
    """Draw a PNG file of `width` × `height` inches.

    Args:
        width: in inches. At 110 dpi, twelve inches are about as wide as Rerun shows them; it shrinks wider images
            without smoothing.
        height: in inches.
        paint: draws on the empty figure.
        dpi: pixels per inch.
        settings: as for `plain_style`.
    """
    from matplotlib.figure import Figure

    with plain_style(settings):
        figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
        paint(figure)
        return png(figure)


def finish(
    axes: "Axes", *, fontsize: int = 9, empty: str = "no data", legend: Literal["best", "upper left"] = "best"
) -> None:
    """Add a grid, remove top and right spines, and add a legend; without labels, show the text `empty` instead.

    `legend` is the legend's place.
    """
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=fontsize, loc=legend)
    elif empty:
        write_in_middle(axes, empty)


def write_in_middle(axes: "Axes", text: str = "no data") -> None:
    """Write a grey text in the middle of empty axes."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color=GREY)


def draw_coverage(
    axes: "Axes", values: np.ndarray, norm: "Normalize", *, hatch_colour: str = GREY, **image: Any
) -> "AxesImage":
    """Draw where the agent was, seen from above; cells with the value 0 are hatched.

    Args:
        axes: of the map.
        values: (rows, columns), far row first.
        norm: colour scale.
        hatch_colour: colour of the hatch.
        **image: options of `imshow`, for maps of other cells than those of the placement grid.
    """
    axes.patch.set(hatch="///", edgecolor=hatch_colour)
    shown = np.ma.masked_equal(values, 0)
    return axes.imshow(shown, cmap="cividis", norm=norm, **{"extent": CELLS_EXTENT, **image})


def coverage_image(counts: np.ndarray, size: int) -> np.ndarray:
    """Draw counts (rows, columns) as squares of `size` pixels on a log scale, 0 darkest: (H, W, 3) uint8."""
    from matplotlib import colormaps

    share = np.log1p(counts) / max(np.log1p(counts.max()), 1.0)
    cells = (255 * colormaps["viridis"](share)[..., :3]).astype(np.uint8)
    return cells.repeat(size, axis=0).repeat(size, axis=1)
