"""The files of one stream's log: when a file is large enough, the next one begins."""

import os
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from gym_open.artefacts import canonical_json
from gym_open.formats.logs import schemas
from gym_open.formats.logs.container import LogMessage
from gym_open.formats.logs.mcap import McapWriter
from gym_open.formats.logs.messages import messages_of
from gym_open.formats.logs.schemas import LogError, LogHead, Record, SegmentStart


class LogParts:
    """Writes the records of one stream in `folder`, from part `part` on; for one thread at a time.

    Raises:
        LogError: from any method, if the disk is full, or a message differs from the `expected` one.
    """

    def __init__(self, folder: Path, head: LogHead, roll_bytes: int, *, part: int = 0, messages: int = 0) -> None:
        self._folder, self._head, self._roll_bytes = folder, head, roll_bytes
        self.messages = messages
        """Number of messages in all parts."""
        self.expected: Iterator[LogMessage] = iter(())
        """Messages that a killed writer had written after this point; new messages are compared with them."""
        self._open(part)

    def _open(self, part: int) -> None:
        self._part, self._first = part, self.messages
        self._path = self._folder / schemas.log_name(self._head.stream, part)
        with self._full_disk():
            self._file = self._path.open("wb")
            self._writer = McapWriter(self._file)
            self._write_head()

    def _write_head(self) -> None:
        head, writer = self._head, self._writer
        self._channels = {topic: writer.channel(topic, *type_) for topic, type_ in schemas.DEFINITIONS.items()}
        pool = canonical_json([msgspec.json.decode(puzzle.to_json()) for puzzle in head.puzzles])
        for name, media_type, data in (
            (schemas.CONFIG, "application/json", canonical_json(head.config)),
            (schemas.MODEL, "application/xml", head.model_xml.encode()),
            (schemas.POOL, "application/json", pool),
        ):
            writer.attach(name, media_type, data)
        identity = {
            "format": schemas.FORMAT,
            "keyframe_every": str(head.keyframe_every),
            "part": str(self._part),
            "reward_parts": msgspec.json.encode(head.reward_parts).decode(),
            "step_ns": str(schemas.STEP_NS),
            "stream": str(head.stream),
        }
        writer.metadata(schemas.HEAD, identity)
        writer.metadata(schemas.PROVENANCE, dict(sorted(head.provenance.items())))

    def add(self, record: Record, *, ends: Container[int] = (), starts: Container[int] = ()) -> None:
        """Write a record; a keyframe goes into a new file if the present file is large enough.

        Args:
            record: the record.
            ends: numbers of messages in all parts after which a chunk ends.
            starts: numbers of messages before which a file begins.
        """
        if self.messages in starts:
            self._roll()
        if isinstance(record, SegmentStart) and self.messages > self._first and self._writer.size >= self._roll_bytes:
            self._roll()
        for message in messages_of(record, self._head.reward_parts):
            self.put(message)
            if self.messages in ends:
                self.flush()

    def _roll(self) -> None:
        self.finish(goes_on=True)
        self._open(self._part + 1)

    def put(self, message: LogMessage) -> None:
        """Write a message."""
        expected = next(self.expected, message)
        if expected != message:
            raise LogError(
                f"{self._path}: message {self.messages} ({message.topic}) differs from the one logged before the run "
                "was killed, so this would be another run (another machine or changed packages?); the old log is kept: "
                "move the unfinished folder away to start over"
            )
        try:
            self._writer.message(self._channels[message.topic], self.messages, message.time, message.data)
        except OSError as error:
            raise self._unwritable(error) from error
        self.messages += 1

    def flush(self) -> None:
        """End the chunk: all messages so far survive a kill of this process."""
        with self._full_disk():
            self._writer.flush()

    def sync(self) -> None:
        """Flush to the disk: all messages so far survive a power cut."""
        self.flush()
        with self._full_disk():
            os.fsync(self._file.fileno())

    def finish(self, *, goes_on: bool = False) -> None:
        """Write the file's index, which completes it; `goes_on` notes that another part continues the stream."""
        with self._full_disk():
            if goes_on:
                self._writer.flush()
                self._writer.metadata(schemas.CONTINUES, {"part": str(self._part + 1)})
            self._writer.finish()
            os.fsync(self._file.fileno())
            self._file.close()

    def abandon(self) -> None:
        """Close the file without an index, so that readers see that the log is incomplete."""
        with suppress(OSError):
            self._file.close()

    @contextmanager
    def _full_disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> LogError:
        return LogError(
            f"{self._path}: cannot be written ({error.strerror}); what was written before is kept: make room, then "
            "run the same command again (it continues)"
        )
