"""Runs of one agent may differ only in their seeds: what is refused, what is allowed, and what cannot be checked."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gym_open.errors import ArtefactError
from gym_open.evaluate.report import ReportConfig, write_report

QUICK = ReportConfig(resamples=100)
Make = Callable[..., Path]

pytestmark = pytest.mark.usefixtures("no_figures")


@pytest.fixture
def pair(tmp_path: Path, make_run: Make, train: Make) -> Callable[..., None]:
    """Scores of seeds 0 and 1 of an agent, the second with `changes`; configurations go to `made`."""

    def make(changes: dict[str, Any], steps: int = 1000, second: str = "curl+ride") -> None:
        for seed, agent, length, own in ((0, "curl+ride", 1000, {}), (1, second, steps, changes)):
            policy = train(tmp_path / "made", agent, "goal-seeking", seed, length, name="ours", changes=own)
            make_run(tmp_path / "scores" / str(seed), agent="ours", seed=seed, trained=length, policy=policy)

    return make


def _report(*sources: Path) -> dict[str, Any]:
    out = sources[0].parent / "report"
    return json.loads((write_report(QUICK, sources, out).path / "table.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"facts": {"frozen": True}}, "policy's `frozen` is False in the first and True in the second"),
        ({"facts": {"transfer": "weights"}}, "policy's `transfer` is None in the first and weights"),
        ({"policy": {"ppo": {"lr": 0.1}}}, "policy's `ppo.lr` is 0.01 in the first and 0.1"),
        ({"policy": {"name": "other"}}, "policy's `name` is ppo in the first and other"),
        ({"encoder": {"ppo": {"lr": 0.1}}}, "encoder's `ppo.lr`"),
        ({"release": {"ppo": {}}}, "release's `ppo.lr` is 0.01 in the first and not set in the second"),
        ({"log": {"name": "icm"}}, "log's `name` is curl+ride in the first and icm"),
    ],
)
def test_another_treatment_under_one_name_is_refused(
    changes: dict[str, Any], words: str, pair: Callable[..., None], tmp_path: Path
) -> None:
    pair(changes)
    with pytest.raises(ArtefactError, match=re.escape(words)) as caught:
        _report(tmp_path / "scores", tmp_path / "made")
    for word in (str(tmp_path / "scores" / "0"), str(tmp_path / "scores" / "1"), "'ours'", "--agent NAME"):
        assert word in str(caught.value)
    assert not (tmp_path / "report").exists()


def test_another_length_or_origin_is_refused_without_any_configuration(
    pair: Callable[..., None], tmp_path: Path
) -> None:
    pair({}, steps=2000)
    with pytest.raises(ArtefactError, match="`steps` is 1000 in the first and 2000 in the second"):
        _report(tmp_path / "scores")
    pair({}, second="plain")
    with pytest.raises(ArtefactError, match="`encoder` is offline in the first and none in the second"):
        _report(tmp_path / "scores")


def test_seeds_threads_checkpoints_and_names_of_releases_are_free(pair: Callable[..., None], tmp_path: Path) -> None:
    """The seeds of exploration and encoder are the seed of the run (`make_policy`)."""
    free = {"threads": 2, "checkpoints": (500,)}
    pair({"policy": free, "encoder": free, "log": free, "release": {"name": "open/seed1"}})
    table = _report(tmp_path / "scores", tmp_path / "made")
    assert table["results"]["cells"][0]["seeds"] == [0, 1]
    assert not any("could not be checked" in note for note in table["notes"])


def test_commands_say_which_runs_they_are_for_if_not_for_all(pair: Callable[..., None], tmp_path: Path) -> None:
    pair({"policy": {"threads": 2}})
    table = _report(tmp_path / "scores", tmp_path / "made")
    lines = [line for line in table["recipes"][0]["commands"] if " policy " in line and "train" in line]
    assert [line.partition("  # ")[2] for line in lines] == ["goal-seeking, seed 0", "goal-seeking, seed 1"]
    assert [re.findall(r"policy-\d\.toml", line) for line in lines] == [["policy-1.toml"], ["policy-2.toml"]]
    files = {file for line in table["recipes"][0]["commands"] for file in re.findall(r"--config (\S+)", line)}
    assert files == {one["name"] for one in table["settings"]}


def test_what_could_not_be_compared_is_said(pair: Callable[..., None], tmp_path: Path) -> None:
    pair({"policy": {"ppo": {"lr": 0.1}}})
    assert any(
        "could not be fully checked that the runs of ours differ only in seeds" in note
        for note in _report(tmp_path / "scores")["notes"]
    )


def test_that_nothing_is_told_apart_is_said_of_the_trained_alone(tmp_path: Path, make_run: Make, train: Make) -> None:
    """The random agent differs from them, but the sentence is about trained agents."""
    for agent in ("scratch", "icm"):
        policy = train(tmp_path / "made", agent, "goal-seeking", 0, 1000)
        make_run(tmp_path / "scores" / agent, agent=agent, trained=1000, policy=policy, draw=7)
    make_run(tmp_path / "scores" / "random", agent="random", skill=0.01)
    found = _report(tmp_path / "scores")["findings"][0]
    assert "No agent trained on images differs from scratch" in found


@pytest.mark.parametrize("shared", [False, True])
def test_three_seeds_may_tell_apart_and_a_shared_encoder_is_said(
    shared: bool, tmp_path: Path, make_run: Make, train: Make
) -> None:
    one = {"log": {"seed": 0}, "encoder": {"seed": 0}} if shared else None
    for agent, skill in (("scratch", 0.3), ("curl+ride", 0.9)):
        for seed in range(3):
            # Its folders are named by the seed; of equal settings come equal artefacts, whatever the folder.
            policy = train(tmp_path / "made", agent, "goal-seeking", seed, 1000, changes=one)
            out = tmp_path / "scores" / f"{agent}-{seed}"
            make_run(out, agent=agent, seed=seed, trained=1000, policy=policy, skill=skill)
    table = _report(tmp_path / "scores")
    assert "Different from scratch: curl+ride +" in table["findings"][0]
    said = [
        note
        for note in table["notes"]
        if note.startswith("One exploration run and one encoder for several seeds: curl+ride.")
    ]
    assert bool(said) == shared
