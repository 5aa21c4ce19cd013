"""The whole pipeline as a tiny run: from exploration to score, in two folders, and killed in one of them."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts, workspace
from gym_open.cli import main
from gym_open.config import to_dict
from gym_open.evaluate import a_success
from gym_open.pipeline import read_plan, stages
from tests.children import killed_at, run, started

TINY = {
    "collect/curl-ride.toml": """
        steps = 512
        streams = 2
        pool = 4
        probe = 16
        threads = 1
        checkpoint_every = 2
        [explorer]
        encoder = {features = 32}
        ppo = {update_epochs = 1}
    """,
    "train/encoder-objects.toml": """
        world_model = "objects"
        updates = 60
        report_every = 20
        batch_size = 32
        shift_pad = 0
        learning_rate = 3e-3
        threads = 1
        encoder = {architecture = "slots", slots = 8, readout = "centroids", frame = "image"}
    """,
    "train/policy-objects.toml": """
        num_envs = 8
        num_steps = 16
        frozen = true
        threads = 1
        encoder = {architecture = "slots", slots = 8, readout = "centroids", frame = "image"}
        ppo = {update_epochs = 1, shift_pad = 0, precision = "fp32"}
    """,
    "train/policy-goal-seeking.toml": """
        steps = 384
        num_envs = 8
        num_steps = 16
        mean_images = 50
        threads = 1
        encoder = {features = 32}
        ppo = {update_epochs = 1}
    """,
    "train/probe.toml": """
        train_worlds = 60
        validation_worlds = 20
        test_worlds = 30
        pixels = false
        threads = 1
    """,
    "evaluate/goal-seeking.toml": "threads = 1",
}
RUN = "from gym_open.cli import main; sys.exit(main(['run', '--workspace', sys.argv[1]]))"
RELEASE, SCORES = "datasets/open/explore-seed0/1.0.0", "evaluate/scores"


def _workspace(root: Path) -> Path:
    workspace.init(root)
    for name, text in TINY.items():
        (root / name).write_text(text)
    return root


def _digests(root: Path) -> dict[str, str]:
    found = {path.parent for path in root.glob("*/**/manifest.json")}
    return {path.relative_to(root).as_posix(): artefacts.digest(path) for path in sorted(found)}


class Runs(NamedTuple):
    """An undisturbed run, and a run in another folder that was killed twice and started again."""

    root: Path
    shown: str
    killed: Path
    shown_at_last: str


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    base = tmp_path_factory.mktemp("runs")
    root, killed = _workspace(base / "w"), _workspace(base / "somewhere" / "else")
    words, told = [sys.executable, "-c", f"import sys; {RUN}"], {"stderr": subprocess.STDOUT, "text": True}
    with started([*words, root], stdout=subprocess.PIPE, **told) as alone:
        for folder in ("collect/logs/.curl-ride-seed0.partial", "train/policies/.goal-seeking-scratch-seed0.partial"):
            killed_at(killed / folder / artefacts.SCRATCH, "*.safetensors", RUN, killed)
        at_last = run([*words, killed], **told)
        shown, _ = alone.communicate()
    assert (alone.returncode, at_last.returncode) == (0, 0), shown + at_last.stdout
    yield Runs(root, shown, killed, at_last.stdout)
    shutil.rmtree(base)


def test_policies_may_be_scored_with_greedy_actions_but_random_actions_stay_random(tmp_path: Path) -> None:
    workspace.init(tmp_path)
    (tmp_path / "evaluate/goal-seeking.toml").write_text('actions = "greedy"')
    scored = [
        stage.config for stage in stages(read_plan(tmp_path, 0), tmp_path, 0) if stage.name.startswith("evaluate")
    ]
    assert [to_dict(config)["actions"] for config in scored] == ["greedy", "greedy", "sampled"]


def test_everything_that_a_run_promises_is_there(runs: Runs) -> None:
    root, shown = runs.root, runs.shown
    for name in (
        "collect/logs/curl-ride-seed0/stream-000-000.mcap",
        f"{RELEASE}/meta/info.json",
        "train/encoders/objects-seed0/model.safetensors",
        "train/policies/goal-seeking-objects-seed0/model.safetensors",
        "train/policies/goal-seeking-scratch-seed0/curve.json",
        "train/probes/objects-seed0/probe.json",
        "viz/recordings/run-seed0/recording.rrd",
        "viz/figures/run-seed0/run.png",
        "viz/figures/run-seed0/run.mp4",
    ):
        assert (root / name).stat().st_size > 0
    for words in (
        "A-Success",
        "PPO from play",
        "PPO from scratch",
        "after the same 384 steps of goal-seeking",
        "linear probe",
        "next: rerun",
    ):
        assert words in shown
    assert not list(root.rglob(".*.partial*"))
    assert not list(root.rglob("*.lock"))


def test_the_scores_follow_from_the_recorded_episodes(runs: Runs) -> None:
    root = runs.root
    for folder in sorted((root / SCORES).iterdir()):
        scores = json.loads((folder / "scores.json").read_text())
        episodes = pd.read_parquet(folder / "episodes.parquet")
        assert len(episodes) == scores["puzzles"] == 100
        within = np.zeros(100)
        for rewards in episodes["rewards"]:
            within += np.cumsum(np.pad(rewards, (0, 100 - len(rewards)))) / 100
        assert scores["a_success"] == pytest.approx(a_success(within))
        assert scores["mean_return"] == pytest.approx(episodes["return"].mean())


def test_the_policy_from_the_encoder_is_proven_task_free(runs: Runs) -> None:
    root, shown = runs.root, runs.shown
    proof = json.loads((root / SCORES / "goal-seeking-objects-seed0" / "scores.json").read_text())["proof"]
    assert proof["verdict"] == "proven", proof
    assert "task-free, proven" in shown
    log = artefacts.digest(root / "collect/logs/curl-ride-seed0")
    assert proof["chain"][-1].endswith(log[:12])


def test_in_a_pipe_every_stage_prints_its_start_and_its_end(runs: Runs) -> None:
    plan = read_plan(runs.root, 0)
    row, steps = stages(plan, runs.root, 0), plan.collect.steps
    patterns = [r"gym-open [0-9.]+ on \d+ cores?.*, .+ free: .+ for 11 stages"]
    for number, stage in enumerate(row, 1):
        patterns += [rf"{number}/{len(row)} {stage.name} …", rf"{stage.name} +made \([0-9.]+ s\)"]
    patterns[2:2] = [f"exploring: 0 of {steps}", rf"exploring: {steps} of {steps} in .+/s; loss of the worlds .+"]
    patterns.append(r"made 11 of 11 stages in .+ \(.+ expected\); A-Success: PPO from play 0\..+")
    said = iter(runs.shown.splitlines())
    for pattern in patterns:  # in this order; what is between depends on how slow the machine is
        assert any(re.fullmatch(pattern, line) for line in said), f"{pattern}\n{runs.shown}"
    assert "\x1b" not in runs.shown


def test_a_second_run_does_nothing_and_reports_so(runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    root = runs.root
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    assert main(["run", "--workspace", str(root)]) == 0
    shown = capsys.readouterr().out
    assert "all 11 stages seem to be up to date" in shown.splitlines()[0]
    assert "nothing to do: all 11 stages are up to date; A-Success: " in shown
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*") if path in before} == before


@pytest.mark.parametrize("quiet", [False, True])
def test_a_program_reads_one_record_per_stage(quiet: bool, runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    root = runs.root
    assert main(["run", "--workspace", str(root), "--json", *["--quiet"] * quiet]) == 0
    said = capsys.readouterr()
    records = [json.loads(line) for line in said.out.splitlines()]
    row = stages(read_plan(root, 0), root, 0)
    assert [(record["stage"], Path(record["path"])) for record in records] == [(s.name, s.folder) for s in row]
    assert {record["result"] for record in records} == {"up-to-date"}
    assert all(record["seconds"] >= 0 for record in records)
    assert [record["digest"] for record in records] == [artefacts.digest(stage.folder) for stage in row]
    figures = {record["stage"]: record["figures"] for record in records}
    scores = json.loads((row[6].folder / "scores.json").read_text())
    probe = json.loads((row[3].folder / "probe.json").read_text())["targets"]
    assert figures["collect"]["steps"] == read_plan(root, 0).collect.steps
    assert figures["evaluate PPO from play"]["a_success"] == scores["a_success"]
    assert figures["evaluate PPO from play"]["proof"] == "proven"
    assert figures["train probe"]["gain_agent"] == probe["agent"]["gain"]["value"]
    assert ("linear probe" in said.err) == (not quiet)
    assert quiet == (not said.err)


def test_quiet_prints_one_line(runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--workspace", str(runs.root), "--quiet"]) == 0
    said = capsys.readouterr()
    assert re.fullmatch(r"nothing to do: all 11 stages are up to date; A-Success: .*random 0\.\d+\n", said.out)
    assert not said.err


def test_a_stage_alone_can_be_quiet_and_print_a_record(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "--workspace", str(runs.root), "--out", str(tmp_path / "scores")]
    assert main([*words, "--json"]) == 0
    said = capsys.readouterr()
    record = json.loads(said.out)
    assert (record["stage"], record["result"], record["path"]) == ("evaluate", "made", str(tmp_path / "scores"))
    assert record["figures"]["puzzles"] == 100
    assert said.err.startswith("evaluate …\n")
    assert "next: gym-open score verify" in said.err
    assert main([*words, "--quiet"]) == 0
    said = capsys.readouterr()
    assert said.out == f"up to date, nothing to do: {tmp_path / 'scores'}  (digest {record['digest'][:16]})\n"
    assert not said.err
    assert main(words) == 0  # nothing of this stays
    assert "next: gym-open score verify" in capsys.readouterr().out


def test_killed_twice_in_another_folder_it_ends_with_the_same_digests(runs: Runs) -> None:
    mine, theirs = _digests(runs.root), _digests(runs.killed)
    assert set(mine) == set(theirs)
    for name in mine:
        if not name.startswith("viz/recordings/"):  # Rerun's files differ from run to run
            assert theirs[name] == mine[name], name
    assert runs.shown_at_last.count("up to date") >= 4  # collect, release, encoder and probe were not made again


def test_a_flipped_byte_in_the_release_stops_training(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = runs.root
    release = Path(shutil.copytree(root / RELEASE, tmp_path / "release"))
    victim = next((release / "data").rglob("*.parquet"))
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 1
    victim.write_bytes(bytes(data))
    out = tmp_path / "encoder"
    words = ["train", "encoder", "--workspace", str(root), "--release", str(release), "--out", str(out)]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert str(victim) in error
    assert "SHA-256" in error
    assert not out.exists()


def test_a_cut_log_makes_no_release(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = runs.root
    log = Path(shutil.copytree(root / "collect/logs/curl-ride-seed0", tmp_path / "log"))
    victim = log / "stream-000-000.mcap"
    victim.write_bytes(victim.read_bytes()[: int(victim.stat().st_size * 0.61)])
    out = tmp_path / "release"
    assert main(["dataset", "build", "--workspace", str(root), "--logs", str(log), "--out", str(out)]) == 1
    assert str(victim) in capsys.readouterr().err
    assert not out.exists()


def test_an_encoder_of_another_shape_is_refused_before_training(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = runs.root
    words = ["train", "policy", "--workspace", str(root), "--config", str(root / "train/policy-objects.toml")]
    words += ["--encoder", str(root / "train/encoders/objects-seed0"), "--out", str(tmp_path / "policy")]
    assert main([*words, "--encoder.slots", "9"]) == 1
    assert "`encoder.slots` is 8, but the policy's configuration says 9" in capsys.readouterr().err
    assert not (tmp_path / "policy").exists()
