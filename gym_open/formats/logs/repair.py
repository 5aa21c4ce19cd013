"""Saving what is whole of a damaged log file: everything up to the last step before the damage, in a file beside it."""

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
from gym_open.formats.logs.container import Damage, Logged, first_number, whole_chunks
from gym_open.formats.logs.logfile import LogFile, open_whole_chunks
from gym_open.formats.logs.messages import PIXELS, decode_switch
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.reader import UNFINISHED, Log, log_of, open_log
from gym_open.formats.logs.schemas import LogError, SegmentStart, Switch, UnfinishedError, log_name
from gym_open.formats.logs.segments import decode_record, groups, is_complete

_NO_LIMIT = sys.maxsize
"""Bytes at which a file would roll: a repaired one does not."""
_PIECE = 256
"""Steps in memory at a time while a file is read."""
_UNFINISHED = re.compile(r"\.(.+)\.partial")
"""Name of the folder of an artefact in the making: what is in it belongs to the run that makes it."""


class Repair(msgspec.Struct, frozen=True):
    """What came of a repair."""

    saved: Path | None
    """The new file; None if the old one is whole."""
    steps: int = 0
    """Steps saved."""
    last_step: int | None = None
    """The stream's number of the last of them."""
    offset: int = 0
    """First byte of the old file that cannot be right."""
    missing_bytes: int = 0
    """From there to its end."""
    what: str = ""
    """What is wrong there."""
    cut: bool = False
    """Whether play went on in what is missing; else all of it was saved, and only the file's index was lost."""


class _Whole(msgspec.Struct):
    """The part of a file that can be saved."""

    groups: int = 0
    """How many records, from the first on."""
    steps: int = 0
    last_step: int | None = None
    end: Switch | None = None
    """The switch to add after them; None if play had ended, or goes on in a further part."""


def repair(path: Path) -> Repair:
    """Write what is whole of the log file at `path` to `NAME-repaired.mcap` beside it.

    If it lies in an artefact's unfinished folder `.ARTEFACT.partial`, the new file is `ARTEFACT-NAME-repaired.mcap`
    beside that. The new file is whole or absent; it is read back before it gets its name. If play went on in what is
    missing, it ends with a switch whose reason is `cut`. The old file is left as it is.

    Raises:
        LogError: if nothing can be saved: the file is none of ours, its head is damaged, no step in it is whole, or its
            bytes are whole but what they say makes no log; or if the new file is there already.
    """
    target = _target(path)
    file, found = open_whole_chunks(path)
    found = found or _no_end(file)
    if found is None:
        return Repair(saved=None)
    if target.exists():
        raise LogError(f"{target}: is there already and is not overwritten; move it away and run the command again")
    with progress.bar("repairing", 2 * len(file.contents.chunks)) as bar:
        try:
            whole = _whole(file, bar)
            _write(file, target, whole, bar)
        except ValueError as error:
            raise LogError(f"{path}: not written by `gym-open collect`: {error}; nothing can be saved") from None
    return Repair(
        saved=target, steps=whole.steps, last_step=whole.last_step, offset=found.offset, what=found.what,
        missing_bytes=path.stat().st_size - found.offset, cut=whole.end is not None,
    )  # fmt: skip


def _target(path: Path) -> Path:
    """Where the new file goes."""
    for folder in path.absolute().parents:
        if unfinished := _UNFINISHED.fullmatch(folder.name):
            return folder.with_name(f"{unfinished[1]}-{path.stem}-repaired.mcap")
    return path.with_name(f"{path.stem}-repaired.mcap")


def _no_end(file: LogFile) -> Damage | None:
    """Whether a file without damage lacks the last switch. Raises LogError if its messages make no log."""
    try:
        _read(log_of([file]))
    except UnfinishedError:
        return Damage(file.path.stat().st_size, UNFINISHED)
    return None


def _read(log: Log) -> None:
    for _ in log.segments(_PIECE):
        pass


def _complete(path: Path, bar: progress.Bar) -> Iterator[list[Logged]]:
    """Messages of each record that is whole, in order: of the last one, some may be missing."""

    def messages() -> Iterator[Logged]:
        for chunk in whole_chunks(path):
            yield from chunk
            bar.advance()

    held: list[Logged] = []
    pictures: set[str] = set()
    for group in groups(messages()):
        if held:
            yield held
        held = group
        if group[0].topic == schemas.SEGMENT:
            pictures = pictures or {message.topic for message in group} & set(PIXELS)
    if held and is_complete(held, pictures):
        yield held


def _whole(file: LogFile, bar: progress.Bar) -> _Whole:
    """Find the last record that can be saved. Raises LogError if there is no step before it."""
    whole, switched, world, now = _Whole(), 0, -1, 0
    last = Switch(0, -1, -1, "start", [np.nan] * len(file.head.puzzles))
    for group in _complete(file.path, bar):
        topic, _, data = group[0]
        if topic == schemas.SEGMENT:
            start = decode_record(group, file.head.puzzles)
            assert isinstance(start, SegmentStart)
            world, now = start.world, start.first_step + start.segment_step
        elif topic == schemas.STEP:
            whole.last_step = CdrReader(data).integer("Q")
            whole.steps, now = whole.steps + 1, whole.last_step + 1
        elif topic == schemas.SWITCH:
            last, switched, world = decode_switch(data), whole.groups, -1
        whole.groups += 1
    if not whole.steps:
        raise LogError(f"{file.path}: no whole step in it before the damage; nothing can be saved")
    if file.goes_on:
        return whole
    if world >= 0:
        whole.end = Switch(now, world, -1, "cut", last.world_losses)
    elif last.to_world >= 0:  # the world that was entered has left no trace
        whole.groups, whole.end = switched, msgspec.structs.replace(last, to_world=-1, reason="cut")
    return whole


def _write(file: LogFile, target: Path, whole: _Whole, bar: progress.Bar) -> None:
    path = file.path
    partial = target.with_name(f".{target.stem}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        files = LogParts(partial, file.head, _NO_LIMIT, part=file.part, messages=first_number(path))
        try:
            for group in islice(_complete(path, bar), whole.groups):
                for message in group:
                    files.put(message)
            if whole.end is not None:
                files.add(whole.end)
            files.finish(goes_on=file.goes_on)
        except BaseException:
            files.abandon()
            raise
        made = partial / log_name(file.head.stream, file.part)
        try:
            _read(open_log(made))
        except LogError as error:  # bytes that are all right, but make no log
            raise LogError(f"{str(error).replace(str(made), str(path))}; nothing can be saved") from None
        made.rename(target)
    finally:
        shutil.rmtree(partial)
