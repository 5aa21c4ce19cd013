"""Shows a grid while it runs: a live table on a terminal, and one line per change elsewhere."""

import time
from collections import Counter
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from gym_open.grid.child import GridJobStatus
from gym_open.progress import duration, speed
from gym_open.terminal import printable

_STYLES = {
    "waiting": "dim", "running": "cyan", "made": "green", "up to date": "green", "failed": "bold red", "held up": "red",
}  # fmt: skip
_EVERY = 60.0
"""Seconds between two lines on the overall progress, where there is no terminal."""


class Screen:
    """Shows the jobs. On a terminal, nothing else may print while it is open."""

    def __init__(self, console: Console) -> None:
        self.console = console
        # No refresh thread: a process without other threads can be forked safely.
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._printed: dict[str, str] = {}
        self._summarised = time.monotonic()

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._live:
            self._live.stop()

    def show(self, statuses: Mapping[str, GridJobStatus], left: float) -> None:
        """Show the state of the jobs, and the seconds that are left."""
        if self._live:
            self._live.update(table(statuses, left, self.console.height), refresh=True)
        else:
            self._print(statuses, left)

    def _print(self, statuses: Mapping[str, GridJobStatus], left: float) -> None:
        for name, status in statuses.items():
            if status.state not in ("waiting", self._printed.get(name)):
                self._printed[name] = status.state
                took = f" ({duration(status.seconds)})" if status.seconds else ""
                reason = f": {status.reason}" if status.reason else ""
                self._line(f"{name}: {status.state}{took}{reason}")
        if time.monotonic() - self._summarised >= _EVERY:
            self._summarised = time.monotonic()
            self._line(summary(statuses, left))
            for name, status in statuses.items():
                if status.state == "running":
                    self._line(f"  {name}: {how_far(status)}")

    def _line(self, text: str) -> None:
        self.console.print(printable(text), highlight=False, markup=False, soft_wrap=True)


def table(statuses: Mapping[str, GridJobStatus], left: float, height: int) -> RenderableType:
    """The jobs that fit on a screen of `height` lines: running ones first, then failed ones, then the next ones."""
    order = ("running", "failed", "waiting", "held up", "made", "up to date")
    ordered = sorted(statuses.values(), key=lambda status: order.index(status.state))
    room = max(height - 4, 1)
    shown = Table(box=None, pad_edge=False, show_header=False)
    for ratio in (3, None, None, None, None):
        shown.add_column(no_wrap=True, overflow="ellipsis", ratio=ratio)
    for status in ordered[:room]:
        share = status.progress.done / max(status.progress.total, 1) if status.progress else 0.0
        is_running = status.state == "running"
        shown.add_row(
            Text(printable(status.job.name)),
            Text(status.state, style=_STYLES[status.state]),
            ProgressBar(total=1.0, completed=share, width=10) if is_running else "",
            Text(how_far(status) if is_running else printable(status.reason)),
            Text(duration(status.seconds) if status.seconds else ""),
        )
    more = [Text(f"… and {len(ordered) - room} more", style="dim")] if len(ordered) > room else []
    return Group(Text(summary(statuses, left), style="bold"), shown, *more)


def summary(statuses: Mapping[str, GridJobStatus], left: float) -> str:
    """One line on all jobs together."""
    states = Counter(status.state for status in statuses.values())
    done = states["made"] + states["up to date"]
    parts = [f"{done} of {len(statuses)} jobs done"]
    parts += [f"{states[state]} {state}" for state in ("running", "failed", "held up") if states[state]]
    if left:
        parts.append(f"about {duration(left)} left")
    return ", ".join(parts)


def how_far(status: GridJobStatus) -> str:
    """Finished and total units, speed, and remaining time of a running job."""
    progress = status.progress
    if progress is None:
        return "starting"
    words = f"{progress.done:,}/{progress.total:,}"
    if progress.rate:
        left = (progress.total - progress.done) / progress.rate
        words += f"  {speed(progress.rate)}  {duration(left)} left"
    return words
