"""Markdown for documents in a recording; what comes from files is shown as it is and means nothing."""

import re
from collections.abc import Sequence

from gym_open.terminal import printable

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~!&])")


def cell(text: object, longest: int = 120) -> str:
    """Text on one line in which Markdown finds nothing of its own, not endless."""
    shown = printable(str(text)).replace("\n", " ")
    shown = shown if len(shown) <= longest else f"{shown[:longest]}…"
    return _SPECIAL.sub(r"\\\1", shown)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first column is left, the others right; cells are Markdown already."""
    lines = [f"| {' | '.join(head)} |", f"|---|{'---:|' * (len(head) - 1)}"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]
