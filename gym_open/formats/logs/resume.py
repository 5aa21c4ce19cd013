"""Going on with the log of a writer that was killed, so that the files become what they would have been.

What was logged after the last checkpoint is played again. It is put aside first, and what is played is compared with
it, message by message: a run that goes another way is found out.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path

from gym_open.formats.logs.container import Damage, Logged, chunks, read_contents, whole_chunks
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.schemas import LogError, LogHead, log_name, parse_log_name
from gym_open.formats.logs.writer import ROLL_BYTES, LogWriter


def resume_writer(
    folder: Path, aside: Path, head: LogHead, messages: int, *, roll_bytes: int = ROLL_BYTES
) -> LogWriter:
    """A writer for `head.stream` in `folder` that goes on after the first `messages` messages of a killed one.

    Finished files that lie wholly before are kept as they are. The rest is moved to `aside`; the messages that belong
    to the checkpoint are copied from there, and all that is written later is held to what follows them. A writer killed
    again loses nothing: of each file, `aside` keeps whichever holds more. If there are no files, the log begins.

    Raises:
        LogError: if the files hold fewer messages; later, from the writer, if a message is not the one that was there.
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
                f"checkpoint was taken after {messages}; they were changed since: restore them, or remove the "
                "unfinished folder to start over"
            )
    except BaseException:
        files.abandon()
        raise
    files.expected = chain.from_iterable(saved)
    return LogWriter(folder, head, roll_bytes=roll_bytes, begun=files)


def _kept(folder: Path, stream: int, messages: int) -> tuple[int, int]:
    """How many finished parts lie wholly before the checkpoint, and how many messages they hold."""
    part, held = 0, 0
    while (count := _finished(folder / log_name(stream, part))) is not None and held + count <= messages:
        part, held = part + 1, held + count
    return part, held


def _finished(path: Path) -> int | None:
    """Messages of a whole file, by its index; None if it is not whole."""
    if not path.is_file():
        return None
    try:
        return sum(sum(chunk.counts.values()) for chunk in read_contents(path).chunks)
    except Damage:
        return None


def _set_aside(folder: Path, aside: Path, stream: int, part: int) -> list[Path]:
    """Move a stream's files from `part` on to `aside`, unless it has more of one already; return what it has then.

    Every file is moved at once and by itself, so this can be cut short anywhere and done again: two files of the same
    part begin alike. Files of other names are no part of the log, and stay.
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


def _whole_chunks(paths: list[Path]) -> Iterator[list[Logged]]:
    """Up to the first damage: what stands in a later file does not follow on that."""
    with suppress(Damage):
        for path in paths:
            yield from chunks(path)


def _messages(path: Path) -> int:
    return sum(map(len, whole_chunks(path)))
