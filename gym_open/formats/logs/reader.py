"""Reader of logs: it checks every byte when a log is opened, then reads piece by piece."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.formats.logs import schemas
from gym_open.formats.logs.container import LogMessage
from gym_open.formats.logs.folder import NamedHead, folder_faults
from gym_open.formats.logs.logfile import REPAIR, RESTORE, LogFile, foreign, open_file, open_whole_chunks
from gym_open.formats.logs.messages import PIXELS, decode_stuck, decode_switch
from gym_open.formats.logs.schemas import LogError, Segment, Stuck, Switch, UnfinishedError, log_name
from gym_open.formats.logs.segments import HEADS, decode_record, groups, is_complete, segments

UNFINISHED = "it has no last switch: its writer did not finish"


def found_files(artefact: Path) -> dict[int, dict[int, Path]]:
    """Find the log files in a folder, by stream and part; parts may be missing.

    Raises:
        ArtefactError: if there is no log file.
    """
    streams: dict[int, dict[int, Path]] = {}
    for path in sorted(artefact.glob("stream-*.mcap")):
        if found := schemas.parse_log_name(path.name):
            streams.setdefault(found[0], {})[found[1]] = path
    if not streams:
        raise ArtefactError(f"{artefact}: no logs (stream-*.mcap) in it; make some with `gym-open collect`")
    return {stream: dict(sorted(parts.items())) for stream, parts in sorted(streams.items())}


def log_files(artefact: Path) -> list[list[Path]]:
    """Find the files of a log artefact: the parts of each stream, in order.

    Raises:
        ArtefactError: if there is no log file, or a part is missing.
    """
    found = found_files(artefact)
    for stream, parts in found.items():
        if missing := set(range(max(parts) + 1)) - set(parts):
            raise LogError(
                f"{artefact / log_name(stream, min(missing))}: missing, but a later part is there; {RESTORE}"
            )
    return [list(parts.values()) for parts in found.values()]


class Log:
    """The log of one stream, opened by `open_log`. Opened from a single part, it holds that part only.

    Args:
        files: the parts, in order.
        damage: why the log ends after them, if it should continue; then its last record may be incomplete.
    """

    def __init__(self, files: Sequence[LogFile], damage: str | None = None) -> None:
        self._files = files
        self.damage = damage
        """What is wrong after the last message; None if nothing is wrong."""
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
                switch = decode_switch(message.data)
                if len(switch.world_losses) != len(self.puzzles):
                    raise LogError(
                        f"{self.path}: switch at step {switch.step}: {len(switch.world_losses)} losses for a pool of "
                        f"{len(self.puzzles)} worlds; {RESTORE}"
                    )
                self.switches.append(switch)
            else:
                self.stuck.append(decode_stuck(message.data))
        self.n_steps: int = sum(file.count(schemas.STEP) for file in files)
        if damage is not None and (tail := self._last_record()) and tail[0].topic == schemas.STEP:
            self.n_steps -= not is_complete(tail, self._image_topics)
        self._open_end = files[-1].goes_on or damage is not None
        if not self._open_end and (not self.switches or self.switches[-1].to_world != -1):
            raise UnfinishedError(f"{files[-1].path}: {UNFINISHED}; {REPAIR}")

    @property
    def _image_topics(self) -> set[str]:
        """Topics of the recorded images."""
        return {topic for topic in PIXELS if any(file.count(topic) for file in self._files)}

    def _last_record(self) -> list[LogMessage]:
        """The messages of the last record, as far as the damage left them."""
        tail: list[LogMessage] = []
        places = ((file, place) for file in reversed(self._files) for place in reversed(file.contents.chunks))
        for part, place in places:
            tail = [*part.chunk(place), *tail]
            if begins := [i for i, message in enumerate(tail) if message.topic in HEADS]:
                return tail[begins[-1] :]
        return tail

    def _messages(self, *topics: str) -> Iterator[LogMessage]:
        for file in self._files:
            yield from file.messages(*topics)

    def segments(self, max_steps: int | None = None, steps: range | None = None) -> Iterator[Segment]:
        """Segments in the order in which they were recorded; only one is held in memory.

        Args:
            max_steps: segments with more steps are cut into pieces of this many steps, which bounds memory. The
                observation at a cut is the last of one piece and the first of the next.
            steps: half-open range of the stream's steps; reading begins at the keyframe before the first of them.

        Raises:
            LogError: if the messages do not form segments.
            UsageError: if `max_steps` is less than 1.
        """
        if max_steps is not None and max_steps < 1:
            raise UsageError(f"max_steps: expected 1 or more, got {max_steps}")
        messages = self._messages() if steps is None else self._messages_of(steps)
        records, found = (decode_record(group, self.puzzles) for group in self._groups(messages)), 0
        open_end = self._open_end or steps is not None
        try:
            for piece in segments(records, self.stream, self.reward_parts, max_steps, open_end=open_end):
                found += len(piece.actions)
                yield piece
            if found != self.n_steps and self.damage is None and steps is None:
                raise ValueError(f"it holds {found} steps, its index says {self.n_steps}")
        except ValueError as error:
            raise LogError(f"{self.path}: {error}; {RESTORE}") from None

    def _messages_of(self, steps: range) -> Iterator[LogMessage]:
        """Messages from the keyframe before these steps (or the beginning) to the end of the last of them."""
        first, start = 0, None
        for first in reversed(range(len(self._files))):
            if (start := self._files[first].messages_from(steps.start)) is not None:
                break
        later = (message for file in self._files[first + 1 :] for message in file.messages())
        for message in self._messages() if start is None else chain(start, later):
            if message.time >= steps.stop * schemas.STEP_NS and message.topic in {schemas.STEP, schemas.SEGMENT}:
                return
            yield message

    def _groups(self, messages: Iterator[LogMessage]) -> Iterator[list[LogMessage]]:
        """The messages of each record, without a last record that the damage made incomplete."""
        held: list[LogMessage] | None = None
        for group in groups(messages):
            if held is not None:
                yield held
            held = group
        if held is not None and (self.damage is None or is_complete(held, self._image_topics)):
            yield held


def open_log(source: Path | Sequence[Path]) -> Log:
    """Check every byte of a log and open it.

    Args:
        source: one file (any part of a stream's log), or all parts of a stream in order.

    Raises:
        LogError: if a file is missing, cut off, damaged, or not a log of this format (the message names the byte, the
            last whole step before it, and the remedy), or if the parts are not consecutive.
    """
    alone = isinstance(source, Path)
    files = [open_file(path) for path in ([source] if alone else source)]
    if not alone:
        _check_parts(files)
    return log_of(files)


def log_of(files: Sequence[LogFile], damage: str | None = None) -> Log:
    """Put together the log of checked files: see `Log`.

    Raises:
        LogError: if a switch or a stuck record cannot be decoded.
        UnfinishedError: if the last switch is missing.
    """
    try:
        return Log(files, damage)
    except (ValueError, GymOpenError) as error:
        raise error if isinstance(error, LogError) else foreign(files[0].path, error) from None


def open_logs(artefact: Path) -> list[Log]:
    """Check and open the log of every stream in a log artefact.

    Raises:
        ArtefactError: see `log_files`, `open_log` and `folder_faults`.
    """
    opened = [[open_file(path) for path in parts] for parts in log_files(artefact)]
    for files in opened:
        _check_parts(files)
    heads = [NamedHead(file.path, file.head, file.part) for files in opened for file in files]
    for fault in folder_faults(artefact, heads):
        raise LogError(f"{fault}; {RESTORE}")
    return [log_of(files) for files in opened]


def open_whole_part(files: Sequence[Path]) -> Log:
    """Open the undamaged beginning of a log: it ends at the first damage or missing part.

    Args:
        files: parts of one stream's log, in order; the first parts may be missing.

    Returns:
        A log whose `damage` says why it ends there; `damage` is None if the log is complete.

    Raises:
        LogError: if the head of the first file is damaged or of another format.
    """
    found: list[LogFile] = []
    damage: str | None = None
    for path in files:
        file, wrong = open_whole_chunks(path)
        if found and (file.head != found[0].head or file.part != found[-1].part + 1):
            damage = f"the next part is missing: {path.name} is part {file.part}, of this or another run"
            break
        found.append(file)
        if wrong is not None:
            damage = f"{path.name} is damaged at byte {wrong.offset:,}: {wrong.what}"
            break
    else:
        if len(files) > 1 and found[-1].goes_on:
            damage = f"{log_name(found[-1].head.stream, found[-1].part + 1)}, in which it continues, is missing"
    try:
        return log_of(found, damage)
    except UnfinishedError:
        return log_of(found, UNFINISHED)


def _check_parts(files: Sequence[LogFile]) -> None:
    """Raises LogError if the files are not all the parts of one stream, in order."""
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
            raise LogError(f"{file.path}: the stream continues in {following}, which is missing; {RESTORE}")
        if not last and not file.goes_on:
            raise LogError(f"{file.path}: the stream ends in it, so {files[number + 1].path} is not a part of it")
