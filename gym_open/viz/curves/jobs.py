"""State of a grid, from the files in its folder: it may be running, or may have been stopped."""

import time
from collections import Counter
from pathlib import Path
from typing import Literal, NamedTuple

from gym_open import artefacts
from gym_open.files import read_regular
from gym_open.markdown import cell, table
from gym_open.progress import Progressed

FOLDER = "jobs"
JobState = Literal["done", "at work", "stopped", "not begun"]
_STAGES = {
    "collect": "collect/logs", "release": "datasets/open", "encoder": "train/encoders", "probe": "train/probes",
    "policy": "train/policies", "score": "evaluate/scores",
}  # fmt: skip
"""First word of a job's name, and the folder of its artefact."""
_STALE_S = 600.0
"""A job without output for so many seconds counts as stopped."""
_TAIL = 10_000
"""Bytes at the end of a job's output that are searched for an error."""


class JobProgress(NamedTuple):
    """One job of a grid."""

    name: str
    stage: str
    state: JobState
    words: str
    """Its progress, or why it stopped."""


def jobs_of(folder: Path) -> list[JobProgress]:
    """Return the jobs of the grid in `folder`, by stage and name; none if the folder has no grid."""
    names = sorted(path.stem for path in (folder / FOLDER).glob("*.toml"))
    stages = list(_STAGES)
    return sorted((_job(folder, name) for name in names), key=lambda job: (stages.index(job.stage), job.name))


def folder_of(root: Path, name: str) -> Path:
    """Return the folder of the artefact of a job."""
    stage = _stage(name)
    below = root / _STAGES[stage]
    if stage == "encoder":
        return below / name
    rest = name.removeprefix(f"{stage}-")
    return below / rest / "1.0.0" if stage == "release" else below / rest


def _stage(name: str) -> str:
    """Return the stage of a job; the job of an encoder has the name of its configuration file."""
    first = name.partition("-")[0]
    return first if first in _STAGES else "encoder"


def _job(root: Path, name: str) -> JobProgress:
    folder, stage = root / FOLDER, _stage(name)
    if (folder_of(root, name) / artefacts.MANIFEST).is_file():
        return JobProgress(name, stage, "done", "")
    progress, output = folder / f"{name}.progress", folder / f"{name}.log"
    try:
        if (said := Progressed.read(progress)) and _is_fresh(progress):
            return JobProgress(name, stage, "at work", f"{said.done:,} of {said.total:,}, {said.rate:,.1f}/s")
        lines = read_regular(output, _TAIL, tail=True).decode(errors="replace").splitlines()
    except OSError:
        return JobProgress(name, stage, "not begun", "")
    errors = [line.strip("│ ").removeprefix("error: ") for line in lines if line.strip("│ ").startswith("error: ")]
    if not errors and _is_fresh(output):
        return JobProgress(name, stage, "at work", "begins")
    return JobProgress(name, stage, "stopped", errors[-1] if errors else "its output has no error")


def _is_fresh(path: Path) -> bool:
    return time.time() - path.stat().st_mtime < _STALE_S


def document(jobs: list[JobProgress]) -> str:
    """Return Markdown: the number of jobs of each stage in each state, and the jobs that run or were stopped."""
    states: tuple[JobState, ...] = ("done", "at work", "stopped", "not begun")
    counts = Counter((job.stage, job.state) for job in jobs)
    rows = [
        [stage, *(str(counts[stage, state]) for state in states)] for stage in dict.fromkeys(job.stage for job in jobs)
    ]
    rows.append(["**all**", *(str(sum(job.state == state for job in jobs)) for state in states)])
    lines = ["# Jobs", "", *table(["stage", *states], rows)]
    for state in ("at work", "stopped"):
        shown = [f"- {cell(job.name)}: {cell(job.words, 300)}" for job in jobs if job.state == state]
        lines += ["", f"## {state.capitalize()}", "", *shown] if shown else []
    return "\n".join(lines)
