"""Sub-commands on logs: what is in them, whether they play out again as they were, and saving damaged ones."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gym_open.cli.base import Command, out, say
from gym_open.errors import GymOpenError
from gym_open.summary import short, word


@dataclass(frozen=True, kw_only=True)
class LogInfo(Command):
    """Say what log files hold, channel by channel, and whether they are whole.

    Example: gym-open log info collect/logs/curl-ride
    """

    log: Annotated[Path, tyro.conf.Positional]
    """A log file (.mcap), or a folder of them."""

    about = "what log files hold, and whether they are whole"

    def run(self) -> None:
        """Read and print."""
        from gym_open.formats.logs.info import info_tables

        for table in info_tables(self.log):
            out.print(table)


@dataclass(frozen=True, kw_only=True)
class LogReplay(Command):
    """Simulate logged actions again from every keyframe and compare states, contacts and pixels with the log.

    Example: gym-open log replay collect/logs/curl-ride --streams 0
    """

    log: Annotated[Path, tyro.conf.Positional]
    """A log file (.mcap), or a folder of them."""
    tolerance: float = 1e-3
    """How far a number (m, m/s, rad/s, N s) may be off before a window has diverged."""
    streams: tuple[int, ...] = ()
    """Only these streams; default all."""

    about = "play logs again and compare, to the pixel"

    def run(self) -> None:
        """Replay, print, and fail if anything has diverged."""
        from gym_open.replay.table import replay_report

        report = replay_report(self.log, self.tolerance, self.streams)
        for table in report.tables:
            out.print(table)
        for note in report.notes:
            say(note)
        out.print(f"verdict: [bold]{report.verdict}[/]")
        if report.verdict == "diverged":
            raise GymOpenError(f"{short(self.log)}: the replay has diverged, first in {report.first_diverged}")


@dataclass(frozen=True, kw_only=True)
class LogRepair(Command):
    """Save what is whole of a damaged log file in a file beside it, NAME-repaired.mcap.

    Example: gym-open log repair stream-000-002.mcap
    """

    log: Annotated[Path, tyro.conf.Positional]
    """The log file (.mcap)."""

    about = "save what is whole of a damaged log file"

    def run(self) -> None:
        """Save it and say what is missing."""
        from gym_open.formats.logs.repair import repair

        made = repair(self.log)
        if made.saved is None:
            say(f"{short(self.log)} is whole, nothing to do")
            return
        say(f"{short(made.saved)}: {made.steps:,} steps", verb="made")
        say(f"  damaged at byte {made.offset:,}: {made.what}")
        gone = f"all after step {made.last_step:,}" if made.cut else "no step, only the file's index"
        left = f"the last {made.missing_bytes:,} bytes are left out"
        say(f"  missing: {gone}; {left}")
        say(f"  next: gym-open log replay {word(made.saved)}")
