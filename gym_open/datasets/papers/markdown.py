"""Text from data in Markdown: it is shown, and makes no link, no markup and no table of its own."""

import re
from collections.abc import Iterable, Sequence

from gym_open.terminal import printable

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~&!#@$]|:(?=//))")
_LENGTH = 120


def plain(text: object) -> str:
    """The text for a line of Markdown, on one line and cut at 120 characters."""
    line = printable(str(text)).replace("\n", " ")
    if len(line) > _LENGTH:
        line = line[: _LENGTH - 1] + "…"
    return _SPECIAL.sub(r"\\\1", line).replace("www.", r"www\.")


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, right: int = 0) -> str:
    """A table whose last `right` columns are numbers, set to the right; cells are Markdown already."""
    marks = ["---"] * (len(head) - right) + ["---:"] * right
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (head, marks, *rows))
