"""Text from data stays text in Markdown."""

import markdown_it
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.markdown import cell, table

HOSTILE = [
    "[click](https://evil.example)",
    "![x](https://evil.example/x.png)",
    "<img src=x onerror=alert(1)>",
    "a | b\n\n# heading",
    "`code` **bold** ~~gone~~ $x$",
    "https://evil.example www.evil.example me@evil.example",
    "\x1b[2J\u202e",
    "&lt;script&gt;",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_text_is_only_text(text: str) -> None:
    assert only_text(text)


@given(st.text(max_size=60))
def test_any_text_is_only_text(text: str) -> None:
    assert only_text(text)


def only_text(text: str) -> bool:
    """Whether a table with this text in a cell is a table of two rows whose cell holds plain text alone."""
    rendered = markdown_it.MarkdownIt("gfm-like", {"linkify": False}).parse(
        "\n".join(table(["name", "n"], [[cell(text), "1"]]))
    )
    inline = [token for token in rendered if token.type == "inline"]
    kinds = {child.type for token in inline for child in token.children or []}
    return len(inline) == 4 and kinds <= {"text", "text_special"}


def test_text_is_cut_and_bare_addresses_make_no_link() -> None:
    assert len(cell("x" * 500)) == 120
    assert "https://" not in cell("https://a.b")
    assert "www." not in cell("www.a.b")
