"""What README and docs tell people to type exists, and the links lead somewhere."""

import re
from pathlib import Path

import pytest

from gym_open.cli import COMMANDS, main
from gym_open.collect.config import CollectConfig
from gym_open.config import load
from gym_open.workspace import STAGES, template

ROOT = template()
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / stage / "README.md" for stage in STAGES),
]
COMMAND = re.compile(r"(?:^ {4}|`|&& uv run |uv run )gym-open ([a-z]+(?: [a-z]+)?)([^`\n#|]*)", re.MULTILINE)


def _page(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def _commands(page: Path) -> list[tuple[str, str]]:
    found = []
    for words, rest in COMMAND.findall(page.read_text()):
        name = words if words in COMMANDS else words.split()[0]
        found.append((name, f"{words.removeprefix(name)} {rest}"))
    return found


def test_the_pages_do_name_commands() -> None:
    named = {name for page in PAGES for name, _ in _commands(page)}
    assert named >= set(COMMANDS)


@pytest.mark.parametrize("page", PAGES, ids=_page)
def test_every_command_and_option_exists(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, rest in _commands(page):
        if name in ("dataset", "train"):  # named as a group
            continue
        assert name in COMMANDS, f"{page}: gym-open {name}"
        with pytest.raises(SystemExit):
            main([*name.split(), "--help"])
        options = capsys.readouterr().out
        for option in re.findall(r"--[a-z][a-z._-]*", rest):
            assert option in options, f"{page}: gym-open {name} {option}"


@pytest.mark.parametrize("page", PAGES, ids=_page)
def test_links_to_files_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), f"{page}: {target}"


def test_the_readmes_environment_example_runs() -> None:
    code = next(
        block for block in re.findall(r"```python\n(.*?)```", PAGES[0].read_text(), re.S) if "gymnasium" in block
    )
    names: dict[str, object] = {}
    exec(code, names)
    assert names["image"].shape == (84, 84, 3)  # type: ignore[attr-defined]


def test_the_explorer_that_the_docs_add_is_one(tmp_path: Path) -> None:
    text, *_ = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/explorers.md").read_text(), re.S)
    (tmp_path / "curl.toml").write_text(text)
    assert load(tmp_path / "curl.toml", CollectConfig).explorer.name == "curl"


@pytest.mark.parametrize("page", PAGES, ids=_page)
def test_every_row_of_a_table_has_a_cell_for_every_heading(page: Path) -> None:
    heading = None
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if not line.startswith("|"):
            heading = None
            continue
        cells = len(re.findall(r"(?<!\\)\|", re.sub(r"`[^`]*`", "", line)))
        heading = heading or cells
        assert cells == heading, f"{page}:{number}: {cells - 1} cells under {heading - 1} headings"


def _code() -> tuple[set[str], set[str]]:
    """Python files of this repository by their paths' ends, and every word that stands in them."""
    paths, words = set[str](), set[str]()
    for folder in ("gym_open", "tests", "benchmarks", "docs"):
        for file in (ROOT / folder).rglob("*.py"):
            parts = file.relative_to(ROOT).parts
            paths.update("/".join(parts[i:]) for i in range(len(parts)))
            words.update(re.findall(r"\w+", file.read_text()))
    for file in ROOT.glob("*/*.toml"):
        words.update(re.findall(r"\w+", file.read_text()))
    return paths, words


CODE_PATHS, CODE_WORDS = _code()
HISTORY = ROOT / "docs/decisions"  # names what was there when it was decided
ELSEWHERE = {
    "ppo_atari.py",  # CleanRL's
    "message_publish_time",  # Rerun's timelines
    "ros2_timestamp",
    "gym_open/agents/ae.py",  # examples of what a reader may add
    "gym_open/agents/change.py",
    "tests/agents/test_ae.py",
}
"""Names of other projects and of examples."""
NAMES = re.compile(r"`([A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*)(?:\(\))?`")


@pytest.mark.parametrize("page", [page for page in PAGES if HISTORY not in page.parents], ids=_page)
def test_every_python_file_that_is_named_exists(page: Path) -> None:
    named = set(re.findall(r"[\w/]+\.py\b", re.sub(r"https?://\S+", "", page.read_text())))
    assert {name for name in named if name not in CODE_PATHS} <= ELSEWHERE


@pytest.mark.parametrize("page", [page for page in PAGES if HISTORY not in page.parents], ids=_page)
def test_every_identifier_that_is_named_exists(page: Path) -> None:
    """Words in backticks that can only be identifiers: they hold a capital inside, an underscore or a dot."""
    named = {
        name
        for name in NAMES.findall(page.read_text())
        if not name.endswith(".py") and re.search(r"[a-z][A-Z]|_|\.", name)
    }
    missing = {name for name in named if any(part not in CODE_WORDS for part in name.split("."))}
    assert missing <= ELSEWHERE


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=_page)
def test_lines_are_at_most_120_characters_long(page: Path) -> None:
    """Rows of tables aside, which Markdown cannot break."""
    lines = page.read_text().splitlines()
    assert [i for i, line in enumerate(lines, 1) if len(line) > 120 and not line.startswith("|")] == []
