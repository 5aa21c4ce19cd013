"""Sub-commands on logs: information, replay and repair."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gym_open.cli.base import ArtefactCommand, Command, report, say, say_made, say_next, show
from gym_open.errors import GymOpenError
from gym_open.summary import short, word


@dataclass(frozen=True, kw_only=True)
class LogInfo(Command):
    """Show what log files contain, channel by channel, and whether they are complete. It fails if they are damaged.

    Example: gym-open log info collect/logs/curl-ride
    """

    log: Annotated[Path, tyro.conf.Positional]
    """A log file (.mcap), or a folder of log files."""

    about = "show what log files contain, and whether they are complete"

    def run(self) -> None:
        """Read the files and print tables."""
        from gym_open.formats.logs.info import info_tables

        tables, wrong = info_tables(self.log)
        show(*tables)
        for fault in wrong:
            say(fault)
        if wrong:
            raise GymOpenError(
                f"{short(self.log)}: {len(wrong)} fault(s), see above; `gym-open log repair FILE` saves what is whole"
            )


@dataclass(frozen=True, kw_only=True)
class LogReplay(Command):
    """Simulate the logged actions again from every keyframe, and compare states, contacts and pixels with the log.

    Example: gym-open log replay collect/logs/curl-ride --streams 0
    """

    log: Annotated[Path, tyro.conf.Positional]
    """A log file (.mcap), or a folder of log files."""
    tolerance: float = 1e-3
    """Largest difference of a number (m, m/s, rad/s, N s) before a window counts as diverged."""
    streams: tuple[int, ...] = ()
    """Only these streams; all by default."""

    about = "replay logs and compare every pixel"

    def run(self) -> None:
        """Replay the log, and fail if a window has diverged."""
        from gym_open.replay.table import replay_report

        report = replay_report(self.log, self.tolerance, self.streams)
        show(*report.tables)
        for note in report.notes:
            say(note)
        show(f"verdict: [bold]{report.verdict}[/]")
        if report.verdict == "diverged":
            raise GymOpenError(f"{short(self.log)}: the replay has diverged, first in {report.first_diverged}")


@dataclass(frozen=True, kw_only=True)
class LogPack(ArtefactCommand):
    """Pack a log as its actions and the explorer's own values; everything else is simulated again.

    Example: gym-open log pack collect/logs/random
    """

    log: Annotated[Path, tyro.conf.Positional]
    """Folder of a log from `gym-open collect`."""
    out: Path | None = None
    """Folder of the packed log; default the log's folder with -packed added to its name."""

    about = "pack a log as its actions"

    def run(self) -> None:
        """Pack the log, and restore it once to check every byte."""
        from gym_open.replay.compact.logs import pack_log

        made = pack_log(self.log, self.out or self.log.with_name(f"{self.log.name}-packed"))
        report(made, f"gym-open log restore {word(made.path)} --out FOLDER")


@dataclass(frozen=True, kw_only=True)
class LogRestore(Command):
    """Make a log again from a packed log: the same bytes.

    Example: gym-open log restore collect/logs/random-packed --out collect/logs/random
    """

    packed: Annotated[Path, tyro.conf.Positional]
    """Folder of a packed log."""
    out: Path
    """Folder of the log."""

    about = "make a log again from a packed log"

    def run(self) -> None:
        """Restore the log."""
        from gym_open.replay.compact.logs import restore_log

        restore_log(self.packed, self.out)
        say_made(self.out, f"gym-open log info {word(self.out)}")


@dataclass(frozen=True, kw_only=True)
class LogRepair(Command):
    """Save the intact part of a damaged log file as NAME-repaired.mcap in the same folder.

    Example: gym-open log repair stream-000-002.mcap
    """

    log: Annotated[Path, tyro.conf.Positional]
    """The log file (.mcap)."""

    about = "save the intact part of a damaged log file"

    def run(self) -> None:
        """Save the intact part, and print what is missing."""
        from gym_open.formats.logs.repair import repair

        made = repair(self.log)
        if made.saved is None:
            say(f"{short(self.log)} is complete, nothing to do")
            return
        say_made(made.saved, note=f"{made.steps:,} steps")
        say(f"  damaged at byte {made.offset:,}: {made.what}")
        missing = f"all steps after {made.last_step:,}" if made.cut else "no steps, only the file's index"
        say(f"  missing: {missing}; the last {made.missing_bytes:,} bytes are left out")
        say_next(f"gym-open log replay {word(made.saved)}")
