"""Figures of a release: `figures/*.png`. Equal data give equal bytes: no dates, and no personal style settings.

Colours are those that colour-blind readers tell apart (Okabe and Ito; cividis), and a hatch or a number says the same.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gym_open.datasets.documents.facts import X_EDGES, Y_EDGES, ExplorerFacts, ReleaseFacts
from gym_open.envs.constants import IMAGE_SIZE
from gym_open.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, YELLOW, draw_coverage, plain_style, png
from gym_open.terminal import printable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ENDS = (
    (BLUE, ""), (ORANGE, "///"), (GREEN, "..."), (PURPLE, "xx"), (SKY, "\\\\\\"), (VERMILION, "oo"), (YELLOW, "--"),
    (GREY, "++"),
)  # fmt: skip
"""Colour and hatch of a reason why episodes end; after the last they come again."""
_ARROWS = ("stay", "→", "↗", "↑", "↖", "←", "↙", "↓", "↘")
"""Actions as the camera sees them: north points away from it."""
_SHOWN = 16
"""Largest number of explorers in a figure."""
_COLUMNS, _ZOOM, _GAP, _LABEL, _HEAD = 6, 2, 4, 110, 24
"""Contact sheet: images per row, magnification, and margins in pixels."""


def draw(facts: ReleaseFacts) -> dict[str, bytes]:
    """Draw all figures; return PNG files by name."""
    drawn: dict[str, Callable[[ReleaseFacts], Figure]] = {
        "frames": _contact_sheet, "coverage": _coverage, "actions": _actions, "episodes": _episodes,
    }  # fmt: skip
    with plain_style():
        return {f"{name}.png": png(make(facts)) for name, make in drawn.items()}


def _name(explorer: str) -> str:
    return printable(explorer).replace("\n", " ")[:24]


def _contact_sheet(facts: ReleaseFacts) -> "Figure":
    """Contact sheet with one row per explorer: frames from its worlds, spread over its time there."""
    from matplotlib.figure import Figure

    shown = facts.explorers[:_SHOWN]
    episodes = facts.release.episodes
    picks = [_pick(episodes[episodes["explorer"] == one.explorer]) for one in shown]
    images = facts.release.images(np.concatenate([numbers for numbers, _ in picks]))
    side = IMAGE_SIZE * _ZOOM
    width, height = _LABEL + _COLUMNS * (side + _GAP), len(shown) * (side + _GAP + _HEAD)
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    for row, (one, (numbers, worlds)) in enumerate(zip(shown, picks, strict=True)):
        bottom = height - (row + 1) * (side + _GAP + _HEAD) + _GAP
        figure.text(8 / width, (bottom + side / 2) / height, _name(one.explorer), va="center", fontsize=11)
        for column, (number, world) in enumerate(zip(numbers, worlds, strict=True)):
            left = _LABEL + column * (side + _GAP)
            image = images[row * _COLUMNS + column].repeat(_ZOOM, axis=0).repeat(_ZOOM, axis=1)
            figure.figimage(image, left, bottom, origin="upper")
            text = f"{world[:6]}, frame {number:,}"
            figure.text(left / width, (bottom + side + 6) / height, text, fontsize=8, color="#444444")
    return figure


def _pick(rows: "pd.DataFrame") -> tuple[np.ndarray, list[str]]:
    """Frame numbers and layouts for one row: all worlds equally often, at moments spread over the time in each."""
    worlds = list(dict.fromkeys(rows["puzzle"]))
    if len(worlds) > _COLUMNS:
        worlds = [worlds[i] for i in np.linspace(0, len(worlds) - 1, _COLUMNS).round().astype(int)]
    chosen = [worlds[i % len(worlds)] for i in range(_COLUMNS)]
    numbers = []
    for i, world in enumerate(chosen):
        spans = rows[rows["puzzle"] == world]
        ends = spans["length"].cumsum().to_numpy()
        within = int(ends[-1] * (i // len(worlds) + 1) / (-(-_COLUMNS // len(worlds)) + 1))
        episode = int(np.searchsorted(ends, within, side="right"))
        numbers.append(int(spans["dataset_to_index"].iloc[episode]) - int(ends[episode]) + within)
    return np.array(numbers, dtype=np.int64), chosen


def _coverage(facts: ReleaseFacts) -> "Figure":
    """Where the agent was: one panel per explorer, all on one scale."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    shown = facts.explorers[:_SHOWN]
    columns = min(len(shown), 4)
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(max(2.4 * columns, 3.6) + 1, 3.9 * rows + 0.4), dpi=100, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    shares = [one.visits / max(one.visits.sum(), 1) for one in shown]
    norm = LogNorm(min(share[share > 0].min() for share in shares) / 2, max(share.max() for share in shares))
    image = None
    for axes, one, share in zip(panels, shown, shares, strict=False):
        axes.set(title=_name(one.explorer), xlabel="x (m)")
        extent = (X_EDGES[0], X_EDGES[-1], Y_EDGES[0], Y_EDGES[-1])
        image = draw_coverage(axes, share, norm, hatch_colour="#BBBBBB", origin="lower", extent=extent)
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes in panels[::columns]:
        axes.set_ylabel("y (m)")
    assert image is not None
    bar = figure.colorbar(image, ax=list(panels), label="share of the frames (hatched: never there)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.3%}".rstrip("0%").rstrip(".") + "%")
    figure.suptitle("Where the agent was, seen from above\n(squares of 5 cm; camera at the bottom left)", fontsize=11)
    return figure


def _rows(axes: "Axes", shown: Sequence[ExplorerFacts]) -> None:
    """Label one row per explorer, from the top."""
    axes.set_yticks(range(len(shown)), [_name(one.explorer) for one in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)


def _actions(facts: ReleaseFacts) -> "Figure":
    """How often each action was taken, and how often the agent touched something."""
    from matplotlib.figure import Figure

    shown = facts.explorers[:_SHOWN]
    figure = Figure(figsize=(11.5, 1.6 + 0.5 * len(shown)), dpi=100, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1))
    shares = np.array([one.actions / max(one.actions.sum(), 1) for one in shown])
    left.imshow(shares, cmap="cividis", aspect="auto", vmin=0)
    for (row, column), share in np.ndenumerate(shares):
        dark = share < 0.45 * shares.max()
        left.text(column, row, f"{share:.0%}", ha="center", va="center", color="white" if dark else "black", fontsize=9)
    left.set(title="Actions taken: share of the steps")
    left.set_xticks(range(len(_ARROWS)), _ARROWS)
    left.spines[:].set_visible(False)
    _rows(left, shown)
    bars = right.barh(range(len(shown)), [one.touching / max(one.steps, 1) for one in shown], color=BLUE)
    right.bar_label(bars, [f"{one.touching / max(one.steps, 1):.1%}" for one in shown], padding=3, fontsize=9)
    right.set(title="Steps with a contact of the agent")
    right.xaxis.set_major_formatter(lambda value, _: f"{value:.3g}" if 0 < value < 0.01 else f"{value:.0%}")
    right.margins(x=0.18)
    _rows(right, shown)
    return figure


def _episodes(facts: ReleaseFacts) -> "Figure":
    """Why episodes ended, and how long they were."""
    from matplotlib.figure import Figure

    shown = facts.explorers[:_SHOWN]
    figure = Figure(figsize=(11, 2.2 + 0.5 * len(shown)), dpi=100, layout="constrained")
    left, right = figure.subplots(1, 2)
    start = np.zeros(len(shown))
    for number, reason in enumerate(sorted(facts.ended)):
        share = np.array([one.ended[reason] / one.episodes for one in shown])
        colour, hatch = _ENDS[number % len(_ENDS)]
        left.barh(
            range(len(shown)), share, left=start, color=colour, hatch=hatch, edgecolor="white", label=_name(reason)
        )
        start += share
    left.set(title="Why episodes ended: share of the episodes")
    left.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    left.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=9)
    right.boxplot(
        [one.lengths for one in shown], positions=range(len(shown)), orientation="horizontal", widths=0.5,
        whis=(0, 100), medianprops={"color": BLUE, "linewidth": 2.5}, manage_ticks=False,
    )  # fmt: skip
    right.set(
        title="Steps of an episode: range, middle half, median",
        xlim=(0, 1.05 * max(one.lengths.max() for one in shown)),
    )
    right.xaxis.set_major_formatter("{x:,.0f}")
    right.grid(axis="x", alpha=0.25, linewidth=0.6)
    for axes in (left, right):
        _rows(axes, shown)
    return figure
