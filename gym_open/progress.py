"""What a person sees while work goes on: one progress bar with rate and remaining time.

A process whose environment names a file in GYM_OPEN_PROGRESS also writes there, about once a second, how far its bar
is: so many processes side by side can be watched.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from gym_open.files import read_regular

console = Console(stderr=True)

FILE = "GYM_OPEN_PROGRESS"
"""Environment variable that names the file in which a process says how far it is."""
_INTERVAL = 1.0
"""Seconds between two writes of that file."""
_MAX_BYTES = 4096
"""Of that file that are read."""


class Progressed(msgspec.Struct, frozen=True):
    """How far a process is."""

    done: int
    total: int
    rate: float
    """Units a second since the bar was begun; 0 if nothing is known yet."""

    @classmethod
    def read(cls, path: Path) -> "Progressed | None":
        """What the file at `path` says, or None if it says nothing that can be read."""
        try:
            return msgspec.json.decode(read_regular(path, _MAX_BYTES), type=cls)
        except (OSError, msgspec.DecodeError):
            return None


class _Reporter:
    """Writes how far a bar is into a file, now and then: a watcher must never slow or stop the work."""

    def __init__(self, path: Path, done: int, total: int) -> None:
        self.path, self.done, self.total = path, done, total
        self.first, self.started = done, time.monotonic()
        self.written = -_INTERVAL
        self.advance(0)

    def advance(self, amount: int) -> None:
        """Count `amount` units, and write if it is time to."""
        self.done += amount
        now = time.monotonic()
        if now - self.written < _INTERVAL and self.done < self.total:
            return
        self.written = now
        rate = (self.done - self.first) / max(now - self.started, 1e-9)
        beside = self.path.with_name(f"{self.path.name}.tmp")
        with suppress(OSError):
            beside.write_bytes(msgspec.json.encode(Progressed(self.done, self.total, rate)))
            beside.replace(self.path)


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:,.0f}/s" if speed else "", style="progress.data.speed")


class Bar:
    """A running progress bar; `note` is a short live text (a loss, a score)."""

    def __init__(self, progress: Progress, task: TaskID, reporter: _Reporter | None) -> None:
        self._progress, self._task, self._reporter = progress, task, reporter

    def advance(self, amount: int = 1, note: str | None = None) -> None:
        """Move on by `amount` units."""
        if note is not None:
            self._progress.update(self._task, note=note)
        self._progress.advance(self._task, amount)
        if self._reporter is not None:
            self._reporter.advance(amount)


@contextmanager
def bar(title: str, total: int, *, done: int = 0) -> Iterator[Bar]:
    """Show a bar of `total` units titled `title`, `done` of them already behind us (after a resume)."""

    def fixed(width: int) -> Column:
        return Column(min_width=width, no_wrap=True)

    columns = (
        TextColumn("{task.description}", table_column=fixed(14)),
        BarColumn(bar_width=10, table_column=fixed(10)),
        MofNCompleteColumn(table_column=fixed(11)),
        _Rate(table_column=fixed(8)),
        TimeRemainingColumn(table_column=fixed(7)),
        TextColumn("{task.fields[note]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(title, total=total, completed=done, note="")
        file = os.environ.get(FILE)
        yield Bar(progress, task, _Reporter(Path(file), done, total) if file else None)
