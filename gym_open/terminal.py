"""Text on its way to a terminal: what comes from a file, a path or a person is only ever shown."""

from rich.markup import escape


def printable(text: str) -> str:
    r"""The text with every character that shows nothing as its escape (`\x1b`), new lines aside: it steers nothing."""
    return "".join(
        c if c == "\n" or c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def markup(text: str) -> str:
    """As `printable`, for rich: it finds no markup of its own in it."""
    return escape(printable(text))
