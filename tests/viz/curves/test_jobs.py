"""State of a grid, from the files in its folder."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gym_open.config import load
from gym_open.grid import GridConfig
from gym_open.grid.plan import make_plan
from gym_open.viz.curves.jobs import document, folder_of, jobs_of
from gym_open.workspace import template

Write = Callable[[str, str], Path]
SHIPPED = sorted(template().glob("evaluate/benchmark-*.toml"))


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_job_of_a_plan_is_found_where_it_lies(file: Path) -> None:
    plan = make_plan(load(file, GridConfig), Path("/out"), root=template())
    assert {job.name: folder_of(Path("/out"), job.name) for job in plan} == {job.name: job.out for job in plan}


def test_states_are_told_apart(write: Write) -> None:
    names = ("collect-icm-seed0", "release-icm-seed0", "policy-a-seed0", "policy-b-seed0", "policy-c-seed0", "score-a")
    for name in names:
        write(f"jobs/{name}.toml", "")
    folder = write("collect/logs/icm-seed0/manifest.json", "{}").parents[3]
    write("jobs/policy-a-seed0.progress", '{"done": 4096, "total": 300000, "rate": 147.25}')
    output = write("jobs/policy-b-seed0.log", "$ gym-open train\nTraceback\nerror: <the> disk | is full\n")
    write("jobs/policy-c-seed0.log", "$ gym-open train\n")
    states = {job.name: (job.state, job.words) for job in jobs_of(folder)}
    assert list(states) == list(names)
    assert states == {
        "collect-icm-seed0": ("done", ""),
        "release-icm-seed0": ("not begun", ""),
        "policy-a-seed0": ("at work", "4,096 of 300,000, 147.2/s"),
        "policy-b-seed0": ("stopped", "<the> disk | is full"),
        "policy-c-seed0": ("at work", "begins"),
        "score-a": ("not begun", ""),
    }
    long_ago = time.time() - 3_600
    for path in (output, folder / "jobs/policy-a-seed0.progress", folder / "jobs/policy-c-seed0.log"):
        os.utime(path, (long_ago, long_ago))
    later = {job.name: job.state for job in jobs_of(folder)}
    assert (later["policy-a-seed0"], later["policy-c-seed0"]) == ("not begun", "stopped")
    text = document(jobs_of(folder))
    assert r"- policy-b-seed0: \<the\> disk \| is full" in text
    assert "| policy | 0 | 0 | 2 | 1 |" in text
    assert "| **all** | 1 | 0 | 2 | 3 |" in text


def test_a_folder_without_jobs_has_none(tmp_path: Path) -> None:
    assert jobs_of(tmp_path) == []


def test_only_files_that_have_an_end_are_read(write: Write) -> None:
    root = write("jobs/policy-a-seed0.toml", "").parents[1]
    for name in ("policy-b-seed0", "policy-c-seed0"):
        write(f"jobs/{name}.toml", "")
    (root / "jobs/policy-a-seed0.progress").symlink_to("/dev/zero")
    (root / "jobs/policy-a-seed0.log").symlink_to("/dev/zero")
    os.mkfifo(root / "jobs/policy-b-seed0.progress")
    os.mkfifo(root / "jobs/policy-b-seed0.log")
    write("jobs/policy-c-seed0.progress", 5_000 * " " + '{"done": 1, "total": 2, "rate": 1.0}')
    assert {job.state for job in jobs_of(root)} == {"not begun"}
