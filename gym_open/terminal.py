"""What a command says: text that is only ever shown, and who it is said to.

What comes from a file, a path or a person goes through `printable` or `markup`, so that it steers no terminal.
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
    r"""The text with every character that shows nothing as its escape (`\x1b`), new lines aside: it steers nothing."""
    return "".join(
        c if c == "\n" or c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def markup(text: str) -> str:
    """As `printable`, for rich: it finds no markup of its own in it."""
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
    """How a command speaks.

    Attributes:
        console: what a person reads: standard output, or standard error if a program reads standard output.
        quiet: a person reads results alone.
        json: a program reads records.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.quiet = self.json = False

    def choose(self, *, quiet: bool, json: bool) -> None:
        """Speak like this from now on."""
        self.quiet, self.json = quiet, json
        self.console.quiet, self.console.stderr = quiet, json

    def say(self, text: str, *, verb: str = "") -> None:
        """Print a text as it is, paths and all: nothing in it is markup. A `verb` comes before it, in green."""
        words = Text.assemble((verb, "bold green"), " " if verb else "", printable(text))
        self.console.print(words, soft_wrap=True)

    def result(self, text: str, *, verb: str = "") -> None:
        """As `say`, for what came of a command: the one line that is left when it is quiet, unless records say it."""
        self.console.quiet = self.quiet and self.json
        self.say(text, verb=verb)
        self.console.quiet = self.quiet

    def record(self, record: Mapping[str, Any]) -> None:
        """Print a line of JSON on standard output at once, if a program reads it."""
        if self.json:
            print(json.dumps(record), flush=True)
