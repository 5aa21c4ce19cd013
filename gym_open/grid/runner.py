"""Runs the jobs of a grid in parallel, each in a process of its own. It keeps no state between two runs.

The artefacts show which jobs are up to date, and each command resumes its own killed job. The runner only decides which
jobs may start, watches them, ends them when it ends itself, and reports.
"""

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from gym_open.errors import GymOpenError, UsageError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.files import lock, write_atomically
from gym_open.grid.child import Child, GridJobStatus, alone
from gym_open.grid.config import GridConfig
from gym_open.grid.plan import SPEEDS, GridJob, StageName, chains, make_plan, seconds
from gym_open.grid.table import Screen
from gym_open.processes import interruptible
from gym_open.terminal import markup

_LOOK = 0.25
"""Seconds between two checks of the child processes."""
_GRACE = 10.0
"""Seconds that a child process has to end after SIGTERM."""


class Runner:
    """Runs at most `width` of the jobs at a time, and holds the state of each."""

    def __init__(self, jobs: Sequence[GridJob], folder: Path, width: int) -> None:
        self.folder, self.width = folder, width
        self.statuses = {job.name: GridJobStatus(job) for job in jobs}
        self._jobs = jobs
        self._children: dict[str, Child] = {}
        self._speeds: dict[StageName, float] = dict(SPEEDS)  # latest measurement per stage
        self._chains = chains(jobs, {job.name: seconds(job, SPEEDS) for job in jobs})

    def run(self, screen: Screen) -> None:
        """Run all jobs. When this returns or raises, no child process is left."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for job in self._jobs:
            write_atomically(self.folder / f"{job.name}.toml", job.toml().encode())
        for job in self._jobs:
            if all(self.statuses[need.name].done for need in job.needs) and job.is_up_to_date():
                self.statuses[job.name].state = "up to date"
                screen.show(self.statuses, self.left())
        try:
            while not all(status.ended for status in self.statuses.values()):
                for job in self._ready()[: self.width - len(self._children)]:
                    self._children[job.name] = Child(job, self.folder)
                    self.statuses[job.name].state = "running"
                screen.show(self.statuses, self.left())
                time.sleep(_LOOK)
                for name in list(self._children):
                    self._look(name)
            screen.show(self.statuses, self.left())
        finally:
            self._end_children()

    def _ready(self) -> list[GridJob]:
        """Jobs that may start now: short scores and probes first, then the longest dependency chain first."""
        waiting = [status.job for status in self.statuses.values() if status.state == "waiting"]
        ready = [job for job in waiting if all(self.statuses[need.name].done for need in job.needs)]
        return sorted(ready, key=lambda job: (job.stage not in ("evaluate", "train probe"), -self._chains[job.name]))

    def _look(self, name: str) -> None:
        status, child = self.statuses[name], self._children[name]
        status.seconds = child.seconds
        status.progress = child.progress()
        if status.progress and status.progress.rate:
            self._speeds[status.job.stage] = status.progress.rate * status.job.units / max(status.progress.total, 1)
        code = child.poll()
        if code is None:
            return
        del self._children[name]
        if code:
            status.state, status.reason = "failed", child.reason()
            self._hold_up(status.job)
        else:
            status.state = "made" if child.has_made() else "up to date"

    def _hold_up(self, failed: GridJob) -> None:
        """Mark all jobs that need the failed job, directly or through other jobs."""
        lost = {failed.name}
        for job in self._jobs:
            if any(need.name in lost for need in job.needs):
                lost.add(job.name)
                self.statuses[job.name].state = "held up"

    def _end_children(self) -> None:
        for sign in (signal.SIGTERM, signal.SIGKILL):
            for child in self._children.values():
                child.end(sign)
            until = time.monotonic() + _GRACE
            while time.monotonic() < until and any(child.poll() is None for child in self._children.values()):
                time.sleep(0.02)

    def left(self) -> float:
        """Approximate seconds until the end: the longest dependency chain, or all work divided by `width` if longer."""
        remaining = {name: self._remaining(status) for name, status in self.statuses.items()}
        return max(*chains(self._jobs, remaining).values(), sum(remaining.values()) / self.width)

    def _remaining(self, status: GridJobStatus) -> float:
        if status.ended:
            return 0.0
        if status.progress and status.progress.rate:
            return (status.progress.total - status.progress.done) / status.progress.rate
        return max(seconds(status.job, self._speeds) - status.seconds, 1.0)


def run_grid(config: GridConfig, out: Path, *, root: Path, jobs: int | None, console: Console) -> Path:
    """Run a grid, or what is left of it, and write its report.

    Args:
        config: agents, tasks, seeds.
        out: folder of the grid. It holds artefacts in the folders of a workspace, `report/`, and in `jobs/` the
            configuration and output of every job.
        root: workspace that the configuration files belong to.
        jobs: number of parallel jobs; by default the number of processors.
        console: prints the table.

    Returns:
        The report's folder.

    Raises:
        UsageError: if `jobs` is below 1, or another process runs this grid. Nothing was started.
        ConfigError: if a file is wrong. Nothing was started.
        GymOpenError: if a job failed. All jobs that do not need it have run, and the report covers them.
    """
    width = len(os.sched_getaffinity(0)) if jobs is None else jobs
    if width < 1:
        raise UsageError(f"--jobs: expected 1 or more, got {jobs}")
    out = out.absolute()
    plan = make_plan(config, out, root=root)
    out.parent.mkdir(parents=True, exist_ok=True)
    with lock(out):
        runner = Runner(plan, out / "jobs", width)
        with interruptible(), Screen(console) as screen:
            runner.run(screen)
        failed = [status for status in runner.statuses.values() if status.state == "failed"]
        for status in failed:
            _print_failure(status, runner.folder, console)
        report = _report([status.job for status in runner.statuses.values() if status.done], out)
    if failed or report is None:
        if report is not None:
            console.print(
                f"the report covers the finished jobs: {markup(str(report))}", highlight=False, soft_wrap=True
            )
        held_up = sum(status.state == "held up" for status in runner.statuses.values())
        others = f", and {held_up} that need what they make were not started" if held_up else ""
        raise GymOpenError(
            f"{len(failed)} of {len(plan)} jobs failed{others}: see above; run the same command to try again"
        )
    return report


def _print_failure(failed: GridJobStatus, folder: Path, console: Console) -> None:
    name = failed.job.name
    for line in (
        f"[bold red]failed[/] {markup(name)}: {markup(failed.reason)}",
        f"  log: {markup(str(folder / f'{name}.log'))}",
        f"  alone: {markup(alone(failed.job, folder))}",
    ):
        console.print(line, highlight=False, soft_wrap=True)


def _report(done: Sequence[GridJob], out: Path) -> Path | None:
    """Write the report of all scores, if there are any. It finds probes and configurations in the other artefacts."""
    from gym_open.evaluate.report import ReportConfig, write_report

    for job in done:
        if isinstance(job.config, EvaluateConfig):
            config = ReportConfig(split=job.config.split)
            return write_report(config, [job.out for job in done], out / "report").path
    return None
