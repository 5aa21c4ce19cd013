"""A job as a process of its own, which ends when the runner ends, and what is known of a job."""

import itertools
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gym_open import artefacts
from gym_open.grid.plan import GridJob
from gym_open.processes import end_with_parent
from gym_open.progress import FILE, Progressed

PROGRAM = (sys.executable, "-m", "gym_open.cli")
_TAIL = 10_000
"""Bytes at the end of a log in which `Child.reason` searches for the reason of a failure."""


JobState = Literal["waiting", "running", "made", "up to date", "failed", "held up"]


@dataclass
class GridJobStatus:
    """The state of a job."""

    job: GridJob
    state: JobState = "waiting"
    seconds: float = 0.0
    """Run time so far, or in all."""
    progress: Progressed | None = None
    reason: str = ""
    """Why it failed."""

    @property
    def done(self) -> bool:
        """Whether its artefact exists."""
        return self.state in ("made", "up to date")

    @property
    def ended(self) -> bool:
        """Whether its state is final."""
        return self.done or self.state in ("failed", "held up")


class Child:
    """The process of one job. Its output is appended to `NAME.log`, and `NAME.progress` holds its progress."""

    def __init__(self, job: GridJob, folder: Path) -> None:
        self.job, self.log = job, folder / f"{job.name}.log"
        self._progress = folder / f"{job.name}.progress"
        self._progress.unlink(missing_ok=True)
        self._sealed_before = _sealed(job)
        self._started = time.monotonic()
        with self.log.open("ab") as output:
            output.write(f"$ {alone(job, folder)}\n".encode())
            output.flush()
            self._process = subprocess.Popen(  # noqa: S603  (our own command)
                [*PROGRAM, *job.words(folder)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "OMP_NUM_THREADS": "1", FILE: str(self._progress)},
                start_new_session=True,
                preexec_fn=end_with_parent,  # noqa: PLW1509  (the runner has one thread, so it may be forked)
            )

    @property
    def seconds(self) -> float:
        """Seconds since it was started."""
        return time.monotonic() - self._started

    def progress(self) -> Progressed | None:
        """Its progress, if it has written any."""
        return Progressed.read(self._progress)

    def poll(self) -> int | None:
        """Its exit code. None while it runs."""
        code = self._process.poll()
        if code is not None:
            self._progress.unlink(missing_ok=True)
        return code

    def has_made(self) -> bool:
        """Whether the artefact has changed since the process was started."""
        return _sealed(self.job) != self._sealed_before

    def end(self, sign: signal.Signals) -> None:
        """Send a signal to the process and to all processes that it started, unless it has ended."""
        if self.poll() is None:
            os.killpg(self._process.pid, sign)

    def reason(self) -> str:
        """Why it failed: its last error message, else its last output, or the signal that ended it."""
        code = self._process.returncode
        if code < 0:
            return f"ended by {signal.Signals(-code).name}"
        with self.log.open("rb") as file:
            file.seek(max(self.log.stat().st_size - _TAIL, 0))
            lines = file.read().decode(errors="replace").splitlines()
        lines = lines[max((i for i, line in enumerate(lines) if line.startswith("$ ")), default=0) :]  # of this attempt
        printed = [line.strip("│ ") for line in lines if re.search(r"\w", line)]
        errors = [line.removeprefix("error: ") for line in printed if line.startswith("error: ")]
        return (errors or _boxed(lines) or printed)[-1]  # at least the command itself


def _boxed(lines: list[str]) -> list[str]:
    """What was wrong with the options of a command. tyro prints it in a box, above a line and some advice."""
    top = max((i for i, line in enumerate(lines) if line.startswith("╭")), default=len(lines))
    inside = [line.strip("│ ") for line in lines[top + 1 :]]
    first = list(itertools.takewhile(lambda line: re.search(r"\w", line), inside))
    return [" ".join(first)] if first else []


def alone(job: GridJob, folder: Path) -> str:
    """The command that runs this job alone, as a user would type it."""
    return f"OMP_NUM_THREADS=1 gym-open {shlex.join(job.words(folder))}"


def _sealed(job: GridJob) -> int | None:
    """When the job's artefact was sealed, in nanoseconds. None if there is no artefact."""
    try:
        return (job.out / artefacts.MANIFEST).stat().st_mtime_ns
    except OSError:
        return None
