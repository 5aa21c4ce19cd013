"""Documents show text from files as it is, without markup."""

import re

import msgspec

from gym_open.artefacts import Lineage, Parent
from gym_open.viz.documents import flattened, lineage, raw_json, settings


def test_settings_are_named_with_dots() -> None:
    config = {"seed": 3, "explorer": {"ppo": {"clip": 0.2}, "reward": "none"}, "rollout": 64}
    assert dict(flattened(config)) == {
        "seed": 3, "rollout": 64, "explorer.reward": "none", "explorer.ppo.clip": 0.2,
    }  # fmt: skip


def test_markdown_and_escapes_in_settings_have_no_effect() -> None:
    hostile = {"a|b": "[click](https://example.org) <img src=x>\x1b[2J", "fence": "```\n# heading\n````"}
    text = settings("title | # `x`", {"damaged": "| **all**"}, hostile)
    before, raw = text.split("## JSON\n")
    assert "\x1b" not in text
    assert "\\[click\\](https" in before
    assert "a\\|b" in before
    assert not re.search(r"^# heading", before, re.MULTILINE)
    fence = raw.split("json")[0]
    assert fence == "`" * 5
    assert raw.endswith(fence)
    assert raw.count(fence) == 2


def test_raw_json_is_the_configuration_up_to_a_length() -> None:
    config = {"streams": 4, "name": "ü"}
    assert msgspec.json.decode(raw_json(config).strip("`").removeprefix("json")) == config
    long = raw_json({"x": "y" * 30_000})
    assert len(long) < 21_000
    assert "more characters in the file" in long


def test_lineage_names_every_ancestor() -> None:
    log = Lineage("log", "k", "0.1", {}, {"steps": 5, "puzzles": ["a", "b"]}, [])
    release = Lineage("release", "k", "0.2", {"numpy": "2"}, {"content": "f" * 64}, [Parent("d" * 64, {}, log)])
    text = lineage("Lineage", release, {})
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert any("release" in row and "(itself)" in row and "0.2" in row for row in rows)
    assert any("· log" in row and "d" * 12 in row and "d" * 13 not in row for row in rows)
    assert "| steps | 5 | log |" in rows
    assert "| puzzles | 2 items | log |" in rows
    assert "| content | ffffffffffff | release |" in rows
    assert "| numpy | 2 |" in rows


def test_one_file_has_no_lineage() -> None:
    assert "| file | a\\_b |" in lineage("Lineage", None, {"file": "a_b"})


def test_only_the_first_of_very_many_settings_are_shown() -> None:
    text = settings("log", {}, {f"setting{i}": i for i in range(1000)})
    assert "| setting499 | 499 |" in text
    assert "| setting500 |" not in text
    assert "| … | the file has 500 more |" in text
