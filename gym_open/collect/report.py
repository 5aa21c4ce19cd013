"""The summary of an exploration run as tables for a terminal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Group
from rich.table import Table

from gym_open.errors import ArtefactError
from gym_open.terminal import titled_table

MOST_SEGMENTS = 24
"""Largest number of segments in the table; of a longer run, it shows the last ones."""


def summary_table(log: Path) -> Group:
    """Tables of the exploration run in the log artefact `log`, from its summary.json.

    Raises:
        ArtefactError: if the summary is missing or not readable.
    """
    path = log / "summary.json"
    try:
        summary = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; collect the log again") from None
    return Group(_worlds(summary), _segments(summary["segments"]), _overview(summary))


def _worlds(summary: Mapping[str, Any]) -> Table:
    title = f"{summary['explorer']}, curriculum “{summary['rule']}”: {summary['steps']:,} steps, {summary['ended']}"
    columns = ("world", "visits", "steps", "final loss", "table seen", "agent stuck", "in corners")
    table = titled_table(title, columns, right=columns)
    for row in summary["worlds"]:
        stuck, loss = row["stuck"], _loss(row["final_loss"], fresh=not row["visits"])
        table.add_row(
            str(row["world"]), str(row["visits"]), f"{row['steps']:,}", loss,
            f"{row['coverage']:.0%}", str(stuck["agent"]["times"]), str(stuck["corner"]["times"]),
        )  # fmt: skip
    return table


def _segments(segments: list[dict[str, Any]]) -> Table:
    shown = segments[-MOST_SEGMENTS:]
    title = "segments" if len(shown) == len(segments) else f"the last {len(shown)} of {len(segments)} segments"
    numbers = ("stream", "world", "steps", "loss entered", "loss left")
    table = titled_table(title, (*numbers, "ended by"), right=numbers)
    for row in shown:
        entered, left = row["loss_at_entry"], row["loss_at_exit"]
        table.add_row(
            str(row["stream"]), str(row["world"]), f"{row['steps']:,}", _loss(entered, fresh=left is not None),
            _loss(left), row["ended"],
        )  # fmt: skip
    return table


def _overview(summary: Mapping[str, Any]) -> Table:
    table = titled_table("exploration", ("", ""))
    table.show_header = False
    coverage, stuck = summary["coverage"], summary["stuck"]
    reasons = ", ".join(f"{reason} {count}" for reason, count in summary["reasons"].items())
    touched = sorted(summary["touches"].items(), key=lambda item: -item[1])
    touches = ", ".join(f"{kind} {count:,}" for kind, count in touched if count)
    table.add_row("segments ended by", reasons)
    table.add_row(
        "table seen",
        f"{coverage['share']:.0%} of its cells; of those of a visited world {coverage['share_of_visited_worlds']:.0%}",
    )
    table.add_row("agent touched", touches or "nothing")
    table.add_row("agent stuck", f"{stuck['agent']['times']} times, {stuck['agent']['steps']:,} steps")
    table.add_row("objects in corners", f"{stuck['corner']['times']} times, {stuck['corner']['steps']:,} steps")
    return table


def _loss(value: float | None, *, fresh: bool = False) -> str:
    """A loss as text. In JSON it is null for a fresh world, and for every world without a world model."""
    return f"{value:.3g}" if value is not None else "fresh" if fresh else "–"
