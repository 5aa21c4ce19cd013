"""Text from data in Markdown: it is shown as it is, and makes no link, no mark-up and no table of its own."""

import re
from collections.abc import Iterable, Sequence

from gym_open.terminal import printable

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~&!#@$]|:(?=//))")


def escaped(text: str) -> str:
    """The text with a backslash before everything that Markdown takes for mark-up."""
    return _SPECIAL.sub(r"\\\1", text).replace("www.", r"www\.")


def cell(text: object, longest: int = 120) -> str:
    """The text for one line of Markdown, such as the cell of a table, cut at `longest` characters."""
    line = printable(str(text)).replace("\n", " ")
    return escaped(line if len(line) <= longest else line[: longest - 1] + "…")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table whose first column is set left and the others right. Cells are Markdown already."""
    marks = ["---", *["---:"] * (len(head) - 1)]
    return [f"| {' | '.join(row)} |" for row in (head, marks, *rows)]
