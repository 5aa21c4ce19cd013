"""Documents in a recording of curves: scores by task, what was found, and a report's own findings."""

from collections.abc import Sequence
from typing import Any

from gym_open.markdown import cell, table
from gym_open.results.records import Estimate
from gym_open.results.rows import RowSummary
from gym_open.viz.curves.sources import CurveSources, ReportTable

_MOST_LINES = 200
"""Lines of a report's list that are shown."""

_HOW = """
A-Success is the mean over runs ± their sample deviation, at the largest training length. The interval is over runs and
puzzles; with one run, over puzzles alone.

In the plots each agent has one colour. Thick lines are means, thin lines are single runs, faint lines are the ends of
the interval. Agents that were not trained are grey.
"""


def scores_document(task: str, rows: Sequence[RowSummary]) -> str:
    """Return Markdown: a table of the agents on a task, and how to read the plots."""
    body = [
        [
            cell(row.agent), str(len(row.seeds)), f"{row.trained:,}" if row.trained else "–",
            f"{row.score.value:.3f}" + (f" ± {row.deviation:.3f}" if row.deviation is not None else ""),
            _interval(row.score), f"{row.returns.value[-1]:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    head = ["agent", "runs", "steps", "A-Success", "95% interval", "return"]
    return "\n".join([f"# {cell(task)}", "", *table(head, body), "", _HOW])


def _interval(estimate: Estimate) -> str:
    return "–" if estimate.low is None or estimate.high is None else f"{estimate.low:.2f} to {estimate.high:.2f}"


def report_document(report: ReportTable) -> str:
    """Return Markdown: a report's findings and doubts."""
    lines = [f"# Report: {cell(report.table.get('title', report.name))}", ""]
    lines += _bullets(report.table.get("findings"))
    if notes := _bullets(report.table.get("notes")):
        lines += ["", "## Before you believe it", "", *notes]
    return "\n".join(lines)


def _bullets(texts: Any) -> list[str]:
    return [f"- {cell(text, 2_000)}" for text in texts[:_MOST_LINES]] if isinstance(texts, list) else []


def found_document(found: CurveSources) -> str:
    """Return Markdown: what was found and what was left out."""
    counts = {
        "policies": sum(model.kind == "policy" for model in found.models),
        "encoders": sum(model.kind == "encoder" for model in found.models),
        "scores": len(found.runs), "probes": len(found.probes), "reports": len(found.reports),
    }  # fmt: skip
    lines = ["# What was found", "", *table(["", "number"], [[name, str(n)] for name, n in counts.items()])]
    if found.left_out:
        lines += ["", "## Left out", "", *(f"- {line}" for line in found.left_out)]
    return "\n".join(lines)
