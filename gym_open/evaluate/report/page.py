"""A report as a page (HTML, one file, nothing fetched, no script) and as Markdown."""

import base64
from collections.abc import Sequence
from typing import Any

import msgspec

from gym_open.evaluate.report import words
from gym_open.evaluate.report.config import ReportConfig
from gym_open.evaluate.report.figures import Drawn
from gym_open.evaluate.report.gather import UNTRAINED
from gym_open.evaluate.report.provenance import Proven, Recipe, Setting
from gym_open.evaluate.report.results import Cell, Results


class Content(msgspec.Struct, frozen=True):
    """All that a page says; `table.json` is this, without the pictures."""

    title: str
    config: dict[str, Any]
    results: Results
    findings: list[str]
    notes: list[str]
    proofs: list[Proven]
    probes: list[dict[str, Any]]
    settings: list[Setting]
    recipes: list[Recipe]
    makers: list[dict[str, Any]]
    """Code version, packages and hardware of the scores, distinct ones."""


def html(content: Content, figures: Sequence[Drawn], config: ReportConfig) -> str:
    """The page."""
    return _render("page.html.jinja", content, figures, config)


def markdown(content: Content, figures: Sequence[Drawn], config: ReportConfig) -> str:
    """The same in Markdown, with figures beside it."""
    return _render("page.md.jinja", content, figures, config)


def _render(template: str, content: Content, figures: Sequence[Drawn], config: ReportConfig) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gym_open.evaluate.report", "."),
        autoescape=jinja2.select_autoescape(["html.jinja"]), trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= {
        "number": words.number, "interval": words.interval, "signed": words.signed, "steps": words.steps, "data": _data,
        "cell": _table_cell,
    }  # fmt: skip
    by_pair = {(one.agent, one.other): one for one in content.results.improvements}
    return environment.get_template(template).render(
        c=content, r=content.results, config=config, count=words.count, figures=figures, compared=_compared(content),
        improvement=lambda agent, other: by_pair.get((agent, other)), best=_best(content.results), bound=_bound,
        percent=f"{100 * config.confidence:.3g}%",
    )  # fmt: skip


def _compared(content: Content) -> list[str]:
    """Agents of the matrix, in the order of the rows."""
    there = {one.agent for one in content.results.improvements}
    return [agent for agent in content.results.agents if agent in there]


def _best(results: Results) -> dict[str, str]:
    """The trained agent with the highest mean, by task."""
    trained = [cell for cell in results.cells if cell.agent.split(",")[0] not in UNTRAINED]
    return {cell.task: cell.agent for cell in sorted(trained, key=lambda cell: cell.score.value)}


def _bound(cell: Cell, value: float | None, *, short: bool = False) -> str:
    """Steps to a threshold: a bound from above where the first checkpoint is there already."""
    if value is None:
        return "–" if short else "not reached"
    return f"{'≤ ' if value <= cell.learning.x[0] else ''}{words.steps(value)}"


def _data(svg: bytes) -> str:
    """An address that holds the picture itself: nothing in it can run, or clash with the page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"


def _table_cell(text: str) -> str:
    r"""Text within a Markdown table: its own marks of Markdown and HTML are shown."""
    for mark in r"\`*_[]<>|#~$":
        text = text.replace(mark, f"\\{mark}")
    return text
