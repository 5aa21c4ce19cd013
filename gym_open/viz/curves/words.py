"""Documents: scores by task, what the curves are, and a report's own findings."""

from collections.abc import Sequence
from typing import Any

from gym_open.viz.curves.rows import Row, standing
from gym_open.viz.curves.sources import Found, Report
from gym_open.viz.documents import cell, table

_MOST_LINES = 200
"""Of a report's list that are shown."""

_HOW = """
A-Success is the mean over runs ± their sample deviation, at the largest training length. The interval is over runs and
puzzles both; of one run, over puzzles alone.

In the plots an agent has one colour: thick is the mean, thin are single runs, faint the ends of the interval. What no
training made is grey.
"""


def scores_document(task: str, rows: Sequence[Row]) -> str:
    """Markdown: a table of the agents on a task, and how to read the plots beside it."""
    body = [
        [
            cell(row.agent), str(len(row.runs)), f"{row.trained:,}" if row.trained else "–",
            f"{row.learning.value[-1]:.3f}" + (f" ± {row.deviation:.3f}" if row.deviation is not None else ""),
            f"{row.learning.low[-1]:.2f} to {row.learning.high[-1]:.2f}", f"{row.returns.value[-1]:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    head = ["agent", "runs", "steps", "A-Success", "95% interval", "return"]
    uneven = [
        f"- {cell(row.agent)}: {', '.join(f'{at:,} steps: {_runs_at(row, at)}' for at in row.learning.x)}"
        for row in rows
        if not standing(row.agent) and row.single and len({_runs_at(row, at) for at in row.learning.x}) > 1
    ]
    lines = [f"# {cell(task)}", "", *table(head, body), "", _HOW]
    if uneven:
        lines += [
            "",
            "Numbers of runs differ along these curves, so that a step may come from that alone:",
            "",
            *uneven,
        ]
    return "\n".join(lines)


def _runs_at(row: Row, steps: int) -> int:
    return sum(steps in x for x, _ in row.single.values())


def report_document(report: Report) -> str:
    """Markdown: a report's findings and doubts, and its scores of all tasks together."""
    lines = [f"# Report: {cell(report.table.get('title', report.name))}", ""]
    lines += _bullets(report.table.get("findings"))
    if notes := _bullets(report.table.get("notes")):
        lines += ["", "## Before you believe it", "", *notes]
    return "\n".join(lines)


def _bullets(texts: Any) -> list[str]:
    return [f"- {cell(text, 2_000)}" for text in texts[:_MOST_LINES]] if isinstance(texts, list) else []


def found_document(found: Found) -> str:
    """Markdown: what was found and what was left out."""
    counts = {
        "policies": sum(one.kind == "policy" for one in found.learned),
        "encoders": sum(one.kind == "encoder" for one in found.learned),
        "scores": len(found.scored), "probes": len(found.probed), "reports": len(found.reports),
    }  # fmt: skip
    lines = ["# What was found", "", *table(["", "number"], [[name, str(n)] for name, n in counts.items()])]
    if found.left_out:
        lines += ["", "## Left out", "", *(f"- {line}" for line in found.left_out)]
    return "\n".join(lines)
