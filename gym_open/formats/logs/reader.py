"""Reading a log: checked byte for byte when it is opened, then as much of it in memory at a time as is asked for."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from gym_open.envs.puzzles import Puzzle
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.formats.logs import schemas
from gym_open.formats.logs.cdr import CdrReader
from gym_open.formats.logs.container import (
    Contents,
    Damage,
    Logged,
    read_chunk,
    read_contents,
    read_head,
    whole_chunks,
)
from gym_open.formats.logs.messages import decode_stuck, decode_switch
from gym_open.formats.logs.schemas import LogError, LogHead, Segment, Stuck, Switch, UnfinishedError, log_name
from gym_open.formats.logs.segments import decode_record, groups, segments

RESTORE = "restore the file from a copy, or run the `gym-open collect` command that wrote it again (it goes on)"
REPAIR = f"{RESTORE}, or save what is whole with `gym-open log repair`"
"""The remedy where there is something that can be saved."""
MAX_NESTING = 64
"""Levels of lists and tables that a configuration may have: ours have three, and Python gives up at some thousand."""
UNFINISHED = "it has no last switch: its writer was not finished"


def found_files(artefact: Path) -> dict[int, dict[int, Path]]:
    """The log files in a folder, by stream and part, whether all are there or not.

    Raises:
        ArtefactError: if there is none.
    """
    streams: dict[int, dict[int, Path]] = {}
    for path in sorted(artefact.glob("stream-*.mcap")):
        if found := schemas.parse_log_name(path.name):
            streams.setdefault(found[0], {})[found[1]] = path
    if not streams:
        raise ArtefactError(f"{artefact}: no logs (stream-*.mcap) in it; make some with `gym-open collect`")
    return {stream: dict(sorted(parts.items())) for stream, parts in sorted(streams.items())}


def log_files(artefact: Path) -> list[list[Path]]:
    """The files of a log artefact: the parts of each stream, both in order.

    Raises:
        ArtefactError: if there is none, or a part is missing.
    """
    found = found_files(artefact)
    for stream, parts in found.items():
        if missing := set(range(max(parts) + 1)) - set(parts):
            raise LogError(
                f"{artefact / log_name(stream, min(missing))}: missing, but a later part is there; {RESTORE}"
            )
    return [list(parts.values()) for parts in found.values()]


class LogFile(NamedTuple):
    """One file of a log, every byte of it checked."""

    path: Path
    contents: Contents
    head: LogHead
    part: int
    goes_on: bool
    """Whether the stream goes on in a further part."""

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return sum(place.counts.get(self._channel(topic), 0) for place in self.contents.chunks)

    def _channel(self, topic: str) -> int:
        return next((number for number, name in self.contents.topics.items() if name == topic), -1)

    def messages(self, *topics: str) -> Iterator[Logged]:
        """Messages in the order of writing, or only those of some topics: that spares unpacking other chunks.

        Raises:
            LogError: if a chunk is damaged.
        """
        wanted = {self._channel(topic) for topic in topics}
        for place in self.contents.chunks:
            if wanted and not wanted & set(place.counts):
                continue
            try:
                chunk = list(read_chunk(self.path, place, self.contents.topics))
            except Damage as damage:
                raise damaged(self.path, damage) from None
            yield from (message for message in chunk if not topics or message.topic in topics)


class Log:
    """One stream's log, opened by `open_log`; of a single file that is a part of it, what that file holds."""

    def __init__(self, files: Sequence[LogFile]) -> None:
        self._files = files
        head = files[0].head
        self.path = files[0].path
        """The first file."""
        self.stream, self.config, self.puzzles = head.stream, head.config, head.puzzles
        self.provenance, self.model_xml = head.provenance, head.model_xml
        self.reward_parts, self.keyframe_every = head.reward_parts, head.keyframe_every
        self.switches: list[Switch] = []
        self.stuck: list[Stuck] = []
        for message in self._messages(schemas.SWITCH, schemas.STUCK):
            if message.topic == schemas.SWITCH:
                self.switches.append(decode_switch(message.data))
            else:
                self.stuck.append(decode_stuck(message.data))
        self.n_steps: int = sum(file.count(schemas.STEP) for file in files)
        self._open_end = files[-1].goes_on
        if not self._open_end and (not self.switches or self.switches[-1].to_world != -1):
            raise UnfinishedError(f"{files[-1].path}: {UNFINISHED}; {REPAIR}")

    def _messages(self, *topics: str) -> Iterator[Logged]:
        for file in self._files:
            yield from file.messages(*topics)

    def segments(self, max_steps: int | None = None) -> Iterator[Segment]:
        """The segments in the order of play; each is let go before the next is read.

        Args:
            max_steps: longer segments come in pieces of this many steps, so that memory does not grow with their
                length. The observation at a cut is the last one of a piece and the first one of the next.

        Raises:
            LogError: if the messages do not make up segments.
            UsageError: if `max_steps` is less than 1.
        """
        if max_steps is not None and max_steps < 1:
            raise UsageError(f"max_steps: expected 1 or more, got {max_steps}")
        records, steps = (decode_record(group, self.puzzles) for group in groups(self._messages())), 0
        try:
            for piece in segments(records, self.stream, self.reward_parts, max_steps, open_end=self._open_end):
                steps += len(piece.actions)
                yield piece
            if steps != self.n_steps:
                raise ValueError(f"it holds {steps} steps, its index tells of {self.n_steps}")
        except ValueError as error:
            raise LogError(f"{self.path}: {error}; {RESTORE}") from None


def open_log(source: Path | Sequence[Path]) -> Log:
    """Check a log, every byte of it, and open it.

    Args:
        source: one file, which may be any part of a stream's log, or all parts of one, in order.

    Raises:
        LogError: if a file is missing, cut off, damaged, or not a log of this format (the message names the byte, the
            last whole step before it, and what to do), or if the parts do not follow on one another.
    """
    alone = isinstance(source, Path)
    files = [open_file(path) for path in ([source] if alone else source)]
    if not alone:
        _check_parts(files)
    try:
        return Log(files)
    except (ValueError, GymOpenError) as error:
        raise error if isinstance(error, LogError) else _foreign(files[0].path, error) from None


def open_logs(artefact: Path) -> list[Log]:
    """Every stream's log in a log artefact, all parts checked.

    Raises:
        ArtefactError: as `log_files` and `open_log` do.
    """
    return [open_log(parts) for parts in log_files(artefact)]


def open_file(path: Path) -> LogFile:
    """Check the one file at `path`, every byte of it.

    Raises:
        LogError: if it is missing, cut off, damaged, or not a log of this format.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log; make one with `gym-open collect`")
    try:
        parse_head(read_head(path))  # before all of a large file is read that is not ours
        contents = read_contents(path)
        head, part = parse_head(contents)
        _check_channels(contents)
        following = contents.metadata.get(schemas.CONTINUES)
        if following not in (None, {"part": str(part + 1)}):
            raise ValueError(f"part {part} goes on in {following}, expected part {part + 1}")
    except Damage as damage:
        raise damaged(path, damage) from None
    except (ValueError, KeyError, GymOpenError) as error:
        raise _foreign(path, error) from None
    return LogFile(path, contents, head, part, goes_on=following is not None)


def parse_head(contents: Contents) -> tuple[LogHead, int]:
    """What a file says about itself, and the number of its part.

    Raises:
        ValueError, KeyError, GymOpenError: if it is of another format, or something in it is not as it should be.
    """
    try:
        return _parse_head(contents)
    except RecursionError:
        raise ValueError("JSON in it is nested too deeply; refused") from None


def _parse_head(contents: Contents) -> tuple[LogHead, int]:
    head = contents.metadata.get(schemas.HEAD, {})
    if head.get("format") != schemas.FORMAT:
        raise ValueError(f"expected the format {schemas.FORMAT!r}, got {head.get('format')!r}")
    expected = {schemas.CONFIG, schemas.MODEL, schemas.POOL}
    if set(contents.attachments) != expected:
        raise ValueError(f"expected the attachments {sorted(expected)}, got {sorted(contents.attachments)}")
    if (step_ns := _number(head, "step_ns")) != schemas.STEP_NS:
        raise ValueError(f"step_ns: expected {schemas.STEP_NS}, got {step_ns}")
    pool = msgspec.json.decode(contents.attachments[schemas.POOL], type=list[msgspec.Raw])
    config = msgspec.json.decode(contents.attachments[schemas.CONFIG], type=dict[str, Any])
    _check_nesting(config)
    return LogHead(
        stream=_number(head, "stream"),
        config=config,
        puzzles=tuple(Puzzle.from_json(bytes(raw)) for raw in pool),
        provenance=contents.metadata.get(schemas.PROVENANCE, {}),
        model_xml=contents.attachments[schemas.MODEL].decode(),
        reward_parts=msgspec.json.decode(head["reward_parts"], type=tuple[str, ...]),
        keyframe_every=_number(head, "keyframe_every", least=1),
    ), _number(head, "part")


def _check_nesting(value: Any) -> None:
    """Raises RecursionError as the decoder does, before something else would."""
    level = [value]
    for _ in range(MAX_NESTING):
        level = [item for one in level if isinstance(one, dict | list) for item in _items(one)]
    if level:
        raise RecursionError


def _items(value: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value


def _number(head: dict[str, str], name: str, *, least: int = 0) -> int:
    """Raises ValueError if it is not there as our writers put it, KeyError if not at all."""
    text = head[name]
    number = int(text) if text.isdecimal() else -1
    if not (least <= number < 2**31 and str(number) == text):
        raise ValueError(f"{name}: expected a whole number from {least} on, got {text!r}")
    return number


def _check_channels(contents: Contents) -> None:
    """Raises ValueError if the file does not name our topics, each with the type of its messages, and no other."""
    found = {topic: contents.schemas.get(schema) for topic, schema in contents.channels.values()}
    for topic in found | schemas.DEFINITIONS:
        if topic not in found or found[topic] != schemas.DEFINITIONS.get(topic):
            raise ValueError(f"the messages of {topic!r} are not of the type that {schemas.FORMAT!r} has for them")


def _check_parts(files: Sequence[LogFile]) -> None:
    """Raises LogError if the files are not all parts of one stream."""
    for number, file in enumerate(files):
        if file.head != files[0].head:
            raise LogError(
                f"{file.path}: of another run or stream than {files[0].path}: its configuration, pool, model or "
                "provenance differs; give the parts of one stream"
            )
        if file.part != number:
            raise LogError(f"{file.path}: part {file.part} of its stream, expected part {number}; give all, in order")
        last = number == len(files) - 1
        if last and file.goes_on:
            following = log_name(file.head.stream, number + 1)
            raise LogError(f"{file.path}: the stream goes on in {following}, which is missing; {RESTORE}")
        if not last and not file.goes_on:
            raise LogError(f"{file.path}: the stream ends in it, so {files[number + 1].path} is not a part of it")


def _foreign(path: Path, error: Exception) -> LogError:
    remedy = "give a file that `gym-open collect` of this version wrote"
    return LogError(f"{path}: not a log of gym-open, or of another version: {error}; {remedy}")


def damaged(path: Path, damage: Damage) -> LogError:
    """The error that says where a file is damaged and how much before it is whole."""
    last = _last_whole_step(path, damage.offset)
    whole = f"no step before it is whole; {RESTORE}" if last is None else f"the last whole step is {last}; {REPAIR}"
    return LogError(f"{path}: damaged at byte {damage.offset}: {damage.what}; {whole}")


def _last_whole_step(path: Path, end: int) -> int | None:
    last: bytes | None = None
    for chunk in whole_chunks(path, end):
        last = next((message.data for message in reversed(chunk) if message.topic == schemas.STEP), last)
    return None if last is None else CdrReader(last).integer("Q")
