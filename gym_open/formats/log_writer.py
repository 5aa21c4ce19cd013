"""Writing a log: one MCAP file a stream, whose bytes depend on what is logged and on nothing else."""

import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from gym_open.artefacts import canonical_json
from gym_open.envs.puzzles import Puzzle
from gym_open.formats import log_schemas as schemas
from gym_open.formats.log_container import Logged, whole_chunks
from gym_open.formats.log_schemas import LogError, SegmentStart, StepRecord, Switch

CHUNK_BYTES = 4 * 2**20
"""A chunk is closed when it holds this much, or at `flush`."""
CONFIG, MODEL, POOL, HEAD = "config.json", "model.xml", "puzzles.json", "gym-open"


class LogHead(msgspec.Struct, frozen=True):
    """What a log says about itself: with it the log alone suffices to replay what it holds."""

    stream: int
    config: dict[str, Any]
    puzzles: tuple[Puzzle, ...]
    """The pool; worlds are named by their place in it."""
    provenance: dict[str, str]
    """Code version, package versions, seed."""
    model_xml: str


class LogWriter:
    """Writes one stream's log at `path`; use as a context, or call `close`.

    A segment is a `segment`, then a `step` for each action; a `switch` goes before the first segment and after every
    one. What was written before a `flush` outlives the process.
    """

    def __init__(self, path: Path, head: LogHead) -> None:
        self._path = path
        self._file = path.open("wb")
        self._writer = Writer(self._file, CHUNK_BYTES, CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True)
        self._writer.start(profile="ros2")
        self._channels: dict[str, int] = {}
        for topic, (name, definition) in schemas.DEFINITIONS.items():
            schema = self._writer.register_schema(name, SchemaEncoding.ROS2, definition.encode())
            self._channels[topic] = self._writer.register_channel(topic, MessageEncoding.CDR, schema)
        pool = canonical_json([msgspec.json.decode(puzzle.to_json()) for puzzle in head.puzzles])
        self._attach(CONFIG, "application/json", canonical_json(head.config))
        self._attach(MODEL, "application/xml", head.model_xml.encode())
        self._attach(POOL, "application/json", pool)
        identity = {"format": schemas.FORMAT, "step_ns": str(schemas.STEP_NS), "stream": str(head.stream)}
        self._writer.add_metadata(HEAD, identity)
        self._writer.add_metadata("provenance", dict(sorted(head.provenance.items())))
        self._expected: Iterator[Logged] = iter(())
        self.messages = 0
        """Messages written so far."""

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def resume(self, killed: Path, messages: int) -> None:
        """Take over the first `messages` messages of a killed writer's file, and hold what follows to the rest of it.

        Raises:
            LogError: if the file holds fewer; later, from any write, if a message is not the one that had been logged.
        """
        chunks = whole_chunks(killed)
        while self.messages < messages:
            chunk = next(chunks, None)
            if chunk is None:
                raise LogError(
                    f"{killed}: its whole chunks hold {self.messages} messages, the checkpoint was taken after "
                    f"{messages}; the file was changed since: restore it, or remove the unfinished folder to start over"
                )
            for message in chunk:
                self._add(message)
            self.flush()
        self._expected = chain.from_iterable(chunks)

    def _add(self, message: Logged) -> None:
        expected = next(self._expected, message)
        if expected != message:
            raise LogError(
                f"{self._path}: message {self.messages} ({message.topic}) is not the one that had been logged before "
                "the run was killed, so going on would not be the same run (another machine or changed packages?); "
                "the old log is kept: move the unfinished folder away to start over"
            )
        self._writer.add_message(
            channel_id=self._channels[message.topic], log_time=message.time, publish_time=message.time,
            sequence=self.messages, data=message.data,
        )  # fmt: skip
        self.messages += 1

    def segment(self, start: SegmentStart) -> None:
        """Log that a world is entered, with its first observation."""
        time = start.first_step * schemas.STEP_NS
        self._add(Logged(schemas.SEGMENT, time, schemas.encode_segment(start)))
        self._image(start.image, time)

    def step(self, record: StepRecord) -> None:
        """Log an action at its beginning and the observation at its end."""
        time = record.step * schemas.STEP_NS
        self._add(Logged(schemas.STEP, time, schemas.encode_step(record)))
        self._add(Logged(schemas.METRICS, time, schemas.encode_metrics(record, time)))
        self._image(record.image, time + schemas.STEP_NS)

    def _image(self, image: np.ndarray, time: int) -> None:
        self._add(Logged(schemas.IMAGE, time, schemas.encode_image(image, time)))

    def switch(self, switch: Switch) -> None:
        """Log a decision of the curriculum, for programs and in words."""
        time = switch.step * schemas.STEP_NS
        text = f"step {switch.step}: world {switch.from_world} -> {switch.to_world} ({switch.reason})"
        self._add(Logged(schemas.SWITCH, time, schemas.encode_switch(switch)))
        self._add(Logged(schemas.EVENTS, time, schemas.encode_text(text)))

    def flush(self) -> None:
        """End the chunk: all that was written is safe from a kill of this process."""
        self._writer.flush()

    def sync(self) -> None:
        """Flush to the disk itself: safe from a power cut too."""
        self.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index; the file is whole after this."""
        self._writer.finish()
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self._file.close()  # unfinished on purpose: a reader must see that the log is not whole
