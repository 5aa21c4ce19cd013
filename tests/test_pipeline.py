"""The whole pipeline on a tiny run: from play to score, twice in two folders, once killed in the middle."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts, workspace
from gym_open.cli import main
from gym_open.evaluate import a_success

TINY = {
    "collect/curl-ride.toml": "steps = 768\nstreams = 2\nthreads = 1\n",
    "train/encoder-curl.toml": "updates = 12\nreport_every = 4\nbatch_size = 32\nthreads = 1\n",
    "train/policy-goal-seeking.toml": "steps = 1536\nnum_envs = 8\nnum_steps = 64\nmean_images = 50\nthreads = 1\n",
    "train/probe.toml": "train_worlds = 60\nvalidation_worlds = 20\ntest_worlds = 30\npixels = false\nthreads = 1\n",
    "evaluate/goal-seeking.toml": "threads = 1\n",
}
RELEASE, SCORES = "datasets/open/explore-seed0", "evaluate/scores"


def _workspace(root: Path) -> Path:
    workspace.init(root)
    for name, text in TINY.items():
        (root / name).write_text(text)
    return root


def _start(root: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "gym_open.cli", "run", "--workspace", str(root)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def _kill_when(process: subprocess.Popen[bytes], ready: Callable[[], bool]) -> None:
    until = time.monotonic() + 120
    while not ready():
        assert process.poll() is None, f"ended before it could be killed: {process.communicate()[0].decode()}"
        assert time.monotonic() < until
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.communicate()


def _digests(root: Path) -> dict[str, str]:
    found = {path.parent for path in root.glob("*/**/manifest.json")}
    return {path.relative_to(root).as_posix(): artefacts.digest(path) for path in sorted(found)}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    root = _workspace(tmp_path_factory.mktemp("run") / "w")
    process = _start(root)
    shown = process.communicate()[0].decode()
    assert process.returncode == 0, shown
    yield root, shown
    shutil.rmtree(root)


def test_everything_that_a_run_promises_is_there(finished: tuple[Path, str]) -> None:
    root, shown = finished
    for name in (
        "collect/logs/curl-ride-seed0/stream-000.mcap",
        f"{RELEASE}/meta/info.json",
        "train/encoders/curl-seed0/model.safetensors",
        "train/policies/goal-seeking-curl-seed0/model.safetensors",
        "train/policies/goal-seeking-scratch-seed0/curve.json",
        "train/probes/curl-seed0/probe.json",
        "viz/recordings/run-seed0/recording.rrd",
        "viz/figures/run-seed0/run.png",
    ):
        assert (root / name).stat().st_size > 0
    for words in ("A-Success", "PPO from encoder", "PPO from scratch", "random", "linear probe", "next: rerun"):
        assert words in shown
    assert not list(root.rglob(".*.partial*"))
    assert not list(root.rglob("*.lock"))


def test_the_scores_follow_from_the_recorded_episodes(finished: tuple[Path, str]) -> None:
    root, _ = finished
    for folder in sorted((root / SCORES).iterdir()):
        scores = json.loads((folder / "scores.json").read_text())
        episodes = pd.read_parquet(folder / "episodes.parquet")
        assert len(episodes) == scores["puzzles"] == 100
        within = np.zeros(100)
        for rewards in episodes["rewards"]:
            within += np.cumsum(np.pad(rewards, (0, 100 - len(rewards)))) / 100
        assert scores["a_success"] == pytest.approx(a_success(within))
        assert scores["mean_return"] == pytest.approx(episodes["return"].mean())


def test_the_policy_from_the_encoder_is_proven_task_free(finished: tuple[Path, str]) -> None:
    root, shown = finished
    proof = json.loads((root / SCORES / "goal-seeking-curl-seed0" / "scores.json").read_text())["proof"]
    assert proof["verdict"] == "proven", proof
    assert "task-free, proven" in shown
    log = artefacts.digest(root / "collect/logs/curl-ride-seed0")
    assert proof["chain"][-1].endswith(log[:12])


def test_a_second_run_does_nothing_and_says_so(finished: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    root, _ = finished
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    assert main(["run", "--workspace", str(root)]) == 0
    assert "nothing to do" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*") if path in before} == before


def test_killed_twice_in_another_folder_it_ends_with_the_same_digests(
    finished: tuple[Path, str], tmp_path: Path
) -> None:
    root, _ = finished
    other = _workspace(tmp_path / "somewhere" / "else")
    log = other / "collect/logs/.curl-ride-seed0.partial"
    _kill_when(_start(other), lambda: any((log / artefacts.SCRATCH).glob("*.safetensors")))
    assert log.is_dir()
    policy = other / "train/policies/.goal-seeking-scratch-seed0.partial"
    _kill_when(_start(other), lambda: any((policy / artefacts.SCRATCH).glob("*.safetensors")))
    assert policy.is_dir()
    last = _start(other)
    shown = last.communicate()[0].decode()
    assert last.returncode == 0, shown
    mine, theirs = _digests(root), _digests(other)
    for name in [name for name in mine if not name.startswith("viz/")]:
        assert theirs[name] == mine[name], name


def test_a_flipped_byte_in_the_release_stops_training(
    finished: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, _ = finished
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


def test_a_cut_log_makes_no_release(
    finished: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, _ = finished
    log = Path(shutil.copytree(root / "collect/logs/curl-ride-seed0", tmp_path / "log"))
    victim = log / "stream-000.mcap"
    victim.write_bytes(victim.read_bytes()[: int(victim.stat().st_size * 0.61)])
    out = tmp_path / "release"
    assert main(["dataset", "build", "--workspace", str(root), "--logs", str(log), "--out", str(out)]) == 1
    assert str(victim) in capsys.readouterr().err
    assert not out.exists()


def test_an_encoder_of_another_shape_is_refused_before_training(
    finished: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, _ = finished
    words = ["train", "policy", "--workspace", str(root), "--encoder", str(root / "train/encoders/curl-seed0")]
    assert main([*words, "--encoder.features", "64", "--out", str(tmp_path / "policy")]) == 1
    error = capsys.readouterr().err
    assert "512" in error
    assert "64" in error
    assert not (tmp_path / "policy").exists()
