"""The output of a command: text for a person, or records for a program.

Text from a file, a path or a person passes through `printable` or `markup`, so that it cannot control the terminal.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text


def printable(text: str) -> str:
    r"""The text, in which each unprintable character except a new line is replaced by its escape (`\x1b`)."""
    return "".join(
        c if c == "\n" or c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def markup(text: str) -> str:
    """As `printable`, for rich: the text holds no rich markup."""
    return escape(printable(text))


def titled_table(
    title: str,
    columns: Sequence[str],
    *,
    right: Collection[str] = (),
    unbroken: Collection[str] = (),
    compact: bool = False,
) -> Table:
    """An empty table with its title on the left; the title is shown as it is, without markup.

    Args:
        title: heading.
        columns: names from left to right.
        right: columns aligned on the right, such as numbers.
        unbroken: columns whose cells stay on one line; text in the others is folded.
        compact: with a single rule below the names, for narrow terminals.
    """
    made = Table(title=markup(title), title_justify="left")
    if compact:
        made.box, made.show_edge, made.pad_edge, made.collapse_padding = SIMPLE, False, False, True
    for name in columns:
        justify, no_wrap = "right" if name in right else "left", name in unbroken
        made.add_column(name, justify=justify, no_wrap=no_wrap, overflow="fold")
    return made


class Voice:
    """The output of a command.

    Attributes:
        console: for a person: standard output, or standard error if a program reads standard output.
        quiet: whether the command prints only results.
        json: whether a program reads records.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.quiet = self.json = False

    def choose(self, *, quiet: bool, json: bool) -> None:
        """Set `quiet` and `json`."""
        self.quiet, self.json = quiet, json
        self.console.quiet, self.console.stderr = quiet, json

    def say(self, text: str, *, verb: str = "") -> None:
        """Print a text without interpreting markup in it. A `verb` comes first, in green."""
        words = Text.assemble((verb, "bold green"), " " if verb else "", printable(text))
        self.console.print(words, soft_wrap=True)

    def result(self, text: str, *, verb: str = "") -> None:
        """Print a result as `say` does, also if the command is quiet, unless it is quiet and prints records."""
        self.console.quiet = self.quiet and self.json
        self.say(text, verb=verb)
        self.console.quiet = self.quiet

    def record(self, record: Mapping[str, Any]) -> None:
        """If a program reads records, print this one at once: one line of JSON on standard output."""
        if self.json:
            print(json.dumps(record), flush=True)
