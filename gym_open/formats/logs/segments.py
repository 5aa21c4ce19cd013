"""Assembly of messages into records, and of records into segments or pieces of them."""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.logs import schemas
from gym_open.formats.logs.container import LogMessage
from gym_open.formats.logs.messages import (
    PIXELS,
    decode_image,
    decode_segment,
    decode_step,
    decode_stuck,
    decode_switch,
)
from gym_open.formats.logs.schemas import Ended, Keyframe, Record, Segment, SegmentStart, StepRecord, Switch

HEADS = {schemas.SEGMENT, schemas.STEP, schemas.SWITCH, schemas.STUCK}
"""Topics of the messages that begin a record."""


def groups(messages: Iterable[LogMessage]) -> Iterator[list[LogMessage]]:
    """Group messages by record: first the record's own message, then its images, metrics or event.

    Raises:
        ValueError: if the first message does not begin a record.
    """
    group: list[LogMessage] = []
    for message in messages:
        if message.topic in HEADS:
            if group:
                yield group
            group = [message]
        elif not group:
            raise ValueError(f"{message.topic} follows neither a step nor the start of a segment")
        else:
            group.append(message)
    if group:
        yield group


def is_complete(group: list[LogMessage], images: Collection[str]) -> bool:
    """Whether all messages of a record are there; the last record before a damage may lack some.

    Args:
        group: from `groups`.
        images: topics of the images that the log records.
    """
    needed = {
        schemas.SEGMENT: {*images},
        schemas.STEP: {*images, schemas.METRICS},
        schemas.SWITCH: {schemas.EVENTS},
        schemas.STUCK: {schemas.EVENTS},
    }
    return needed[group[0].topic] <= {message.topic for message in group}


def decode_record(group: list[LogMessage], pool: tuple[Puzzle, ...]) -> Record:
    """Decode the record of a group of messages; puzzles are looked up in `pool`.

    Raises:
        ValueError: if a message is missing or not of its type.
    """
    topic, _, data = group[0]
    if topic == schemas.SWITCH:
        return decode_switch(data)
    if topic == schemas.STUCK:
        return decode_stuck(data)
    images = {message.topic: decode_image(message.topic, message.data) for message in group if message.topic in PIXELS}
    if schemas.IMAGE not in images:
        raise ValueError(f"{topic} at {group[0].time} ns is not followed by {schemas.IMAGE}")
    image, depth, segmentation = (images.get(name) for name in (schemas.IMAGE, schemas.DEPTH, schemas.SEGMENTATION))
    assert image is not None
    if topic == schemas.STEP:
        return decode_step(data, image, depth, segmentation)
    return decode_segment(data, pool, image, depth, segmentation)


class _SegmentPiece:
    """Collects the steps of a segment from one observation on."""

    def __init__(self, start: SegmentStart, before: SegmentStart | StepRecord, segment_step: int) -> None:
        self.start = start
        """The last keyframe; it holds what is the same in the whole segment."""
        self.before = before
        """The record with the observation before the first action."""
        self.segment_step = segment_step
        self.keyframes: list[Keyframe] = []
        self.steps: list[StepRecord] = []

    @property
    def last(self) -> SegmentStart | StepRecord:
        """The record with the last observation so far."""
        return self.steps[-1] if self.steps else self.before

    @property
    def next_step(self) -> int:
        """Number of the next action within the segment."""
        return self.segment_step + len(self.steps)

    def rest(self) -> "_SegmentPiece":
        """A new piece that continues this one."""
        return _SegmentPiece(self.start, self.last, self.next_step)

    def add_keyframe(self, frame: SegmentStart) -> None:
        """Add a keyframe at the present moment. Raises ValueError if it belongs to another moment."""
        known, now = self.start, self.last
        same = (known.index, known.first_step, known.world, known.continued, known.object_names, self.next_step)
        if (
            frame.index,
            frame.first_step,
            frame.world,
            frame.continued,
            frame.object_names,
            frame.segment_step,
        ) != same:
            raise ValueError(
                f"a keyframe of segment {frame.index}, step {frame.segment_step}, stands in segment {known.index} "
                f"before step {self.next_step}"
            )
        if not all(np.array_equal(_shown(frame, name), _shown(now, name)) for name in _SHOWN):
            raise ValueError(
                f"segment {known.index}: the keyframe before step {self.next_step} differs from the state there"
            )
        self.start = frame
        self.keyframes.append(Keyframe(frame.segment_step, frame.integration_state))

    def add(self, step: StepRecord, parts: int) -> None:
        """Add the next step. Raises ValueError if the step is not the next one."""
        expected = (self.start.index, self.next_step, self.start.first_step + self.next_step)
        if (step.segment, step.segment_step, step.step) != expected:
            raise ValueError(
                f"the steps of segment {self.start.index} are not complete and in order: expected step {expected[1]} "
                f"of it, got step {step.segment_step} of segment {step.segment}"
            )
        if step.action >= N_ACTIONS:
            raise ValueError(f"step {step.step} has the action {step.action}, expected 0 to {N_ACTIONS - 1}")
        if (found := len(step.metrics.reward_parts)) != parts:
            raise ValueError(f"step {step.step} has {found} reward parts, the log names {parts}")
        self.steps.append(step)

    def lay_out(self, stream: int, parts: tuple[str, ...], ended: Ended | None) -> Segment:
        """Return the records as arrays."""
        start, steps, shown = self.start, self.steps, [self.before, *self.steps]
        begins = bool(self.keyframes) and self.keyframes[0].segment_step == self.segment_step
        rewards = np.array([step.metrics.reward_parts for step in steps], np.float64).reshape(len(steps), len(parts))
        return Segment(
            stream=stream,
            index=start.index,
            world=start.world,
            puzzle=start.puzzle,
            continued=start.continued,
            first_step=start.first_step + self.segment_step,
            segment_step=self.segment_step,
            object_names=start.object_names,
            integration_state=self.keyframes[0].integration_state if begins else None,
            keyframes=self.keyframes,
            images=np.stack([one.image for one in shown]),
            depth=_optional([one.depth for one in shown], "depth"),
            segmentation=_optional([one.segmentation for one in shown], "segmentation"),
            actions=np.array([step.action for step in steps], dtype=np.int64),
            object_state=np.stack([one.object_state for one in shown]),
            contacts=[step.contacts for step in steps],
            intrinsic_reward=_column(steps, "intrinsic_reward"),
            world_model_loss=_column(steps, "world_model_loss"),
            policy_entropy=_column(steps, "policy_entropy"),
            value=_column(steps, "value"),
            reward_parts={name: rewards[:, i].copy() for i, name in enumerate(parts)},
            ended=ended,
        )


_SHOWN = ("object_state", "image", "depth", "segmentation")


def _shown(record: SegmentStart | StepRecord, name: str) -> np.ndarray:
    value = getattr(record, name)
    return np.empty(0) if value is None else value


def _optional(images: list[np.ndarray | None], name: str) -> np.ndarray | None:
    there = [image for image in images if image is not None]
    if there and len(there) < len(images):
        raise ValueError(f"{len(images) - len(there)} of {len(images)} observations of a segment have no {name}")
    return np.stack(there) if there else None


def _column(steps: list[StepRecord], name: str) -> np.ndarray:
    return np.array([getattr(step.metrics, name) for step in steps], dtype=np.float64)


def segments(
    records: Iterable[Record], stream: int, parts: tuple[str, ...], max_steps: int | None, *, open_end: bool
) -> Iterator[Segment]:
    """Assemble records into segments, in order; a yielded segment is not kept.

    Args:
        records: in the order in which they were recorded. The first keyframe may stand anywhere in a segment.
        stream: number of the stream.
        parts: names of the parts of the reward.
        max_steps: segments with more steps are cut into pieces of this many; the observation at a cut is in both.
        open_end: whether the records may stop within a segment, as in a file that another part continues.

    Raises:
        ValueError: if a record is missing or out of place.
    """
    piece: _SegmentPiece | None = None
    expected: tuple[int, int, int] | None = None  # number, first step and world of the next segment
    for record in records:
        if piece is not None and len(piece.steps) == max_steps and isinstance(record, SegmentStart | StepRecord):
            yield piece.lay_out(stream, parts, None)
            piece = piece.rest()
        if isinstance(record, SegmentStart):
            piece = piece or _entered(record, expected)
            piece.add_keyframe(record)
        elif isinstance(record, StepRecord):
            _within(piece, record).add(record, len(parts))
        elif isinstance(record, Switch):
            expected = _next_segment(record, piece, expected)
            if piece is not None and record.reason != "start":
                yield piece.lay_out(stream, parts, record.reason)
            piece = None
    if piece is not None:
        if not open_end:
            raise ValueError(f"segment {piece.start.index} does not end")
        yield piece.lay_out(stream, parts, None)


def _within(piece: _SegmentPiece | None, step: StepRecord) -> _SegmentPiece:
    if piece is None:
        raise ValueError(f"step {step.step} belongs to no segment")
    return piece


def _entered(start: SegmentStart, expected: tuple[int, int, int] | None) -> _SegmentPiece:
    """The first piece of a segment, or of a file that begins within a segment."""
    if expected is not None and (start.index, start.first_step, start.world, start.segment_step) != (*expected, 0):
        raise ValueError(
            f"segment {start.index} in world {start.world} begins at step {start.first_step}, where segment "
            f"{expected[0]} in world {expected[2]} should begin at step {expected[1]}"
        )
    return _SegmentPiece(start, start, start.segment_step)


def _next_segment(
    switch: Switch, piece: _SegmentPiece | None, expected: tuple[int, int, int] | None
) -> tuple[int, int, int] | None:
    """Number, first step and world of the segment after a switch. Raises ValueError if the switch is misplaced."""
    if piece is None:
        if switch.reason != "start" or expected is not None:
            raise ValueError(f"the switch at step {switch.step} ({switch.reason}) ends no segment")
        return 0, switch.step, switch.to_world
    start, step = piece.start, piece.start.first_step + piece.next_step
    if (switch.step, switch.from_world) != (step, start.world) or switch.reason == "start":
        raise ValueError(
            f"the switch at step {switch.step} leaves world {switch.from_world} ({switch.reason}), but segment "
            f"{start.index} in world {start.world} has {piece.next_step} steps from step {start.first_step} on"
        )
    return start.index + 1, step, switch.to_world
