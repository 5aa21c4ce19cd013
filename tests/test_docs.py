"""What README and docs tell people to type exists, and the links lead somewhere."""

import re
from pathlib import Path

import pytest

from gym_open.cli import COMMANDS, main
from gym_open.collect.config import CollectConfig
from gym_open.config import load
from gym_open.workspace import STAGES, template

ROOT = template()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *(ROOT / stage / "README.md" for stage in STAGES)]
COMMAND = re.compile(r"(?:^ {4}|`|&& uv run |uv run )gym-open ([a-z]+(?: [a-z]+)?)([^`\n#|]*)", re.MULTILINE)


def _commands(page: Path) -> list[tuple[str, str]]:
    found = []
    for words, rest in COMMAND.findall(page.read_text()):
        name = words if words in COMMANDS else words.split()[0]
        found.append((name, f"{words.removeprefix(name)} {rest}"))
    return found


def test_the_pages_do_name_commands() -> None:
    named = {name for page in PAGES for name, _ in _commands(page)}
    assert named >= set(COMMANDS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_row_of_a_table_has_a_cell_for_every_heading(page: Path) -> None:
    heading = None
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if not line.startswith("|"):
            heading = None
            continue
        cells = len(re.findall(r"(?<!\\)\|", re.sub(r"`[^`]*`", "", line)))
        heading = heading or cells
        assert cells == heading, f"{page}:{number}: {cells - 1} cells under {heading - 1} headings"
