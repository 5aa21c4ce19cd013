"""Conversion of records to ROS 2 messages and back.

The messages of every step (`encode_image`, `encode_step`, `encode_metrics`) are packed in one call from a layout that
is computed once. The other messages are rare and are built value by value.
"""

import functools
import math
import struct
from collections.abc import Iterator

import msgspec
import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.logs.cdr import ENCAPSULATION, CdrReader, CdrWriter
from gym_open.formats.logs.container import LogMessage
from gym_open.formats.logs.schemas import (
    DEPTH,
    EVENTS,
    IMAGE,
    METRIC_NAMES,
    METRICS,
    SEGMENT,
    SEGMENTATION,
    STATE_WIDTH,
    STEP,
    STEP_NS,
    STUCK,
    SWITCH,
    Record,
    SegmentStart,
    StepMetrics,
    StepRecord,
    Stuck,
    Switch,
)

PIXELS: dict[str, tuple[str, np.dtype, tuple[int, ...]]] = {
    IMAGE: ("rgb8", np.dtype("u1"), (IMAGE_SIZE, IMAGE_SIZE, 3)),
    DEPTH: ("32FC1", np.dtype("<f4"), (IMAGE_SIZE, IMAGE_SIZE)),
    SEGMENTATION: ("32SC1", np.dtype("<i4"), (IMAGE_SIZE, IMAGE_SIZE)),
}
"""For each topic with images: ROS's name of the encoding, the type of its numbers, and the shape."""


def messages_of(record: Record, reward_parts: tuple[str, ...] = ()) -> Iterator[LogMessage]:
    """Messages of a record, in order; `reward_parts` are the names of a step's reward parts."""
    match record:
        case SegmentStart():
            time = (record.first_step + record.segment_step) * STEP_NS
            yield LogMessage(SEGMENT, time, encode_segment(record))
            yield from _images(record, time)
        case StepRecord():
            time = record.step * STEP_NS
            yield LogMessage(STEP, time, encode_step(record))
            yield LogMessage(METRICS, time, encode_metrics(record.metrics, reward_parts, time))
            yield from _images(record, time + STEP_NS)
        case Switch():
            time = record.step * STEP_NS
            words = f"step {record.step}: world {record.from_world} -> {record.to_world} ({record.reason})"
            yield LogMessage(SWITCH, time, encode_switch(record))
            yield LogMessage(EVENTS, time, encode_text(words))
        case Stuck():
            time = record.step * STEP_NS
            where = f"{record.position[0]:.2f}, {record.position[1]:.2f}, {record.position[2]:.2f}"
            how = ("stuck in a corner" if record.kind == "corner" else "stuck") if record.began else "free again"
            yield LogMessage(STUCK, time, encode_stuck(record))
            yield LogMessage(EVENTS, time, encode_text(f"step {record.step}: {record.name} {how} at ({where})"))


def _images(record: SegmentStart | StepRecord, time: int) -> Iterator[LogMessage]:
    yield LogMessage(IMAGE, time, encode_image(IMAGE, record.image, time))
    if record.depth is not None:
        yield LogMessage(DEPTH, time, encode_image(DEPTH, record.depth, time))
    if record.segmentation is not None:
        yield LogMessage(SEGMENTATION, time, encode_image(SEGMENTATION, record.segmentation, time))


_STAMP = struct.Struct("<4siI")
"""Encapsulation, seconds, nanoseconds: the first bytes of every message with a header."""


def _stamp(nanoseconds: int) -> bytes:
    return _STAMP.pack(ENCAPSULATION, *divmod(nanoseconds, 10**9))


def _header() -> CdrWriter:
    """A message that consists of a header with the time 0."""
    out = CdrWriter()
    out.scalar("i", 0)
    out.scalar("I", 0)
    out.string("camera")
    return out


def encode_image(topic: str, image: np.ndarray, nanoseconds: int) -> bytes:
    """Encode an image as `sensor_msgs/msg/Image`.

    Raises:
        ValueError: if its shape or type is not what `PIXELS` says for the topic.
    """
    before = _before_pixels(topic, image.shape, image.dtype)
    return b"".join((_stamp(nanoseconds), before, np.ascontiguousarray(image).data))


@functools.cache
def _before_pixels(topic: str, shape: tuple[int, ...], kind: np.dtype) -> bytes:
    """The bytes of an image message between its stamp and its pixels."""
    encoding, *expected = PIXELS[topic]
    if [kind, shape] != expected:
        raise ValueError(f"{topic}: expected an image of {expected[0]} {expected[1]}, got {kind} {shape}")
    out = _header()
    out.scalar("I", shape[0])
    out.scalar("I", shape[1])
    out.string(encoding)
    out.scalar("B", 0)
    size = kind.itemsize * int(np.prod(shape))
    out.scalar("I", size // shape[0])
    out.scalar("I", size)
    return out.data[_STAMP.size :]


def decode_image(topic: str, message: bytes) -> np.ndarray:
    """Decode the image of an image message; the array is read-only.

    Raises:
        ValueError: if its size or encoding is not the topic's.
    """
    encoding, kind, shape = PIXELS[topic]
    before = _before_pixels(topic, shape, kind)
    start = _STAMP.size + len(before)
    if message.startswith(before, _STAMP.size) and len(message) == start + kind.itemsize * math.prod(shape):
        return np.frombuffer(message, kind, offset=start).reshape(shape)  # the layout that our writer gives it
    data = CdrReader(message)
    data.scalar("i")
    data.scalar("I")
    data.string()
    height, width, found = data.integer("I"), data.integer("I"), data.string()
    if (height, width, found) != (*shape[:2], encoding):
        raise ValueError(f"{topic}: expected a {shape[0]}x{shape[1]} {encoding} image, got {height}x{width} {found}")
    data.integer("B")
    data.integer("I")
    return np.frombuffer(data.blob(), kind).reshape(shape)


@functools.cache
def _step_head(parts: int) -> struct.Struct:
    """A step up to its contacts, without the values of the object state."""
    sequence = f"I4x{parts}d" if parts else "I"
    return struct.Struct(f"<4sQIIB7x4d{sequence}I{'4x' if parts else ''}")


_COUNT = struct.Struct("<I")
_CONTACT = struct.Struct("<7d")


def encode_step(record: StepRecord) -> bytes:
    """Encode a step, without its images, as `gym_open_msgs/msg/Step`."""
    metrics, parts = record.metrics, record.metrics.reward_parts
    state = np.ascontiguousarray(record.object_state, "<f8")
    message = bytearray(
        _step_head(len(parts)).pack(
            ENCAPSULATION, record.step, record.segment, record.segment_step, record.action, metrics.intrinsic_reward,
            metrics.world_model_loss, metrics.policy_entropy, metrics.value, len(parts), *parts, state.size,
        )
    )  # fmt: skip
    message += state.data
    message += _COUNT.pack(len(record.contacts))
    for contact in record.contacts:
        message += _contact_names(contact.a, contact.b, (len(message) - len(ENCAPSULATION)) % 8)
        message += _CONTACT.pack(*contact.position, *contact.normal, contact.impulse)
    return bytes(message)


@functools.cache
def _contact_names(a: str, b: str, phase: int) -> bytes:
    """The two names of a contact and the padding before its numbers; they begin `phase` bytes after a multiple of 8."""
    out = CdrWriter()
    for _ in range(phase):
        out.scalar("B", 0)
    out.string(a)
    out.string(b)
    out.align(8)
    return out.data[len(ENCAPSULATION) + phase :]


def decode_step(
    message: bytes, image: np.ndarray, depth: np.ndarray | None = None, segmentation: np.ndarray | None = None
) -> StepRecord:
    """Decode a step message and add the images that followed it.

    Raises:
        ValueError: if the message is not of that type.
    """
    data = CdrReader(message)
    step, segment, segment_step, action = (data.integer(code) for code in "QIIB")
    reward, loss, entropy, value = data.vector(4)
    metrics = StepMetrics(reward, loss, entropy, value, tuple(data.floats().tolist()))
    state = data.floats().reshape(-1, STATE_WIDTH)
    contacts = tuple(_contact(data) for _ in range(data.integer("I")))
    return StepRecord(step, segment, segment_step, action, state, contacts, image, metrics, depth, segmentation)


def _contact(data: CdrReader) -> Contact:
    a, b = data.string(), data.string()
    x, y, z, nx, ny, nz, impulse = data.vector(7)
    return Contact(a=a, b=b, position=(x, y, z), normal=(nx, ny, nz), impulse=impulse)


def encode_segment(start: SegmentStart) -> bytes:
    """Encode a keyframe, without its images, as `gym_open_msgs/msg/Segment`; the puzzle by its digest."""
    out = CdrWriter()
    out.scalar("I", start.index)
    out.scalar("Q", start.first_step)
    out.scalar("I", start.segment_step)
    out.scalar("i", start.world)
    out.string(start.puzzle.digest)
    out.scalar("?", start.continued)
    out.strings(start.object_names)
    out.floats(start.object_state)
    out.floats(start.integration_state)
    return out.data


def decode_segment(
    message: bytes,
    pool: tuple[Puzzle, ...],
    image: np.ndarray,
    depth: np.ndarray | None = None,
    segmentation: np.ndarray | None = None,
) -> SegmentStart:
    """Decode a keyframe and add the images that followed it; its puzzle is looked up in `pool`.

    Raises:
        ValueError: if the message is not of that type, or the pool does not hold its puzzle.
    """
    data = CdrReader(message)
    index, first_step, segment_step, world = (data.integer(code) for code in "IQIi")
    digest = data.string()
    if not (0 <= world < len(pool) and pool[world].digest == digest):
        raise ValueError(f"segment {index} is in world {world} with puzzle {digest}, which the pool does not hold")
    continued, names = bool(data.scalar("?")), tuple(data.strings())
    state = data.floats().reshape(len(names), STATE_WIDTH)
    return SegmentStart(
        index, first_step, world, pool[world], continued, names, state, data.floats(), image, segment_step, depth,
        segmentation,
    )  # fmt: skip


def encode_switch(switch: Switch) -> bytes:
    """Encode a switch as `gym_open_msgs/msg/Switch`."""
    out = CdrWriter()
    out.scalar("Q", switch.step)
    out.scalar("i", switch.from_world)
    out.scalar("i", switch.to_world)
    out.string(switch.reason)
    out.floats(np.array(switch.world_losses))
    return out.data


def decode_switch(message: bytes) -> Switch:
    """Decode a switch.

    Raises:
        ValueError: if the message is not of that type (`msgspec.ValidationError` is one).
    """
    data = CdrReader(message)
    step, source, target, reason = data.integer("Q"), data.integer("i"), data.integer("i"), data.string()
    fields = {"step": step, "from_world": source, "to_world": target, "reason": reason}
    return msgspec.convert({**fields, "world_losses": data.floats().tolist()}, Switch)


def encode_stuck(stuck: Stuck) -> bytes:
    """Encode a stuck record as `gym_open_msgs/msg/Stuck`."""
    out = CdrWriter()
    out.scalar("Q", stuck.step)
    out.scalar("I", stuck.segment)
    out.string(stuck.kind)
    out.string(stuck.name)
    out.scalar("?", stuck.began)
    out.vector(stuck.position)
    return out.data


def decode_stuck(message: bytes) -> Stuck:
    """Decode a stuck record.

    Raises:
        ValueError: if the message is not of that type (`msgspec.ValidationError` is one).
    """
    data = CdrReader(message)
    step, segment, kind, name = data.integer("Q"), data.integer("I"), data.string(), data.string()
    fields = {"step": step, "segment": segment, "kind": kind, "name": name, "began": bool(data.scalar("?"))}
    return msgspec.convert({**fields, "position": data.vector(3)}, Stuck)


def encode_metrics(metrics: StepMetrics, reward_parts: tuple[str, ...], nanoseconds: int) -> bytes:
    """Encode a step's metrics and the named parts of its reward as `sensor_msgs/msg/JointState`, which viewers plot."""
    numbers = (metrics.intrinsic_reward, metrics.world_model_loss, metrics.policy_entropy, metrics.value)
    values = _metrics(4 + len(reward_parts)).pack(*numbers, *metrics.reward_parts, 0, 0)
    return b"".join((_stamp(nanoseconds), _before_metrics(reward_parts), values))


@functools.cache
def _metrics(count: int) -> struct.Struct:
    """`count` positions, no velocity, no effort."""
    return struct.Struct(f"<{count}dII")


@functools.cache
def _before_metrics(reward_parts: tuple[str, ...]) -> bytes:
    """The bytes of a metrics message between its stamp and its numbers."""
    names = METRIC_NAMES + tuple(f"intrinsic_reward/{part}" for part in reward_parts)
    out = _header()
    out.strings(names)
    out.scalar("I", len(names))
    out.align(8)
    return out.data[_STAMP.size :]


def encode_text(text: str) -> bytes:
    """Encode a text as `std_msgs/msg/String`."""
    out = CdrWriter()
    out.string(text)
    return out.data
