"""Progress of work, for people: units done, speed, and remaining time.

On a terminal, progress is a bar. In a pipe, a file or CI, it is lines: one when work starts, one every ten seconds, and
one when work ends. Both go to standard error.

If the environment variable GYM_OPEN_PROGRESS names a file, a process also writes its progress there, about once per
second. Another process can thus watch many processes at a time.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Protocol

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from gym_open.files import read_regular

console = Console(stderr=True)

EVERY = 10.0
"""Seconds between two progress lines of the same work."""
COMPILES = "the first time on a machine, code is compiled: about a minute"
"""The reason why opening the first world or network may take long."""
FILE = "GYM_OPEN_PROGRESS"
"""Environment variable that names the file into which a process writes its progress."""
_INTERVAL = 1.0
"""Seconds between two writes of that file."""
_MAX_BYTES = 4096
"""Largest number of bytes that are read from that file."""


def on_terminal() -> bool:
    """Whether bars can be drawn. CI may force colours, although its standard error is no terminal."""
    return console.is_jupyter or (console.is_terminal and not console.is_dumb_terminal and console.file.isatty())


def write(line: str) -> None:
    """Write a line to standard error at once. Work goes on if nobody reads standard error any more."""
    if not console.quiet:
        with suppress(OSError, ValueError):  # ValueError: the stream is closed
            console.file.write(f"{line}\n")
            console.file.flush()


def duration(seconds: float) -> str:
    """A duration in a short form: 12 s, 3 min, 2 h 05 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


class Progressed(msgspec.Struct, frozen=True):
    """Progress of a process."""

    done: int
    total: int
    rate: float
    """Units per second since the bar was begun; 0 if unknown."""

    @classmethod
    def read(cls, path: Path) -> "Progressed | None":
        """Read the file at `path`; None if it is missing or damaged."""
        try:
            return msgspec.json.decode(read_regular(path, _MAX_BYTES), type=cls)
        except (OSError, msgspec.DecodeError):
            return None


class _Display(Protocol):
    """A display of a bar's progress."""

    def advance(self, amount: int, note: str | None) -> None: ...


class _ProgressFile:
    """Writes a bar's progress into a file, at intervals: the file must never slow or stop the work."""

    def __init__(self, path: Path, done: int, total: int) -> None:
        self.path, self.done, self.total = path, done, total
        self.first, self.started = done, time.monotonic()
        self.written = -_INTERVAL
        self.advance(0, None)

    def advance(self, amount: int, note: str | None) -> None:
        """Count `amount` units, and write if the interval has passed."""
        del note
        self.done += amount
        now = time.monotonic()
        if now - self.written < _INTERVAL and self.done < self.total:
            return
        self.written = now
        rate = (self.done - self.first) / max(now - self.started, 1e-9)
        temporary = self.path.with_name(f"{self.path.name}.tmp")
        with suppress(OSError):
            temporary.write_bytes(msgspec.json.encode(Progressed(self.done, self.total, rate)))
            temporary.replace(self.path)


class Lines:
    """Writes a bar's progress in lines: one when it is made, one per call of `now`, and one at the end.

    One thread may count while another calls `now`.

    Args:
        title: name of the work.
        total: units of work.
        done: units that an earlier process has done. They do not count for the speed.
        write_line: writes a line.
        clock: returns seconds since any fixed time.
    """

    def __init__(
        self, title: str, total: int, *, done: int = 0, write_line: Callable[[str], None] = write,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._title, self._total, self._first, self._done = title, total, done, done
        self._write_line, self._clock, self._started = write_line, clock, clock()
        self._note = ""
        write_line(f"{title}: {'goes on at ' if done else ''}{done:,} of {total:,}")

    def advance(self, amount: int, note: str | None) -> None:
        """Count `amount` units; a `note` stays until the next note."""
        self._done += amount
        self._note = self._note if note is None else note

    def now(self) -> None:
        """Write a line with the progress."""
        done, rate = self._done, self._rate()
        parts = [f"{done:,} of {self._total:,} ({done / max(self._total, 1):.0%})"]
        if rate:
            parts += [speed(rate), f"{duration(max(self._total - done, 0) / rate)} left"]
        self._say(parts)

    def end(self) -> None:
        """Write a line with the units done and the time taken."""
        seconds, rate = self._clock() - self._started, self._rate()
        took = duration(seconds) if seconds >= 10 else f"{seconds:.1f} s"
        parts = [f"{self._done:,} of {self._total:,} in {took}"]
        self._say([*parts, speed(rate)] if rate else parts)

    def _rate(self) -> float:
        return (self._done - self._first) / max(self._clock() - self._started, 1e-9)

    def _say(self, parts: list[str]) -> None:
        self._write_line(f"{self._title}: {', '.join(parts)}{f'; {self._note}' if self._note else ''}")


class Waiting:
    """Writes in lines how long work without a count has been going on; arguments as in `Lines`."""

    def __init__(
        self, title: str, hint: str = "", *, write_line: Callable[[str], None] = write,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._title, self._why = title, f" ({hint})" if hint else ""
        self._write_line, self._clock, self._started = write_line, clock, clock()

    def now(self) -> None:
        """Write a line."""
        self._write_line(f"{self._title}: {duration(self._clock() - self._started)} so far{self._why}")


class _DrawnBar:
    """A bar on a terminal."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task

    def advance(self, amount: int, note: str | None) -> None:
        """Draw it `amount` units longer."""
        if note is not None:
            self._progress.update(self._task, note=note)
        self._progress.advance(self._task, amount)


class Bar:
    """Progress of some work, on all its displays."""

    def __init__(self, shown: list[_Display]) -> None:
        self._shown = shown

    def advance(self, amount: int = 1, note: str | None = None) -> None:
        """Count `amount` units; `note` is a short text about the work, such as a loss or a score."""
        for display in self._shown:
            display.advance(amount, note)


@contextmanager
def bar(title: str, total: int, *, done: int = 0) -> Iterator[Bar]:
    """Show a bar of `total` units, of which `done` were already done before (after a resume)."""
    file = os.environ.get(FILE)
    shown: list[_Display] = [_ProgressFile(Path(file), done, total)] if file else []
    with ExitStack() as stack:
        if on_terminal():
            shown.append(stack.enter_context(_drawn(title, total, done)))
            yield Bar(shown)
            return
        lines = Lines(title, total, done=done)
        with _repeatedly(lines.now):
            yield Bar([*shown, lines])
        lines.end()  # not after an error, whose message is more important


@contextmanager
def doing(title: str, hint: str = "") -> Iterator[None]:
    """Show that work without a count goes on. The `hint` explains why it may take long.

    Nothing else may be printed during the work.
    """
    if not on_terminal():
        write(f"{title} …")
        with stage(title, hint):
            yield
        return
    why = TextColumn(f"({hint})" if hint else "", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1))
    what = TextColumn("{task.description}", table_column=Column(no_wrap=True, min_width=len(title)))
    columns = (SpinnerColumn(), what, TimeElapsedColumn(), why)
    with Progress(*columns, console=console, transient=True) as progress:
        progress.add_task(title, total=None)
        yield


@contextmanager
def stage(title: str, hint: str = "") -> Iterator[None]:
    """Without a terminal, write a line every ten seconds while work goes on, unless a bar inside does so."""
    if on_terminal():
        yield
        return
    with _repeatedly(Waiting(title, hint).now):
        yield


_talking: list[object] = []
"""Writers of a line every ten seconds, from the outermost to the innermost; only the innermost writes."""
_turn = threading.Lock()
"""Held to write a line, and to add or remove a writer."""


@contextmanager
def _repeatedly(say: Callable[[], None]) -> Iterator[None]:
    """Call `say` every `EVERY` seconds in a separate thread, unless another writer inside does the same."""
    me, over = object(), threading.Event()

    def wait() -> None:
        while not over.wait(EVERY):
            with _turn:
                if _talking[-1:] == [me]:
                    say()

    with _turn:
        _talking.append(me)
    thread = threading.Thread(target=wait, name="gym-open progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        with _turn:
            _talking.remove(me)
        thread.join()


def speed(rate: float) -> str:
    """A speed in units per second as text: 331/s, 4.2/s, 0.03/s."""
    return f"{rate:,.0f}/s" if rate >= 10 else f"{rate:.1f}/s" if rate >= 1 else f"{rate:.1g}/s"


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        rate = task.finished_speed or task.speed
        return Text(speed(rate) if rate else "", style="progress.data.speed")


@contextmanager
def _drawn(title: str, total: int, done: int) -> Iterator[_DrawnBar]:
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
        yield _DrawnBar(progress, progress.add_task(title, total=total, completed=done, note=""))
