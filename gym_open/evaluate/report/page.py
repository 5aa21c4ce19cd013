"""A report as a page (HTML, one file, no network, no script) and as Markdown."""

import base64
import functools
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from gym_open.evaluate.config import ReportConfig
from gym_open.evaluate.report import numbers
from gym_open.evaluate.report.figures import ReportFigure
from gym_open.evaluate.report.numbers import ReportCell, ReportNumbers
from gym_open.evaluate.report.probes import ProbeTable
from gym_open.evaluate.report.provenance import ProofGroup, Recipe, SharedConfig
from gym_open.markdown import escaped
from gym_open.results.names import standing

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


class ReportContent(msgspec.Struct, frozen=True):
    """Everything on a page except the figures; `table.json` holds it."""

    title: str
    config: dict[str, Any]
    results: ReportNumbers
    findings: list[str]
    notes: list[str]
    proofs: list[ProofGroup]
    probes: list[ProbeTable]
    settings: list[SharedConfig]
    recipes: list[Recipe]
    makers: list[dict[str, Any]]
    """Each code version, set of packages and hardware that made scores."""


def html(content: ReportContent, figures: Sequence[ReportFigure], config: ReportConfig) -> str:
    """Render the page."""
    return _render("page.html.jinja", content, figures, config)


def markdown(content: ReportContent, figures: Sequence[ReportFigure], config: ReportConfig) -> str:
    """Render the same in Markdown, with links to the figures."""
    return _render("page.md.jinja", content, figures, config)


@functools.cache
def _environment() -> "Environment":
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gym_open.evaluate.report", "."),
        autoescape=jinja2.select_autoescape(["html.jinja"]),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {name: getattr(numbers, name) for name in ("number", "interval", "signed", "steps")}
    environment.filters |= {"data": _data, "cell": escaped, "breakable": _breakable}
    return environment


def _render(template: str, content: ReportContent, figures: Sequence[ReportFigure], config: ReportConfig) -> str:
    results = content.results
    by_pair = {(one.agent, one.other): one for one in results.improvements}
    return (
        _environment()
        .get_template(template)
        .render(
            c=content,
            r=results,
            config=config,
            figures=figures,
            best=_best(results),
            compared=_compared(results),
            percent=f"{100 * config.confidence:.3g}%",
            bound=_bound,
            count=numbers.count,
            crossing=lambda task: _crossing(results, task),
            improvement=lambda agent, other: by_pair.get((agent, other)),
            standing=standing,
        )
    )


def _compared(results: ReportNumbers) -> list[str]:
    """Return the agents of the matrix, in the order of the rows."""
    there = {one.agent for one in results.improvements}
    return [agent for agent in results.agents if agent in there]


def _best(results: ReportNumbers) -> dict[str, str]:
    """Return the compared agent with the highest mean, by task."""
    compared = [cell for cell in results.cells if standing(cell.agent) == 0]
    return {cell.task: cell.agent for cell in sorted(compared, key=lambda cell: cell.score.value)}


def _crossing(results: ReportNumbers, task: str) -> tuple[list[ReportCell], list[str]]:
    """Return the task's agents that reached a threshold in a run, and the names of the other trained agents."""
    trained = [cell for cell in results.cells if cell.task == task and cell.trained]
    there = [cell for cell in trained if any(steps is not None for one in cell.crossings for steps in one.steps)]
    return there, [cell.agent for cell in trained if cell not in there]


def _bound(cell: ReportCell, value: float | None, *, short: bool = False) -> str:
    """Format the steps to a threshold; with `≤` if the first checkpoint already reaches it."""
    if value is None:
        return "–" if short else "not reached"
    return f"{'≤ ' if value <= cell.learning.x[0] else ''}{numbers.steps(value)}"


def _breakable(name: str) -> "Markup":
    """Return a name that a narrow column may break after any punctuation and within a long word."""
    from markupsafe import Markup, escape

    parts = re.findall(r"[^\W_]{1,12}|[\W_]", name)
    return Markup("").join(escape(part) if part.isalnum() else escape(part) + Markup("<wbr>") for part in parts)


def _data(svg: bytes) -> str:
    """Return an address that contains the figure itself: nothing in it can run or affect the page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
