"""A tiny grid, run as a user runs it: killed and resumed, with a job that fails, and once more when it is finished."""

import json
import sys
from pathlib import Path
from subprocess import STDOUT

import pytest

from gym_open import artefacts, workspace
from tests.children import killed_at, run

TINY = {
    "collect/tiny.toml": "steps = 512\nstreams = 2\ncheckpoint_every = 2\n[explorer.encoder]\nfeatures = 64\n",
    "train/tiny-encoder.toml": "updates = 6\nreport_every = 3\nbatch_size = 16\n[encoder]\nfeatures = 64\n",
    "train/tiny.toml": "steps = 256\nnum_envs = 4\nnum_steps = 32\nmean_images = 20\n[encoder]\nfeatures = 64\n",
    "evaluate/tiny.toml": "",
    "grid.toml": """
        tasks = ["goal-seeking"]
        seeds = [0]
        checkpoints = [100]
        evaluate = "evaluate/tiny.toml"
        [[agents]]
        name = "scratch"
        policy = "train/tiny.toml"
        [[agents]]
        name = "curl+ride"
        collect = "collect/tiny.toml"
        online = true
        policy = "train/tiny.toml"
        [[agents]]
        name = "curl+ride-offline"
        collect = "collect/tiny.toml"
        encoder = "train/tiny-encoder.toml"
        frozen = true
        policy = "train/tiny.toml"
    """,
}
JOBS = 14
"""Exploration run, release, encoder; three policies, each scored twice; random and oracle."""
BROKEN = TINY["train/tiny-encoder.toml"].replace("updates", "learning_rate = 1e30\nupdates")
"""An encoder whose loss soon is not a number."""


def _workspace(root: Path) -> Path:
    workspace.init(root)
    for name, text in TINY.items():
        (root / name).write_text(text)
    return root


def _words(root: Path) -> list[str]:
    return ["benchmark", str(root / "grid.toml"), "--workspace", str(root), "--out", str(root / "out"), "--jobs", "2"]


def _run(root: Path) -> tuple[int, str]:
    done = run([sys.executable, "-m", "gym_open.cli", *_words(root)], stderr=STDOUT)
    return done.returncode, done.stdout


def _digests(root: Path) -> dict[str, str]:
    found = {path.parent for path in (root / "out").glob("**/manifest.json")}
    return {path.relative_to(root).as_posix(): artefacts.digest(path) for path in sorted(found)}


@pytest.mark.slow
def test_killed_broken_and_repaired_it_ends_like_an_undisturbed_grid(tmp_path: Path) -> None:
    root, other = _workspace(tmp_path / "a"), _workspace(tmp_path / "b" / "elsewhere")
    (other / "train/tiny-encoder.toml").write_text(BROKEN)
    code = "from gym_open.cli import main; sys.exit(main(sys.argv[1:]))"
    killed_at(other / "out/train/policies", "*scratch-goal-seeking-seed0*", code, *_words(other))

    code, said = _run(other)
    assert code == 1, said
    assert "failed encoder-tiny-of" not in said
    assert "1 of 14 jobs failed, and 3 that need what they make were not started" in said
    assert "alone: OMP_NUM_THREADS=1 gym-open train encoder --config " in said
    report = (other / "out/report/report.md").read_text()
    assert "curl+ride" in report
    assert "curl+ride-offline" not in report

    (other / "train/tiny-encoder.toml").write_text(TINY["train/tiny-encoder.toml"])
    code, said = _run(other)
    assert code == 0, said
    assert said.count(": up to date\n") == JOBS - 4
    code, said = _run(root)
    assert code == 0, said
    assert said.count(": made (") == JOBS

    mine, theirs = _digests(root), _digests(other)
    assert len(mine) == JOBS + 1
    assert {name: theirs[name] for name in mine} == mine

    scores = [json.loads(path.read_text()) for path in (root / "out").glob("evaluate/scores/*/scores.json")]
    agents = ("curl+ride", "curl+ride-offline", "scratch")
    trained = [(agent, steps) for agent in agents for steps in (128, 256)]  # a rollout of 128 steps is past 100
    assert sorted((score["agent"], score["trained"]) for score in scores) == sorted(
        [*trained, ("oracle", 0), ("random", 0)]
    )
    assert {score["proof"]["verdict"] for score in scores if score["agent"].startswith("curl")} == {"proven"}

    before = {path: path.stat().st_mtime_ns for path in (root / "out").glob("*/**/*.log")}
    code, said = _run(root)
    assert code == 0, said
    assert said.count(": up to date\n") == JOBS
    assert {path: path.stat().st_mtime_ns for path in before} == before  # no process was started
