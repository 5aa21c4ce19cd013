"""Continuation of the log of a killed writer; the files become those of an uninterrupted run.

A resumed run repeats the steps after its last checkpoint. Their messages are moved aside first, and the repeated ones
are compared with them, so that a run that differs is detected.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path

from gym_open.formats.logs.container import Damage, LogMessage, chunks, read_contents, whole_chunks
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.schemas import LogError, LogHead, log_name, parse_log_name
from gym_open.formats.logs.writer import ROLL_BYTES, LogWriter


def resume_writer(
    folder: Path, aside: Path, head: LogHead, messages: int, *, roll_bytes: int = ROLL_BYTES
) -> LogWriter:
    """Return a writer for `head.stream` in `folder` that continues after a killed writer's first `messages` messages.

    Complete files before that point stay as they are. The other files are moved to `aside`. Their messages up to that
    point are copied from there; later messages of the new writer are compared with the remaining ones. A writer that is
    killed again loses nothing: of each file, `aside` keeps the version with more messages. Without files, a new log
    begins.

    Raises:
        LogError: if the files hold fewer messages; later, from the writer, if a message differs from the earlier one.
    """
    part, before = _kept(folder, head.stream, messages)
    old = _set_aside(folder, aside, head.stream, part)
    files = LogParts(folder, head, roll_bytes, part=part, messages=before)
    saved = _whole_chunks(old)
    try:
        while files.messages < messages and (chunk := next(saved, None)) is not None:
            for message in chunk:
                files.put(message)
            files.flush()
        if files.messages != messages:
            raise LogError(
                f"{folder}: the whole chunks of stream {head.stream}'s log hold {files.messages} messages, the "
                f"checkpoint was taken after {messages}; the files were changed since: restore them, or remove the "
                "unfinished folder to start over"
            )
    except BaseException:
        files.abandon()
        raise
    files.expected = chain.from_iterable(saved)
    return LogWriter(folder, head, roll_bytes=roll_bytes, begun=files)


def _kept(folder: Path, stream: int, messages: int) -> tuple[int, int]:
    """Number of complete parts before the checkpoint, and number of their messages."""
    part, held = 0, 0
    while (count := _finished(folder / log_name(stream, part))) is not None and held + count <= messages:
        part, held = part + 1, held + count
    return part, held


def _finished(path: Path) -> int | None:
    """Number of messages of a complete file, from its index; None if the file is incomplete."""
    if not path.is_file():
        return None
    try:
        return sum(sum(chunk.counts.values()) for chunk in read_contents(path).chunks)
    except Damage:
        return None


def _set_aside(folder: Path, aside: Path, stream: int, part: int) -> list[Path]:
    """Move a stream's files from `part` on to `aside`, unless the file there has more messages; return the files there.

    Each move is atomic and independent, so this function can be interrupted anywhere and repeated: two files of the
    same part begin with the same messages. Files with other names do not belong to the log and stay.
    """
    aside.mkdir(exist_ok=True)
    for path in folder.glob(f"stream-{stream:03d}-*.mcap"):
        named, kept = parse_log_name(path.name), aside / path.name
        if named and named[1] >= part and not (kept.is_file() and _messages(kept) > _messages(path)):
            path.rename(kept)
    return list(_following(aside, stream, part))


def _following(folder: Path, stream: int, part: int) -> Iterator[Path]:
    while (path := folder / log_name(stream, part)).is_file():
        yield path
        part += 1


def _whole_chunks(paths: list[Path]) -> Iterator[list[LogMessage]]:
    """Chunks up to the first damage; later files do not continue from there."""
    with suppress(Damage):
        for path in paths:
            yield from chunks(path)


def _messages(path: Path) -> int:
    return sum(map(len, whole_chunks(path)))
