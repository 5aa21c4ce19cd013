"""What a report refuses, leaves out or warns about; hostile names, texts and records."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gym_open import artefacts
from gym_open.errors import ArtefactError, ConfigError, GymOpenError, UsageError
from gym_open.evaluate.report import ReportConfig, write_report
from gym_open.evaluate.report.gather import gather

QUICK = ReportConfig(resamples=100)
Make = Callable[..., Path]

pytestmark = pytest.mark.usefixtures("no_figures")


def _report(sources: list[Path], out: Path, config: ReportConfig = QUICK) -> dict[str, Any]:
    return json.loads((write_report(config, sources, out).path / "table.json").read_text(encoding="utf-8"))


def _refused(sources: list[Path], tmp_path: Path, kind: type[GymOpenError], *words: str) -> None:
    with pytest.raises(kind) as caught:
        write_report(QUICK, sources, tmp_path / "report")
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / "report").exists()


def test_no_scores_or_no_folder_is_wrong_use(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    _refused([tmp_path / "empty"], tmp_path, UsageError, "empty", "gym-open evaluate")
    _refused([tmp_path / "nowhere"], tmp_path, UsageError, "nowhere", "no such folder")


@pytest.mark.parametrize("setting", [{"resamples": 5}, {"confidence": 1.0}, {"thresholds": (0.0,)}, {"title": ""}])
def test_settings_out_of_bounds_are_named(setting: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=next(iter(setting))):
        write_report(msgspec.structs.replace(QUICK, **setting), [tmp_path], tmp_path / "report")


@pytest.mark.parametrize("file", ["scores.json", "episodes.parquet", "lineage.json", "manifest.json"])
def test_damaged_scores_are_named(file: str, tmp_path: Path, make_run: Make) -> None:
    make_run(tmp_path / "scores" / "good", agent="random", seed=0)
    bad = make_run(tmp_path / "scores" / "bad", agent="random", seed=1)
    data = (bad / file).read_bytes()
    (bad / file).write_bytes(data[:-20] + bytes(20))
    _refused([tmp_path / "scores"], tmp_path, ArtefactError, str(bad))


@pytest.mark.parametrize(
    ("change", "word"),
    [({"a_success": 0.9}, "a_success"), ({"puzzles": 99}, "puzzles"), ({"trained": "many"}, "trained"),
     ({"mean_return": 0.0}, "mean_return"), ({"mean_steps": 1.5}, "mean_steps"),
     ({"task": "chess"}, "task"), ({"split": "validation"}, "each once"),
     ({"agent": "human", "policy": "f" * 64}, "policy")],
)  # fmt: skip
def test_a_record_that_its_episodes_contradict_is_refused(
    change: dict[str, Any], word: str, tmp_path: Path, make_run: Make
) -> None:
    bad = make_run(tmp_path / "scores", agent="random", change=change)
    _refused([tmp_path / "scores"], tmp_path, ArtefactError, str(bad), word)


@pytest.mark.parametrize(
    "change",
    [
        {"agent": "curl+ride"},
        {"seed": 3},
        {"trained": 999},
        {"trained": 500},
        {"policy": "0" * 64},
        {"agent": "random", "trained": 0},
    ],
)
def test_who_played_is_who_the_lineage_says(
    change: dict[str, Any], tmp_path: Path, make_run: Make, train: Make
) -> None:
    policy = train(tmp_path / "made", "scratch", "goal-seeking", 0, 1000)
    bad = make_run(tmp_path / "scores", agent="scratch", trained=1000, policy=policy, change=change)
    _refused([tmp_path / "scores"], tmp_path, ArtefactError, str(bad), "its lineage says")


def test_an_unknown_reference_is_wrong_use(tmp_path: Path, make_run: Make) -> None:
    make_run(tmp_path / "scores", agent="random")
    with pytest.raises(UsageError, match=r"reference.*'scratch'.*random"):
        write_report(ReportConfig(reference="scratch"), [tmp_path / "scores"], tmp_path / "report")


def test_two_scores_of_one_run_are_an_error_unless_they_say_the_same(tmp_path: Path, make_run: Make) -> None:
    for name, draw in (("one", 1), ("other", 2)):
        make_run(tmp_path / "scores" / name, agent="random", draw=draw)
    words = ("one", "other", "random on goal-seeking, seed 0", "gym-open train policy --agent NAME")
    _refused([tmp_path / "scores"], tmp_path, ArtefactError, *words)
    make_run(tmp_path / "same" / "one", agent="random", draw=1, skill=0.5)
    make_run(tmp_path / "same" / "end", agent="random", draw=1, skill=0.5, change={"code": "other"})
    assert len(gather([tmp_path / "same"], "test").runs) == 1


def test_what_newer_scores_set_aside_is_left_out_and_counted(tmp_path: Path, make_run: Make) -> None:
    make_run(tmp_path / "random", agent="random", draw=1)
    new = make_run(tmp_path / "random", agent="random", draw=2)
    assert (tmp_path / "random-1").is_dir()
    found = gather([tmp_path], "test")
    assert [run.folder for run in found.runs] == [new]
    assert found.left_out == ["Scores that newer scores had set aside (NAME-1 next to NAME) were left out: 1."]


def test_a_longer_training_sets_the_shorter_aside(tmp_path: Path, make_run: Make, train: Make) -> None:
    """The same commands with more steps; a checkpoint in a folder with such a name is not set aside."""
    for trained in (1000, 2000):
        policy = train(tmp_path / f"made-{trained}", "scratch", "goal-seeking", 0, trained)
        new = make_run(tmp_path / "s" / "a", agent="scratch", trained=trained, policy=policy)
    early = make_run(tmp_path / "s" / "a-2", agent="scratch", trained=500, policy=policy)
    found = gather([tmp_path / "s"], "test")
    assert {run.folder for run in found.runs} == {new, early}
    assert "1." in found.left_out[0]


def test_unfinished_and_hidden_folders_are_passed_by(tmp_path: Path, make_run: Make) -> None:
    good = make_run(tmp_path / "good", agent="random")
    shutil.copytree(good, tmp_path / ".half.partial")
    (tmp_path / ".half.partial" / "scores.json").write_text("{")
    assert len(gather([tmp_path], "test").runs) == 1


def test_the_other_split_is_left_out_and_said(tmp_path: Path, make_run: Make) -> None:
    make_run(tmp_path / "in" / "a", agent="random", split="validation")
    _refused([tmp_path / "in"], tmp_path, UsageError, "no scores of the test puzzles")
    make_run(tmp_path / "in" / "b", agent="random")
    table = _report([tmp_path / "in"], tmp_path / "report")
    assert any("another split than 'test'" in note for note in table["notes"])
    assert len(gather([tmp_path / "in"], "validation").runs) == 1


def test_weak_evidence_is_called_so(tmp_path: Path, make_run: Make, train: Make) -> None:
    """One seed, another length, a task without score, a run not scored to its end, few puzzles, several versions."""
    for agent, seeds, trained in (("scratch", (0, 1), 1000), ("icm", (0,), 500)):
        for seed in seeds:
            policy = train(tmp_path / "made", agent, "goal-seeking", seed, trained)
            make_run(tmp_path / agent / str(seed), agent=agent, seed=seed, trained=trained, policy=policy)
    policy = train(tmp_path / "made", "scratch", "goal-seeking", 2, 1000)
    make_run(tmp_path / "late", agent="scratch", seed=2, trained=400, policy=policy)
    policy = train(tmp_path / "made", "scratch", "tool-use", 0, 1000)
    make_run(tmp_path / "tool", agent="scratch", task="tool-use", trained=1000, policy=policy)
    make_run(tmp_path / "human", agent="human", seed=None, actions="keyboard", puzzles=20, facts={"player": "Ada"})
    table = _report([tmp_path], tmp_path / "report")
    notes = "\n".join(table["notes"])
    for expected in (
        "Only one seed on at least one task: scratch, icm", "different lengths (500, 1K steps)",
        "Not scored: icm on tool-use",
        "scratch, goal-seeking, seed 2: scored at 400, not 1,000 steps", "human, puzzles 000–019",
    ):  # fmt: skip
        assert expected in notes
    cell = next(one for one in table["results"]["cells"] if (one["agent"], one["task"]) == ("scratch", "goal-seeking"))
    assert cell["seeds"] == [0, 1]
    human = next(one for one in table["results"]["cells"] if one["agent"].startswith("human"))
    assert human["gain"] is None  # other puzzles: nothing to compare


def test_a_proof_is_walked_again_whatever_the_scores_say(tmp_path: Path, make_run: Make, train: Make) -> None:
    policy = train(tmp_path / "made", "curl+ride", "goal-seeking", 0, 1000, log_task="tool-use")
    said = {"verdict": "proven", "reasons": [], "chain": [], "rests_on": ""}
    make_run(tmp_path / "a", agent="curl+ride", trained=1000, policy=policy, change={"proof": said})
    make_run(tmp_path / "b", agent="orphan", trained=1000, change={"proof": said})
    clean = train(tmp_path / "made", "icm+ride", "goal-seeking", 0, 1000)
    make_run(tmp_path / "c", agent="icm+ride", trained=1000, policy=clean)
    table = _report([tmp_path], tmp_path / "report")
    proofs = {one["agent"]: one for one in table["proofs"]}
    assert {agent: one["verdict"] for agent, one in proofs.items()} == {
        "curl+ride": "missing", "orphan": "missing", "icm+ride": "proven"
    }  # fmt: skip
    assert "played task 'tool-use'" in proofs["curl+ride"]["reasons"][0]
    assert [link.split()[0] for link in proofs["icm+ride"]["chains"][0]["links"]] == ["encoder", "release", "log"]
    assert proofs["icm+ride"]["chains"][0]["policies"] == [f"goal-seeking, seed 0: {artefacts.digest(clean)}"]
    notes = "\n".join(table["notes"])
    assert "is 'proven'; their lineage gives" in notes
    assert "Nothing proves that the encoder of curl+ride is task-free" in notes


def _probe(out: Path, encoder: Path, make: Make, targets: Any) -> Path:
    def work(folder: Path) -> dict[str, Any]:
        (folder / "probe.json").write_bytes(msgspec.json.encode({"targets": targets, "worlds": {}, "moves": 1}))
        return {}

    return artefacts.build(out, kind="probe", config=QUICK, parents=[encoder], work=work).path


def test_probes_stand_beside_the_agents_that_started_from_their_encoder(
    tmp_path: Path, make_run: Make, train: Make
) -> None:
    policy = train(tmp_path / "made", "curl+ride", "goal-seeking", 0, 1000)
    make_run(tmp_path / "s", agent="curl+ride", trained=1000, policy=policy)
    encoder = tmp_path / "made" / "curl+ride" / "encoder-0"
    scores = {
        "trained": {"value": 0.81, "low": 0.7, "high": 0.9, "error_cells": 1.0},
        "untrained": {"value": 0.5, "low": 0.4, "high": 0.6},
    }
    row = {"measure": "r2", "guess": 0.0, "scores": scores, "gain": {"value": 0.31, "low": 0.2, "high": 0.4}}
    good = _probe(tmp_path / "probe", encoder, make_run, {"agent": row})
    table = _report([tmp_path], tmp_path / "report")
    assert table["probes"][0]["agents"] == ["curl+ride"]
    assert table["probes"][0]["encoder"] == f"encoder {artefacts.digest(encoder)[:12]}"
    assert table["probes"][0]["rows"]["agent"]["gain"]["value"] == 0.31
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8").partition('id="probes"')[2]
    columns = re.findall(r'<th scope="col">(\w+)', page)
    assert columns == ["target", "gain", "trained", "untrained"]  # a phone shows those on the left
    assert "r2, guess .00" in page
    assert '<small class="soft">[.20, .40]' in page
    assert page.count('<small class="soft roomy">[') == 2  # what a phone leaves out
    shutil.rmtree(good)
    _probe(tmp_path / "probe", encoder, make_run, {"agent": {"r2": 0.3}})
    with pytest.raises(ArtefactError, match=r"probe\.json.*probe the encoder again"):
        write_report(QUICK, [tmp_path], tmp_path / "other")
