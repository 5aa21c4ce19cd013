"""Repair of a damaged log file: all records up to the last whole step before the damage go into a new file."""

import re
import shutil
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np

from gym_open import progress
from gym_open.formats.logs import schemas
from gym_open.formats.logs.cdr import CdrReader
from gym_open.formats.logs.container import Damage, LogMessage, first_number, whole_chunks
from gym_open.formats.logs.logfile import LogFile, open_whole_chunks
from gym_open.formats.logs.messages import PIXELS, decode_switch
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.reader import UNFINISHED, Log, log_of, open_log
from gym_open.formats.logs.schemas import LogError, SegmentStart, Switch, UnfinishedError, log_name
from gym_open.formats.logs.segments import decode_record, groups, is_complete

_NO_LIMIT = sys.maxsize
"""Size at which a next file would begin: a repaired log has one file."""
_PIECE = 256
"""Steps held in memory while a file is read."""
_UNFINISHED = re.compile(r"\.(.+)\.partial")
"""Name of the folder of an unfinished artefact: its files belong to the run that makes it."""


class RepairedLog(msgspec.Struct, frozen=True):
    """The result of a repair."""

    saved: Path | None
    """The new file; None if the old file is complete."""
    steps: int = 0
    """Number of saved steps."""
    last_step: int | None = None
    """Number of the last saved step within the stream."""
    offset: int = 0
    """Offset of the damage in the old file."""
    missing_bytes: int = 0
    """Bytes from there to the end of the old file."""
    what: str = ""
    """Description of the damage."""
    cut: bool = False
    """True: steps were lost. False: all steps were saved, and only the file's index was lost."""


class _Saved(msgspec.Struct):
    """The beginning of a file that can be saved."""

    groups: int = 0
    """Number of its records."""
    steps: int = 0
    last_step: int | None = None
    end: Switch | None = None
    """The switch to add after them; None if the stream had ended, or continues in another part."""


def repair(path: Path) -> RepairedLog:
    """Write the undamaged beginning of the log file at `path` to `NAME-repaired.mcap` in the same folder.

    If `path` lies in the unfinished folder `.ARTEFACT.partial` of an artefact, the new file is
    `ARTEFACT-NAME-repaired.mcap` next to that folder. The new file is complete or absent; it is read back before it
    gets its name. If steps were lost, it ends with a switch whose reason is `cut`. The old file stays unchanged.

    Raises:
        LogError: if nothing can be saved (the file is not a log, its head is damaged, it has no whole step, or its
            messages do not form a log), or if the new file exists already.
    """
    target = _target(path)
    file, found = open_whole_chunks(path)
    found = found or _no_end(file)
    if found is None:
        return RepairedLog(saved=None)
    if target.exists():
        raise LogError(f"{target}: exists already and is not overwritten; move it away and run the command again")
    with progress.bar("repairing", 2 * len(file.contents.chunks)) as bar:
        try:
            saved = _saved(file, bar)
            _write(file, target, saved, bar)
        except ValueError as error:
            raise LogError(f"{path}: not written by `gym-open collect`: {error}; nothing can be saved") from None
    return RepairedLog(
        saved=target, steps=saved.steps, last_step=saved.last_step, offset=found.offset, what=found.what,
        missing_bytes=path.stat().st_size - found.offset, cut=saved.end is not None,
    )  # fmt: skip


def _target(path: Path) -> Path:
    """Path of the new file."""
    for folder in path.absolute().parents:
        if unfinished := _UNFINISHED.fullmatch(folder.name):
            return folder.with_name(f"{unfinished[1]}-{path.stem}-repaired.mcap")
    return path.with_name(f"{path.stem}-repaired.mcap")


def _no_end(file: LogFile) -> Damage | None:
    """Whether a file without damage lacks the last switch. Raises LogError if its messages do not form a log."""
    try:
        _read(log_of([file]))
    except UnfinishedError:
        return Damage(file.path.stat().st_size, UNFINISHED)
    return None


def _read(log: Log) -> None:
    for _ in log.segments(_PIECE):
        pass


def _complete(path: Path, bar: progress.Bar) -> Iterator[list[LogMessage]]:
    """Messages of each complete record, in order; the last record may be incomplete."""

    def messages() -> Iterator[LogMessage]:
        for chunk in whole_chunks(path):
            yield from chunk
            bar.advance()

    held: list[LogMessage] = []
    images: set[str] = set()
    for group in groups(messages()):
        if held:
            yield held
        held = group
        if group[0].topic == schemas.SEGMENT:
            images = images or {message.topic for message in group} & set(PIXELS)
    if held and is_complete(held, images):
        yield held


def _saved(file: LogFile, bar: progress.Bar) -> _Saved:
    """Find the last record that can be saved. Raises LogError if there is no step before it."""
    saved, switched, world, now = _Saved(), 0, -1, 0
    last = Switch(0, -1, -1, "start", [np.nan] * len(file.head.puzzles))
    for group in _complete(file.path, bar):
        topic, _, data = group[0]
        if topic == schemas.SEGMENT:
            start = decode_record(group, file.head.puzzles)
            assert isinstance(start, SegmentStart)
            world, now = start.world, start.first_step + start.segment_step
        elif topic == schemas.STEP:
            saved.last_step = CdrReader(data).integer("Q")
            saved.steps, now = saved.steps + 1, saved.last_step + 1
        elif topic == schemas.SWITCH:
            last, switched, world = decode_switch(data), saved.groups, -1
        saved.groups += 1
    if not saved.steps:
        raise LogError(f"{file.path}: no whole step in it before the damage; nothing can be saved")
    if file.goes_on:
        return saved
    if world >= 0:
        saved.end = Switch(now, world, -1, "cut", last.world_losses)
    elif last.to_world >= 0:  # no record of the world that the stream entered was saved
        saved.groups, saved.end = switched, msgspec.structs.replace(last, to_world=-1, reason="cut")
    return saved


def _write(file: LogFile, target: Path, saved: _Saved, bar: progress.Bar) -> None:
    path = file.path
    partial = target.with_name(f".{target.stem}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        files = LogParts(partial, file.head, _NO_LIMIT, part=file.part, messages=first_number(path))
        try:
            for group in islice(_complete(path, bar), saved.groups):
                for message in group:
                    files.put(message)
            if saved.end is not None:
                files.add(saved.end)
            files.finish(goes_on=file.goes_on)
        except BaseException:
            files.abandon()
            raise
        made = partial / log_name(file.head.stream, file.part)
        try:
            _read(open_log(made))
        except LogError as error:  # no byte is damaged, but the messages do not form a log
            raise LogError(f"{str(error).replace(str(made), str(path))}; nothing can be saved") from None
        made.rename(target)
    finally:
        shutil.rmtree(partial)
