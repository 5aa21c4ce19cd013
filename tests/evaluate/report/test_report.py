"""Reports of hand-made scores: numbers are compared with pandas, and nothing depends on the folder."""

import json
import re
import shutil
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.evaluate.report import ReportConfig, write_report
from gym_open.results.paper import PAPER

QUICK = ReportConfig(resamples=200, thresholds=(0.25, 0.9))


class Report:
    """The content of a report's files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.table: dict[str, Any] = json.loads((folder / "table.json").read_text(encoding="utf-8"))
        self.html, self.markdown = ((folder / f"report.{f}").read_text(encoding="utf-8") for f in ("html", "md"))

    def cell(self, agent: str, task: str) -> dict[str, Any]:
        found = [one for one in self.table["results"]["cells"] if (one["agent"], one["task"]) == (agent, task)]
        assert len(found) == 1
        return found[0]


@pytest.fixture(scope="module")
def report(grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    return Report(write_report(QUICK, [grid], tmp_path_factory.mktemp("report") / "report").path)


@pytest.fixture(scope="module")
def frame(grid: Path) -> pd.DataFrame:
    """Every scores.json, read without the report."""
    return pd.DataFrame([json.loads(path.read_text()) for path in grid.rglob("scores.json")])


@pytest.mark.parametrize("agent", ["scratch", "curl+ride"])
@pytest.mark.parametrize("task", ["goal-seeking", "tool-use"])
def test_a_cell_is_what_pandas_makes_of_the_last_checkpoint(
    report: Report, frame: pd.DataFrame, agent: str, task: str
) -> None:
    own = frame[(frame["agent"] == agent) & (frame["task"] == task)]
    last = own[own["trained"] == own["trained"].max()].sort_values("seed")
    cell = report.cell(agent, task)
    assert cell["seeds"] == [0, 1]
    assert cell["per_run"] == pytest.approx(last["a_success"].tolist())
    assert cell["score"]["value"] == pytest.approx(last["a_success"].mean())
    assert cell["deviation"] == pytest.approx(last["a_success"].std())
    assert cell["score"]["low"] < cell["score"]["value"] < cell["score"]["high"]
    assert cell["mean_return"] == pytest.approx(last["mean_return"].mean())
    assert cell["returns"]["value"] == pytest.approx(np.mean(last["mean_return_within"].tolist(), axis=0))
    means = own.groupby("trained")["a_success"].mean()
    assert cell["learning"]["x"] == list(means.index)
    assert cell["learning"]["value"] == pytest.approx(means.tolist())


def test_aggregates_and_comparisons_are_those_of_the_runs(report: Report, frame: pd.DataFrame) -> None:
    last = frame[frame["trained"] == 1_003_520].groupby("agent")["a_success"].apply(lambda s: s.sort_values().tolist())
    found = {one["agent"]: one for one in report.table["results"]["aggregates"]}
    for agent in ("scratch", "curl+ride"):
        assert found[agent]["iqm"]["value"] == pytest.approx(np.mean(last[agent][1:-1]))  # the middle two of four
        assert found[agent]["mean"]["value"] == pytest.approx(np.mean(last[agent]))
    pairs = {
        (one["agent"], one["other"]): one["probability"]["value"] for one in report.table["results"]["improvements"]
    }
    assert pairs["curl+ride", "scratch"] == pytest.approx(1 - pairs["scratch", "curl+ride"])
    assert not any("oracle" in pair for pair in pairs)
    assert found["random"]["iqm"]["low"] is None  # one run a task: nothing to draw again
    gain = report.cell("curl+ride", "tool-use")["gain"]
    ours, theirs = (report.cell(agent, "tool-use")["score"]["value"] for agent in ("curl+ride", "scratch"))
    assert gain["value"] == pytest.approx(ours - theirs)
    assert report.cell("scratch", "tool-use")["gain"] is None


def test_steps_to_a_threshold_are_read_off_each_runs_own_line(report: Report, frame: pd.DataFrame) -> None:
    own = frame[(frame["agent"] == "curl+ride") & (frame["task"] == "goal-seeking")].sort_values(["seed", "trained"])
    low, high = report.cell("curl+ride", "goal-seeking")["crossings"]
    assert (low["threshold"], high["threshold"]) == (0.25, 0.9)
    assert high["steps"] == [None, None]
    assert high["median"] is None
    for found, (_, run) in zip(low["steps"], own.groupby("seed"), strict=True):
        assert np.interp(found, run["trained"], run["a_success"]) == pytest.approx(0.25)


def test_rows_stand_in_the_papers_order_with_its_numbers_beside(report: Report) -> None:
    assert report.table["results"]["agents"] == ["scratch", "curl+ride", "random", "oracle"]
    assert report.cell("curl+ride", "tool-use")["paper"] == list(PAPER["CURL + RIDE"]["tool-use"])
    assert report.cell("oracle", "tool-use")["paper"] is None
    for text in (report.html, report.markdown):
        assert ".532" in text
        assert ".006" in text
        assert "random" in text


def test_what_so_few_runs_can_show_is_said(report: Report) -> None:
    assert any("2 runs per task and agent" in note and "p = .33" in note for note in report.table["notes"])
    assert report.table["findings"][0].startswith("goal-seeking: best is curl+ride with ")
    found = report.table["findings"][0]
    few = "with fewer than 3 seeds, which says nothing about other seeds: curl+ride +"
    assert f"Different from scratch on these puzzles, but {few}" in found
    assert "Different from scratch:" not in found


class _Tags(HTMLParser):
    """Collect every start tag with its attributes; fail if tags are not closed in order."""

    VOID = ("meta", "img", "wbr")

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def parsed(html: str) -> list[tuple[str, dict[str, str | None]]]:
    parser = _Tags()
    parser.feed(html)
    assert not parser.open
    return parser.tags


def test_the_page_needs_nothing_but_itself(report: Report) -> None:
    tags = parsed(report.html)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in tags}
    addresses = [value or "" for _, attributes in tags for name, value in attributes.items() if name in ("src", "href")]
    assert addresses
    assert all(address.startswith(("data:image/svg+xml;base64,", "#")) for address in addresses)
    ids = [attributes["id"] for _, attributes in tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {address[1:] for address in addresses if address.startswith("#")} <= set(ids)
    assert all(attributes.get("alt") for tag, attributes in tags if tag == "img")
    assert "@import" not in report.html
    assert "url(" not in report.html


def test_figures_are_whole_and_named_in_the_markdown(report: Report) -> None:
    figures = sorted(path.name for path in (report.folder / "figures").iterdir())
    assert figures == sorted(
        f"{kind}-{task}.svg" for kind in ("return", "learning") for task in ("goal-seeking", "tool-use")
    )
    for name in figures:
        assert f"(figures/{name})" in report.markdown
        text = "".join(ET.parse(report.folder / "figures" / name).getroot().itertext())
        assert "curl+ride" in text


def test_equal_scores_give_equal_bytes_wherever_they_lie_and_in_any_order(
    report: Report, grid: Path, tmp_path: Path
) -> None:
    moved = tmp_path / "elsewhere"
    shutil.copytree(grid / "scores" / "curl+ride", moved / "x" / "second")
    shutil.copytree(grid / "made", moved / "y")
    others = [path for path in sorted((grid / "scores").iterdir(), reverse=True) if path.name != "curl+ride"]
    sources = [moved, *others, *others]
    again = write_report(QUICK, sources, tmp_path / "again").path
    assert artefacts.digest(again) == artefacts.digest(report.folder)
    assert artefacts.verify(again, "report")
    assert not write_report(QUICK, [grid], again).made
    for text in (report.html, report.markdown, json.dumps(report.table)):
        assert str(grid) not in text
        assert not re.search(r"\b20\d\d-\d\d-\d\d", text)


@pytest.mark.usefixtures("no_figures")
def test_one_more_agent_changes_no_other_interval(report: Report, grid: Path, tmp_path: Path, make_run: Any) -> None:
    make_run(tmp_path / "more", agent="human", seed=None, actions="keyboard", facts={"player": "Ada"})
    more = Report(write_report(QUICK, [grid, tmp_path / "more"], tmp_path / "report").path)
    assert more.cell("curl+ride", "goal-seeking") == report.cell("curl+ride", "goal-seeking")
    assert more.cell("human", "goal-seeking")["seeds"] == ["Ada"]


def test_commands_and_configurations_make_it_again(report: Report) -> None:
    recipes = {one["agent"]: one["commands"] for one in report.table["recipes"]}
    words = [re.sub(r" --(config|out) \S+", "", line) for line in recipes["curl+ride"]]
    assert words == [
        "gym-open collect --task $TASK --seed $SEED",  # the stand-in's configuration has a task
        "gym-open dataset build --logs log --task $TASK --seed 0",
        "gym-open train encoder --release release --task $TASK --seed $SEED",
        "gym-open train policy --encoder encoder --task $TASK --agent curl+ride --seed $SEED",
        "gym-open evaluate --policy policy --task $TASK --seed $SEED",
        "gym-open evaluate --policy policy --task $TASK --seed $SEED --at 200704",
    ]
    assert recipes["oracle"] == ["gym-open evaluate --task $TASK --split test --oracle --out scores"]
    named = {one["name"]: one for one in report.table["settings"]}
    files = {match for lines in recipes.values() for line in lines for match in re.findall(r"--config (\S+)", line)}
    assert files == set(named)
    assert 'name = "ppo"' in named["policy-1.toml"]["toml"].splitlines()
    assert not re.search("^(seed|task|agent) =", named["policy-1.toml"]["toml"], re.MULTILINE)
    assert named["policy-1.toml"]["agents"] == ["scratch", "curl+ride"]


@pytest.mark.usefixtures("no_figures")
def test_what_is_not_among_the_sources_is_said(grid: Path, tmp_path: Path) -> None:
    made = Report(write_report(QUICK, [grid / "scores"], tmp_path / "report").path)
    missing = [one for one in made.table["settings"] if one["toml"] is None]
    assert {one["kind"] for one in missing} == {"log", "release", "encoder", "policy"}
    digests = {path.read_text() for path in grid.glob("made/**/manifest.json")}
    assert all(any(sha in text for text in digests) for one in missing for sha in one["sha256"])
    assert "Not found among the sources" in made.html
    assert any("the runs of curl+ride, scratch differ only in seeds" in note for note in made.table["notes"])
    recipe = next(one for one in made.table["recipes"] if one["agent"] == "scratch")
    line = "gym-open train policy --config policy-1.toml --task $TASK --agent scratch --seed $SEED --out policy"
    assert recipe["commands"][0] == line


@pytest.mark.usefixtures("no_figures")
def test_what_trained_the_agents_is_looked_up_in_the_workspace(grid: Path, tmp_path: Path) -> None:
    shutil.copytree(grid / "scores", tmp_path / "evaluate" / "scores")
    out = tmp_path / "evaluate" / "reports" / "first"
    alone = Report(write_report(QUICK, [tmp_path / "evaluate" / "scores"], out).path)
    assert any(one["toml"] is None for one in alone.table["settings"])
    shutil.copytree(grid / "made", tmp_path / "train" / "policies")
    (tmp_path / "train" / ".half.partial").mkdir()
    found = write_report(QUICK, [tmp_path / "evaluate" / "scores"], out)
    assert found.made  # it says more than the one that lay there
    assert Report(found.path).table == Report(write_report(QUICK, [grid], tmp_path / "whole").path).table
    assert not any(one["toml"] is None for one in Report(found.path).table["settings"])


EVIL = "<script>alert(1)</script>|`*_$x$ \x1b[31m\u202eevil\n```\n# head"


def test_names_from_files_are_only_ever_shown(tmp_path: Path, make_run: Any, train: Any) -> None:
    policy = train(tmp_path / "made", "scratch", "goal-seeking", 0, 1000, name=EVIL)
    hardware = {"<i>processor</i>": EVIL}
    for trained in (500, 1000):
        make_run(
            tmp_path / f"s{trained}",
            agent=EVIL,
            trained=trained,
            policy=policy,
            change={"hardware": hardware, "code": EVIL},
        )
    make_run(tmp_path / "h", agent="human", seed=None, actions="keyboard", facts={"player": EVIL})
    made = write_report(ReportConfig(title=EVIL, resamples=100), [tmp_path], tmp_path / "report").path
    html = (made / "report.html").read_text(encoding="utf-8")
    assert "<script" not in html
    assert "<i>" not in html
    for file in ("report.html", "report.md"):
        text = (made / file).read_text(encoding="utf-8")
        assert "\x1b" not in text
        assert "\u202e" not in text
    markdown = (made / "report.md").read_text(encoding="utf-8")
    outside = re.sub(r"^```\w*\n.*?^```$", "", markdown, flags=re.MULTILINE | re.DOTALL)
    assert "<script" not in outside.replace(r"\<script", "")
    assert not re.search(r"^# head", markdown, re.MULTILINE)
    for figure in (made / "figures").iterdir():
        assert b"<script" not in figure.read_bytes()
