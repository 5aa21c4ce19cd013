"""Reading a log: checked byte for byte when it is opened, then one segment in memory at a time."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open.envs.puzzles import Puzzle
from gym_open.errors import ArtefactError, GymOpenError
from gym_open.formats import log_schemas as schemas
from gym_open.formats.log_cdr import CdrReader
from gym_open.formats.log_container import Contents, Damage, Logged, read_chunk, read_contents, whole_chunks
from gym_open.formats.log_schemas import LogError, Segment, SegmentStart, StepRecord, Switch
from gym_open.formats.log_writer import CONFIG, HEAD, MODEL, POOL

_REMEDY = "restore the file from a copy, or run the `gym-open collect` command that wrote it again (it goes on)"


def log_files(artefact: Path) -> list[Path]:
    """The logs in a log artefact, one a stream, in the order of the streams.

    Raises:
        ArtefactError: if there is none.
    """
    found = sorted(artefact.glob("stream-*.mcap"))
    if not found:
        raise ArtefactError(f"{artefact}: no logs (stream-*.mcap) in it; make some with `gym-open collect`")
    return found


class Log:
    """One stream's log, opened by `open_log`."""

    def __init__(self, path: Path, contents: Contents) -> None:
        self.path = path
        self._contents = contents
        head = contents.metadata.get(HEAD, {})
        if head.get("format") != schemas.FORMAT:
            raise ValueError(f"expected the format {schemas.FORMAT!r}, got {head.get('format')!r}")
        if set(contents.attachments) != {CONFIG, MODEL, POOL}:
            raise ValueError(f"expected the attachments {CONFIG}, {MODEL}, {POOL}, got {sorted(contents.attachments)}")
        self.stream = int(head["stream"])
        self.config: dict[str, Any] = msgspec.json.decode(contents.attachments[CONFIG], type=dict[str, Any])
        pool = msgspec.json.decode(contents.attachments[POOL], type=list[msgspec.Raw])
        self.puzzles: tuple[Puzzle, ...] = tuple(Puzzle.from_json(bytes(raw)) for raw in pool)
        self.provenance: dict[str, str] = contents.metadata.get("provenance", {})
        self.model_xml: str = contents.attachments[MODEL].decode()
        self._topics: dict[int, str] = {}
        if contents.chunks:  # the first one names the channels
            list(read_chunk(path, contents.chunks[0], self._topics))
        self.switches: list[Switch] = list(self._read_switches())
        self.n_steps: int = sum(place.counts.get(self._channel(schemas.STEP), 0) for place in contents.chunks)
        if not self.switches or self.switches[-1].to_world != -1:
            raise ValueError("it has no last switch: its writer was not finished")

    def _channel(self, topic: str) -> int:
        return next((number for number, name in self._topics.items() if name == topic), -1)

    def _read_switches(self) -> Iterator[Switch]:
        channel = self._channel(schemas.SWITCH)
        for place in self._contents.chunks:
            if channel in place.counts:
                for message in read_chunk(self.path, place, self._topics):
                    if message.topic == schemas.SWITCH:
                        yield schemas.decode_switch(message.data)

    def segments(self) -> Iterator[Segment]:
        """The segments in the order of play; each is let go before the next is read.

        Raises:
            LogError: if the messages do not make up segments.
        """
        try:
            for start, steps, end in self._collect():
                yield _assemble(self.stream, start, steps, end)
        except Damage as damage:
            raise _error(self.path, damage.offset, damage.what) from None
        except ValueError as error:
            raise LogError(f"{self.path}: {error}; {_REMEDY}") from None

    def _messages(self) -> Iterator[Logged]:
        for place in self._contents.chunks:
            yield from read_chunk(self.path, place, self._topics)

    def _collect(self) -> Iterator[tuple[SegmentStart, list[StepRecord], Switch]]:
        start: SegmentStart | None = None
        steps: list[StepRecord] = []
        waiting: Logged | None = None  # a step or segment whose image comes next
        for message in self._messages():
            if message.topic in {schemas.STEP, schemas.SEGMENT}:
                waiting = message
            elif message.topic == schemas.IMAGE:
                image = schemas.decode_image(message.data)
                if waiting is not None and waiting.topic == schemas.SEGMENT:
                    start, steps = schemas.decode_segment(waiting.data, self.puzzles, image), []
                elif waiting is not None:
                    steps.append(schemas.decode_step(waiting.data, image))
                else:
                    raise ValueError("an image follows neither a step nor the start of a segment")
                waiting = None
            elif message.topic == schemas.SWITCH and start is not None:
                yield start, steps, schemas.decode_switch(message.data)
                start = None


def open_log(path: Path) -> Log:
    """Check the log at `path`, every byte of it, and open it.

    Raises:
        LogError: if it is missing, cut off, damaged, or not a log of this format; the message names the byte, the last
            whole step before it, and what to do.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such log; make one with `gym-open collect`")
    try:
        return Log(path, read_contents(path))
    except Damage as damage:
        raise _error(path, damage.offset, damage.what) from None
    except (ValueError, KeyError, GymOpenError) as error:
        raise LogError(f"{path}: not a log of gym-open, or of another version: {error}; {_REMEDY}") from None


def _error(path: Path, offset: int, what: str) -> LogError:
    last = _last_whole_step(path, offset)
    whole = "no step before it is whole" if last is None else f"the last whole step is {last}"
    return LogError(f"{path}: damaged at byte {offset}: {what}; {whole}; {_REMEDY}")


def _last_whole_step(path: Path, end: int) -> int | None:
    last: bytes | None = None
    for chunk in whole_chunks(path, end):
        last = next((message.data for message in reversed(chunk) if message.topic == schemas.STEP), last)
    return None if last is None else CdrReader(last).integer("Q")


def _assemble(stream: int, start: SegmentStart, steps: list[StepRecord], end: Switch) -> Segment:
    """Lay the records of a segment out as arrays. Raises ValueError if one is missing or out of place."""
    expected = [(start.index, start.first_step + i, i) for i in range(len(steps))]
    if [(step.segment, step.step, step.segment_step) for step in steps] != expected or end.reason == "start":
        raise ValueError(f"the steps of segment {start.index} are not complete and in order")
    if end.step != start.first_step + len(steps):
        raise ValueError(f"segment {start.index} ends at step {end.step}, but {len(steps)} steps are there")
    return Segment(
        stream=stream,
        index=start.index,
        world=start.world,
        puzzle=start.puzzle,
        continued=start.continued,
        first_step=start.first_step,
        object_names=start.object_names,
        integration_state=start.integration_state,
        images=np.stack([start.image, *(step.image for step in steps)]),
        actions=np.array([step.action for step in steps], dtype=np.int64),
        object_state=np.stack([start.object_state, *(step.object_state for step in steps)]),
        contacts=[step.contacts for step in steps],
        intrinsic_reward=_column(steps, "intrinsic_reward"),
        world_model_loss=_column(steps, "world_model_loss"),
        policy_entropy=_column(steps, "policy_entropy"),
        value=_column(steps, "value"),
        ended=end.reason,
    )


def _column(steps: list[StepRecord], name: str) -> np.ndarray:
    return np.array([getattr(step, name) for step in steps], dtype=np.float64)
