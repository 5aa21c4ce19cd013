"""Figures of a report, like the paper's: SVG files that depend only on the numbers.

Colour-blind readers can distinguish the colours (Okabe and Ito); dashes and markers work without colour.
"""

import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from gym_open.evaluate.report.numbers import ReportCell, ReportNumbers, steps
from gym_open.plots import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, plain_style
from gym_open.results.records import IntervalCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLES = (
    (BLUE, "-", "o"), (VERMILION, "--", "s"), (GREEN, "-.", "^"), (PURPLE, ":", "D"), (ORANGE, (0, (6, 1.5)), "v"),
    (SKY, (0, (3, 1, 1, 1, 1, 1)), "P"), (BLACK, (0, (1, 1)), "X"),
)  # fmt: skip
"""Colour, dash and marker of a trained agent; after the last, colours repeat with the next dash and marker."""
_FIXED = {"random": (GREY, (0, (1, 2))), "oracle": (GREY, "-"), "human": (GREY, (0, (8, 3)))}
"""Colour and dash of untrained agents."""
_INCHES = (4.4, 2.7)
"""Width and height of the axes with their labels; on a phone, the text is still legible."""
_LINE_INCHES = 0.19
"""Height of a line of the legend."""


class ReportFigure(NamedTuple):
    """One figure."""

    name: str
    svg: bytes
    title: str
    text: str
    """What the figure shows, for readers who cannot see it."""


def draw(results: ReportNumbers) -> list[ReportFigure]:
    """Draw mean return against actions for every task, and A-Success against steps if there are checkpoints."""
    styles = _styles(results.agents)
    made = []
    for task in results.tasks:
        cells = [cell for cell in results.cells if cell.task == task]
        made.append(
            ReportFigure(
                f"return-{task}.svg",
                _svg(f"return-{task}", len(cells), lambda axes, c=cells: _returns(axes, c, styles)),
                f"{task}: mean return within a number of actions",
                _ends(cells, "mean return within all actions", [cell.returns for cell in cells]),
            )
        )
        learned = [cell for cell in cells if len(cell.learning.x) > 1]
        if learned:
            fixed = [cell for cell in cells if cell.agent in _FIXED]
            shown = learned + fixed
            made.append(
                ReportFigure(
                    f"learning-{task}.svg",
                    _svg(f"learning-{task}", len(shown), lambda axes, c=shown: _learning(axes, c, styles)),
                    f"{task}: A-Success against steps of fine-tuning",
                    _ends(learned, "A-Success after the last step", [cell.learning for cell in learned]),
                )
            )
    return made


def _styles(agents: Sequence[str]) -> dict[str, tuple[str, object, str]]:
    trained = [agent for agent in agents if agent not in _FIXED]
    styles = {}
    for i, agent in enumerate(trained):
        again, place = divmod(i, len(_STYLES))
        styles[agent] = (_STYLES[place][0], *_STYLES[(place + again) % len(_STYLES)][1:])
    return styles | {agent: (*style, "") for agent, style in _FIXED.items()}


def _ends(cells: Sequence[ReportCell], what: str, bands: Sequence[IntervalCurve]) -> str:
    values = (f"{cell.agent} {band.value[-1]:.3f}" for cell, band in zip(cells, bands, strict=True))
    return f"{what}: {', '.join(values)}"


def _returns(axes: "Axes", cells: Sequence[ReportCell], styles: dict[str, tuple[str, object, str]]) -> None:
    axes.set(xlabel="actions", ylabel="mean return")
    for cell in cells:
        _band(axes, cell.returns, cell.agent, styles[cell.agent], marked=False)
    axes.set_xlim(0, max(cell.returns.x[-1] for cell in cells))


def _learning(axes: "Axes", cells: Sequence[ReportCell], styles: dict[str, tuple[str, object, str]]) -> None:
    from matplotlib.ticker import FuncFormatter

    axes.set(xlabel="steps of fine-tuning", ylabel="A-Success")
    for cell in cells:
        if cell.agent in _FIXED:
            colour, dash, _ = styles[cell.agent]
            axes.axhline(cell.score.value, color=colour, linestyle=dash, linewidth=1, label=cell.agent)  # pyright: ignore[reportArgumentType]
        else:
            _band(axes, cell.learning, cell.agent, styles[cell.agent], marked=True)
    axes.set_xlim(left=0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: steps(value)))


def _band(axes: "Axes", band: IntervalCurve, agent: str, style: tuple[str, object, str], *, marked: bool) -> None:
    colour, dash, marker = style
    axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.13, linewidth=0)
    axes.plot(
        band.x, band.value, color=colour, linestyle=dash, label=agent, linewidth=1.6,  # pyright: ignore[reportArgumentType]
        marker=marker if marked else "", markersize=4.5,
    )  # fmt: skip


def _svg(name: str, lines: int, paint: "Callable[[Axes], None]") -> bytes:
    # Text stays text, and the hash salt makes equal figures equal files.
    with plain_style({"svg.fonttype": "none", "svg.hashsalt": name, "font.size": 10, "font.family": "sans-serif"}):
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure

        width, height = _INCHES
        figure: Figure = Figure(figsize=(width, height + _LINE_INCHES * -(-lines // 2)), layout="constrained")
        axes = figure.subplots()
        paint(axes)
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        axes.grid(alpha=0.3, linewidth=0.6)
        figure.legend(
            loc="outside lower center", ncols=2, frameon=False, fontsize=9, handlelength=2.6, labelspacing=0.3
        )
        out = io.BytesIO()
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None, "Creator": None})
        return out.getvalue()
