"""One file of a log: the check of its bytes, its head, and its messages."""

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from gym_open.envs.puzzles import Puzzle
from gym_open.errors import GymOpenError
from gym_open.formats.logs import schemas
from gym_open.formats.logs.cdr import CdrReader
from gym_open.formats.logs.container import (
    ChunkPlace,
    Contents,
    Damage,
    LogMessage,
    read_chunk,
    read_head,
    scan,
    whole_chunks,
)
from gym_open.formats.logs.schemas import LogError, LogHead

RESTORE = "restore the file from a copy, or run the `gym-open collect` command that wrote it again (it continues)"
REPAIR = f"{RESTORE}, or save the undamaged beginning with `gym-open log repair`"
"""The remedy where at least one step can be saved."""
MAX_NESTING = 64
"""Greatest nesting of lists and tables in a configuration. Ours have three levels; Python fails at about a thousand."""


class LogFile(NamedTuple):
    """One file of a log whose bytes were checked."""

    path: Path
    contents: Contents
    head: LogHead
    part: int
    goes_on: bool
    """Whether the stream continues in another part."""

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return sum(place.counts.get(self._channel(topic), 0) for place in self.contents.chunks)

    def _channel(self, topic: str) -> int:
        return next((number for number, name in self.contents.topics.items() if name == topic), -1)

    def messages(self, *topics: str) -> Iterator[LogMessage]:
        """Messages in the order of writing. With `topics`, only those; chunks without them are not unpacked.

        Raises:
            LogError: if a chunk is damaged.
        """
        wanted = {self._channel(topic) for topic in topics}
        for place in self.contents.chunks:
            if not wanted or wanted & set(place.counts):
                yield from (message for message in self.chunk(place) if not topics or message.topic in topics)

    def messages_from(self, step: int) -> Iterator[LogMessage] | None:
        """Messages from the last keyframe at or before a step of the stream; None if there is no such keyframe.

        It unpacks at most a few of the chunks before that keyframe.

        Raises:
            LogError: if a chunk is damaged.
        """
        time, places = step * schemas.STEP_NS, self.contents.chunks
        for number in reversed(range(len(places))):
            if places[number].time > time or self._channel(schemas.SEGMENT) not in places[number].counts:
                continue
            chunk = self.chunk(places[number])
            frames = [i for i, one in enumerate(chunk) if one.topic == schemas.SEGMENT and one.time <= time]
            if frames:
                later = (message for place in places[number + 1 :] for message in self.chunk(place))
                return chain(chunk[frames[-1] :], later)
        return None

    def chunk(self, place: ChunkPlace) -> list[LogMessage]:
        """Messages of one chunk.

        Raises:
            LogError: if the chunk is damaged.
        """
        try:
            return list(read_chunk(self.path, place, self.contents.topics))
        except Damage as damage:
            raise damaged(self.path, damage) from None


def open_file(path: Path) -> LogFile:
    """Check every byte of the file at `path`.

    Raises:
        LogError: if it is missing, cut off, damaged, or not a log of this format.
    """
    file, damage = open_whole_chunks(path)
    if damage is not None:
        raise damaged(path, damage)
    return file


def open_whole_chunks(path: Path) -> tuple[LogFile, Damage | None]:
    """Check every byte of the file at `path`; a damaged file keeps only the chunks before the damage.

    Raises:
        LogError: if it is missing, not a log of this format, or damaged before its first message.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log; make one with `gym-open collect`")
    try:
        before = read_head(path)
        head, part = parse_head(before)  # a large file of another format is refused before all of it is read
        contents, damage = scan(path)
        following = contents.metadata.get(schemas.CONTINUES)
        if damage is None:
            _check_attachments(contents)
            _check_channels(contents)
            contents = _counted(path, contents)
        elif not contents.chunks or contents.chunks[-1].offset >= damage.offset:
            following = None  # the record stands after the damage
        if following not in (None, {"part": str(part + 1)}):
            raise ValueError(f"part {part} continues in {following}, expected part {part + 1}")
        if damage is not None:
            contents = _before_damage(path, contents, damage, before)
    except Damage as damage:
        raise damaged(path, damage) from None
    except (ValueError, KeyError, GymOpenError) as error:
        raise foreign(path, error) from None
    return LogFile(path, contents, head, part, goes_on=following is not None), damage


def _counted(path: Path, found: Contents) -> Contents:
    """The same with the number of messages of chunks that have no index, which MCAP allows; they are unpacked."""
    numbers = {topic: number for number, topic in found.topics.items()}
    places = []
    for place in found.chunks:
        if not place.counts:
            topics = Counter(message.topic for message in read_chunk(path, place, dict(found.topics)))
            place = place._replace(counts={numbers[topic]: count for topic, count in topics.items()})  # noqa: PLW2901
        places.append(place)
    return found._replace(chunks=places)


def _before_damage(path: Path, found: Contents, damage: Damage, head: Contents) -> Contents:
    """The head and the chunks before the damage. The channels are read from the first chunk.

    Messages are counted in the chunks themselves, because the index may be lost or damaged.
    """
    places = [place for place in found.chunks if place.offset < damage.offset]
    topics: dict[int, str] = {}
    counts = [Counter(message.topic for message in read_chunk(path, place, topics)) for place in places]
    numbers = {topic: number for number, topic in topics.items()}
    counted = [
        place._replace(counts={numbers[topic]: count for topic, count in of_place.items()})
        for place, of_place in zip(places, counts, strict=True)
    ]
    return head._replace(chunks=counted, channels={number: (topic, 0) for number, topic in topics.items()})


def parse_head(contents: Contents) -> tuple[LogHead, int]:
    """Decode a file's head and the number of its part.

    Raises:
        ValueError, KeyError, GymOpenError: if the format is another one, or a field is missing or invalid.
    """
    try:
        return _parse_head(contents)
    except RecursionError:
        raise ValueError("JSON in it is nested too deeply; refused") from None


def _parse_head(contents: Contents) -> tuple[LogHead, int]:
    head = contents.metadata.get(schemas.HEAD, {})
    if head.get("format") != schemas.FORMAT:
        raise ValueError(f"expected the format {schemas.FORMAT!r}, got {head.get('format')!r}")
    _check_attachments(contents)
    if (step_ns := _number(head, "step_ns")) != schemas.STEP_NS:
        raise ValueError(f"step_ns: expected {schemas.STEP_NS}, got {step_ns}")
    pool = msgspec.json.decode(contents.attachments[schemas.POOL], type=list[msgspec.Raw])
    config = msgspec.json.decode(contents.attachments[schemas.CONFIG], type=dict[str, Any])
    check_nesting(config)
    return LogHead(
        stream=_number(head, "stream"),
        config=config,
        puzzles=tuple(Puzzle.from_json(bytes(raw)) for raw in pool),
        provenance=contents.metadata.get(schemas.PROVENANCE, {}),
        model_xml=contents.attachments[schemas.MODEL].decode(),
        reward_parts=msgspec.json.decode(head["reward_parts"], type=tuple[str, ...]),
        keyframe_every=_number(head, "keyframe_every", least=1),
    ), _number(head, "part")


def check_nesting(value: Any) -> None:
    """Check how deep plain data is nested.

    Raises:
        RecursionError: if the nesting is deeper than `MAX_NESTING`.
    """
    level = [value]
    for _ in range(MAX_NESTING):
        level = [item for one in level if isinstance(one, dict | list) for item in _items(one)]
    if level:
        raise RecursionError


def _items(value: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value


def _number(head: dict[str, str], name: str, *, least: int = 0) -> int:
    """Raises ValueError if the number is not in our writer's form, KeyError if it is missing."""
    text = head[name]
    number = int(text) if text.isdecimal() else -1
    if not (least <= number < 2**31 and str(number) == text):
        raise ValueError(f"{name}: expected a whole number from {least} on, got {text!r}")
    return number


def _check_attachments(contents: Contents) -> None:
    """Raises ValueError if the file lacks an attachment or has another one."""
    expected = {schemas.CONFIG, schemas.MODEL, schemas.POOL}
    if set(contents.attachments) != expected:
        raise ValueError(f"expected the attachments {sorted(expected)}, got {sorted(contents.attachments)}")


def _check_channels(contents: Contents) -> None:
    """Raises ValueError if the file's topics and message types are not exactly ours."""
    found = {topic: contents.schemas.get(schema) for topic, schema in contents.channels.values()}
    for topic in found | schemas.DEFINITIONS:
        if topic not in found or found[topic] != schemas.DEFINITIONS.get(topic):
            raise ValueError(f"the messages of {topic!r} are not of the type that {schemas.FORMAT!r} has for them")


def foreign(path: Path, error: Exception) -> LogError:
    """Return the error for a file that is not a log of this format."""
    remedy = "give a file that `gym-open collect` of this version wrote"
    return LogError(f"{path}: not a log of gym-open, or of another version: {error}; {remedy}")


def damaged(path: Path, damage: Damage) -> LogError:
    """Return the error that says where a file is damaged and how much before the damage is whole."""
    last = _last_whole_step(path, damage.offset)
    whole = f"no step before it is whole; {RESTORE}" if last is None else f"the last whole step is {last}; {REPAIR}"
    return LogError(f"{path}: damaged at byte {damage.offset}: {damage.what}; {whole}")


def _last_whole_step(path: Path, end: int) -> int | None:
    last: bytes | None = None
    for chunk in whole_chunks(path, end):
        last = next((message.data for message in reversed(chunk) if message.topic == schemas.STEP), last)
    return None if last is None else CdrReader(last).integer("Q")
