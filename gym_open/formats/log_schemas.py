"""What a log holds: record types, and the ROS 2 messages that carry them (topic, definition, encoder, decoder)."""

from typing import Literal

import msgspec
import numpy as np

from gym_open.envs.constants import CONTROL_DT_S, IMAGE_SIZE
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.errors import ArtefactError
from gym_open.formats.log_cdr import CdrReader, CdrWriter

FORMAT = "gym-open-log/1"
"""Version of everything below; a reader refuses another."""
STATE_WIDTH = 13
"""Numbers an object: position 3 (m), quaternion wxyz 4, linear velocity 3 (m/s), angular velocity 3 (rad/s)."""
STEP_NS = round(CONTROL_DT_S * 1e9)
"""Simulated nanoseconds a step."""

IMAGE, STEP, SEGMENT, SWITCH = "/observation/image", "/step", "/segment", "/switch"
METRICS, EVENTS = "/metrics", "/events"
METRIC_NAMES = ("intrinsic_reward", "world_model_loss", "policy_entropy", "value")

Ended = Literal["learned", "exhausted", "budget", "terminated"]
"""The first three are the curriculum's; a task's episode ends as `terminated`, or with its step `budget`."""
Reason = Literal["start", "learned", "exhausted", "budget", "terminated"]


class LogError(ArtefactError):
    """A log is cut off, damaged, or not one of ours."""


class SegmentStart(msgspec.Struct, frozen=True, eq=False):
    """A stream enters a world."""

    index: int
    """Number of the segment within its stream."""
    first_step: int
    """The stream's step number of the segment's first action."""
    world: int
    """Index of the world in the pool."""
    puzzle: Puzzle
    continued: bool
    """Whether the world had been left before and goes on from there."""
    object_names: tuple[str, ...]
    object_state: np.ndarray
    """State of every object of the model, shape (objects, 13), float64."""
    integration_state: np.ndarray
    """State from which the simulation goes on bit for bit, shape (S,), float64."""
    image: np.ndarray
    """Observation before the first action, shape (84, 84, 3), uint8 RGB."""


class StepRecord(msgspec.Struct, frozen=True, eq=False):
    """One action and what came of it."""

    step: int
    """Number of the step within the stream."""
    segment: int
    segment_step: int
    action: int
    object_state: np.ndarray
    """After the action, shape (objects, 13), float64."""
    contacts: tuple[Contact, ...]
    intrinsic_reward: float
    world_model_loss: float
    policy_entropy: float
    """Nats, of the policy that chose the action."""
    value: float
    image: np.ndarray
    """Observation after the action, shape (84, 84, 3), uint8 RGB."""


class Switch(msgspec.Struct, frozen=True):
    """The curriculum changed a stream's world."""

    step: int
    """Steps that the stream had taken."""
    from_world: int
    """Pool index, −1 at the start."""
    to_world: int
    """Pool index, −1 at the end."""
    reason: Reason
    world_losses: list[float]
    """World-model loss of every world of the pool as it decided; infinite where none was visited yet."""


class Segment(msgspec.Struct, frozen=True, eq=False):
    """Uninterrupted steps in one world: T actions and T + 1 observations."""

    stream: int
    index: int
    world: int
    puzzle: Puzzle
    continued: bool
    first_step: int
    object_names: tuple[str, ...]
    integration_state: np.ndarray
    """(S,) float64, before the first action."""
    images: np.ndarray
    """(T + 1, 84, 84, 3) uint8 RGB."""
    actions: np.ndarray
    """(T,) int64."""
    object_state: np.ndarray
    """(T + 1, objects, 13) float64."""
    contacts: list[tuple[Contact, ...]]
    """T of them."""
    intrinsic_reward: np.ndarray
    """(T,) float64, like the three that follow."""
    world_model_loss: np.ndarray
    policy_entropy: np.ndarray
    value: np.ndarray
    ended: Ended


_HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMAGE = """\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
"""
_JOINT_STATE = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
_STEP = """\
uint64 step
uint32 segment
uint32 segment_step
uint8 action
float64[] object_state
gym_open_msgs/Contact[] contacts
float64 intrinsic_reward
float64 world_model_loss
float64 policy_entropy
float64 value
================================================================================
MSG: gym_open_msgs/Contact
string a
string b
float64[3] position
float64[3] normal
float64 impulse
"""
_SEGMENT = """\
uint32 segment
uint64 first_step
int32 world
string puzzle_digest
bool continued
string[] object_names
float64[] object_state
float64[] integration_state
"""
_SWITCH = """\
uint64 step
int32 from_world
int32 to_world
string reason
float64[] world_losses
"""

DEFINITIONS: dict[str, tuple[str, str]] = {
    IMAGE: ("sensor_msgs/msg/Image", _IMAGE + _HEADER),
    STEP: ("gym_open_msgs/msg/Step", _STEP),
    SEGMENT: ("gym_open_msgs/msg/Segment", _SEGMENT),
    SWITCH: ("gym_open_msgs/msg/Switch", _SWITCH),
    METRICS: ("sensor_msgs/msg/JointState", _JOINT_STATE + _HEADER),
    EVENTS: ("std_msgs/msg/String", "string data\n"),
}
"""Message type and ROS 2 definition of each topic. The standard types are there for viewers, ours are the record."""


def _put_header(out: CdrWriter, nanoseconds: int) -> None:
    seconds, rest = divmod(nanoseconds, 10**9)
    out.scalar("i", seconds)
    out.scalar("I", rest)
    out.string("camera")


def _skip_header(data: CdrReader) -> None:
    data.scalar("i")
    data.scalar("I")
    data.string()


def encode_image(image: np.ndarray, nanoseconds: int) -> bytes:
    """`sensor_msgs/msg/Image` of an (H, W, 3) uint8 RGB picture."""
    height, width, _ = image.shape
    out = CdrWriter()
    _put_header(out, nanoseconds)
    out.scalar("I", height)
    out.scalar("I", width)
    out.string("rgb8")
    out.scalar("B", 0)
    out.scalar("I", 3 * width)
    out.blob(image.tobytes())
    return out.data


def decode_image(message: bytes) -> np.ndarray:
    """The (84, 84, 3) uint8 picture of an image message.

    Raises:
        ValueError: if it has another size or encoding.
    """
    data = CdrReader(message)
    _skip_header(data)
    height, width, encoding = data.integer("I"), data.integer("I"), data.string()
    if (height, width, encoding) != (IMAGE_SIZE, IMAGE_SIZE, "rgb8"):
        raise ValueError(f"expected a {IMAGE_SIZE}x{IMAGE_SIZE} rgb8 image, got {height}x{width} {encoding}")
    data.integer("B")
    data.integer("I")
    return np.frombuffer(data.blob(), np.uint8).reshape(height, width, 3)


def encode_step(record: StepRecord) -> bytes:
    """`gym_open_msgs/msg/Step`, all of the record but its image."""
    out = CdrWriter()
    out.scalar("Q", record.step)
    out.scalar("I", record.segment)
    out.scalar("I", record.segment_step)
    out.scalar("B", record.action)
    out.floats(record.object_state)
    out.scalar("I", len(record.contacts))
    for contact in record.contacts:
        out.string(contact.a)
        out.string(contact.b)
        out.vector((*contact.position, *contact.normal, contact.impulse))
    out.vector((record.intrinsic_reward, record.world_model_loss, record.policy_entropy, record.value))
    return out.data


def decode_step(message: bytes, image: np.ndarray) -> StepRecord:
    """The record of a step message and the image that followed it.

    Raises:
        ValueError: if the message is not of that type.
    """
    data = CdrReader(message)
    step, segment, segment_step, action = (data.integer(code) for code in "QIIB")
    state = data.floats().reshape(-1, STATE_WIDTH)
    contacts = tuple(_contact(data) for _ in range(data.integer("I")))
    reward, loss, entropy, value = data.vector(4)
    return StepRecord(step, segment, segment_step, action, state, contacts, reward, loss, entropy, value, image)


def _contact(data: CdrReader) -> Contact:
    a, b = data.string(), data.string()
    x, y, z, nx, ny, nz, impulse = data.vector(7)
    return Contact(a=a, b=b, position=(x, y, z), normal=(nx, ny, nz), impulse=impulse)


def encode_segment(start: SegmentStart) -> bytes:
    """`gym_open_msgs/msg/Segment`, all of the start but its image; the puzzle by digest (the pool is attached)."""
    out = CdrWriter()
    out.scalar("I", start.index)
    out.scalar("Q", start.first_step)
    out.scalar("i", start.world)
    out.string(start.puzzle.digest)
    out.scalar("?", start.continued)
    out.strings(start.object_names)
    out.floats(start.object_state)
    out.floats(start.integration_state)
    return out.data


def decode_segment(message: bytes, pool: tuple[Puzzle, ...], image: np.ndarray) -> SegmentStart:
    """The start of a segment, its puzzle looked up in the `pool`.

    Raises:
        ValueError: if the message is not of that type, or its puzzle is not the pool's.
    """
    data = CdrReader(message)
    index, first_step, world, digest = data.integer("I"), data.integer("Q"), data.integer("i"), data.string()
    if not (0 <= world < len(pool) and pool[world].digest == digest):
        raise ValueError(f"segment {index} is in world {world} with puzzle {digest}, which the pool does not hold")
    continued, names = bool(data.scalar("?")), tuple(data.strings())
    state = data.floats().reshape(len(names), STATE_WIDTH)
    return SegmentStart(index, first_step, world, pool[world], continued, names, state, data.floats(), image)


def encode_switch(switch: Switch) -> bytes:
    """`gym_open_msgs/msg/Switch`."""
    out = CdrWriter()
    out.scalar("Q", switch.step)
    out.scalar("i", switch.from_world)
    out.scalar("i", switch.to_world)
    out.string(switch.reason)
    out.floats(np.array(switch.world_losses))
    return out.data


def decode_switch(message: bytes) -> Switch:
    """The switch of a message.

    Raises:
        ValueError: if the message is not of that type (`msgspec.ValidationError` is one).
    """
    data = CdrReader(message)
    step, source, target, reason = data.integer("Q"), data.integer("i"), data.integer("i"), data.string()
    fields = {"step": step, "from_world": source, "to_world": target, "reason": reason}
    return msgspec.convert({**fields, "world_losses": data.floats().tolist()}, Switch)


def encode_metrics(record: StepRecord, nanoseconds: int) -> bytes:
    """`sensor_msgs/msg/JointState`: the step's scalars by name, which viewers plot without further ado."""
    out = CdrWriter()
    _put_header(out, nanoseconds)
    out.strings(METRIC_NAMES)
    out.floats(np.array([getattr(record, name) for name in METRIC_NAMES]))
    out.floats(np.empty(0))
    out.floats(np.empty(0))
    return out.data


def encode_text(text: str) -> bytes:
    """`std_msgs/msg/String`."""
    out = CdrWriter()
    out.string(text)
    return out.data
