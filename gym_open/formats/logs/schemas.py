"""Contents of a log: record types, and the topics and ROS 2 definitions of the messages that carry them.

The module `messages` converts records to messages and back. docs/data-format.md describes the layout of a file.
"""

import math
import re
from typing import Any, Literal

import msgspec
import numpy as np

from gym_open.envs.constants import CONTROL_DT_S
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.stuck import Stuck
from gym_open.errors import ArtefactError

FORMAT = "gym-open-log/2"
"""Version of everything below; readers refuse every other version."""
STATE_WIDTH = 13
"""Numbers per object: position 3 (m), quaternion wxyz 4, linear velocity 3 (m/s), angular velocity 3 (rad/s)."""
STEP_NS = round(CONTROL_DT_S * 1e9)
"""Simulated nanoseconds per step."""
_NAME = re.compile(r"stream-([0-9]{3,6})-([0-9]{3,6})\.mcap")

SEGMENT, STEP = "/segment", "/step"
IMAGE, DEPTH, SEGMENTATION = "/observation/image", "/observation/depth", "/observation/segmentation"
SWITCH, STUCK = "/switch", "/stuck"
METRICS, EVENTS = "/metrics", "/events"
METRIC_NAMES = ("intrinsic_reward", "world_model_loss", "policy_entropy", "value")

CONFIG, MODEL, POOL = "config.json", "model.xml", "puzzles.json"
"""Attachments of every file."""
HEAD, PROVENANCE, CONTINUES = "gym-open", "provenance", "continues"
"""Metadata records of a file; `CONTINUES` only if the stream continues in another part."""

Ended = Literal["learned", "exhausted", "interval", "uniform", "progress", "budget", "terminated", "cut"]
"""Why a segment ended. The first five are decisions of the curriculum. `budget`: no steps were left. `terminated`: a
task's episode terminated. `cut`: the following steps were lost, and the log was repaired."""
Reason = Literal["start", Ended]


class LogError(ArtefactError):
    """A log is cut off, damaged, or not a log of gym-open."""


class UnfinishedError(LogError):
    """A log without damage that lacks its last switch, because its writer did not finish."""


def log_name(stream: int, part: int) -> str:
    """Name of the file that holds part `part` of a stream's log; both numbers start at 0."""
    return f"stream-{stream:03d}-{part:03d}.mcap"


def parse_log_name(name: str) -> tuple[int, int] | None:
    """Stream and part of a file name; None if `log_name` gives no such name."""
    match = _NAME.fullmatch(name)
    found = (int(match[1]), int(match[2])) if match else None
    return found if found and log_name(*found) == name else None


class LogHead(msgspec.Struct, frozen=True):
    """What a log says about itself. With it, the log can be replayed without any other file."""

    stream: int
    config: dict[str, Any]
    puzzles: tuple[Puzzle, ...]
    """The pool; the number of a world is its index here."""
    provenance: dict[str, str]
    """Code version, package versions, seed."""
    model_xml: str
    reward_parts: tuple[str, ...] = ()
    """Names of the parts of the intrinsic reward; `StepMetrics.reward_parts` has their values."""
    keyframe_every: int = 256
    """Steps of a segment between two keyframes."""


class SegmentStart(msgspec.Struct, frozen=True, eq=False):
    """A keyframe: a stream enters a world, or a number of steps has passed and the state is written again."""

    index: int
    """Number of the segment within its stream."""
    first_step: int
    """Number of the segment's first action within the stream."""
    world: int
    """Index of the world in the pool."""
    puzzle: Puzzle
    continued: bool
    """Whether the segment continues a world that an earlier segment left."""
    object_names: tuple[str, ...]
    object_state: np.ndarray
    """State of every object of the model, shape (objects, 13), float64."""
    integration_state: np.ndarray
    """State from which the simulation continues to the bit, shape (S,), float64."""
    image: np.ndarray
    """Observation at that moment, shape (84, 84, 3), uint8 RGB."""
    segment_step: int = 0
    """Steps taken in the segment so far; 0 where the world is entered."""
    depth: np.ndarray | None = None
    """Shape (84, 84), float32: metres along the viewing direction, infinite where nothing is; None if not recorded."""
    segmentation: np.ndarray | None = None
    """Shape (84, 84), int32: the geom that each pixel shows, −1 for none; None if not recorded."""


class StepMetrics(msgspec.Struct, frozen=True):
    """What an explorer computed for one step; NaN where nothing computes it, as when a person plays."""

    intrinsic_reward: float = math.nan
    world_model_loss: float = math.nan
    policy_entropy: float = math.nan
    """Nats, of the policy that chose the action."""
    value: float = math.nan
    reward_parts: tuple[float, ...] = ()
    """The parts of the intrinsic reward, in the order of `LogHead.reward_parts`."""


class StepRecord(msgspec.Struct, frozen=True, eq=False):
    """One action and its result."""

    step: int
    """Number of the step within the stream."""
    segment: int
    segment_step: int
    action: int
    object_state: np.ndarray
    """After the action, shape (objects, 13), float64."""
    contacts: tuple[Contact, ...]
    image: np.ndarray
    """Observation after the action, shape (84, 84, 3), uint8 RGB."""
    metrics: StepMetrics = StepMetrics()
    depth: np.ndarray | None = None
    """As `SegmentStart.depth`, after the action."""
    segmentation: np.ndarray | None = None
    """As `SegmentStart.segmentation`, after the action."""


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
    """World-model loss of every world of the pool at the decision: infinite for a world that was not visited yet, NaN
    without a world model."""


Record = SegmentStart | StepRecord | Switch | Stuck
"""What a log holds, in the order in which it happened."""


class Keyframe(msgspec.Struct, frozen=True, eq=False):
    """A moment of a segment from which the simulation can continue."""

    segment_step: int
    """Steps of the segment before it."""
    integration_state: np.ndarray
    """(S,) float64."""


class Segment(msgspec.Struct, frozen=True, eq=False):
    """Uninterrupted steps in one world: T actions and T + 1 observations of a segment, or of a piece of a segment."""

    stream: int
    index: int
    world: int
    puzzle: Puzzle
    continued: bool
    first_step: int
    """Number of the first action within the stream."""
    segment_step: int
    """Number of the first action within the segment; 0 for a whole segment."""
    object_names: tuple[str, ...]
    integration_state: np.ndarray | None
    """(S,) float64, before the first action; None if this piece begins between two keyframes."""
    keyframes: list[Keyframe]
    """Keyframes in this piece; the first is at `segment_step` if `integration_state` is not None."""
    images: np.ndarray
    """(T + 1, 84, 84, 3) uint8 RGB."""
    depth: np.ndarray | None
    """(T + 1, 84, 84) float32 metres; None if not recorded."""
    segmentation: np.ndarray | None
    """(T + 1, 84, 84) int32 geom ids; None if not recorded."""
    actions: np.ndarray
    """(T,) int64."""
    object_state: np.ndarray
    """(T + 1, objects, 13) float64."""
    contacts: list[tuple[Contact, ...]]
    """One tuple per action."""
    intrinsic_reward: np.ndarray
    """(T,) float64, like the next three fields and every reward part."""
    world_model_loss: np.ndarray
    policy_entropy: np.ndarray
    value: np.ndarray
    reward_parts: dict[str, np.ndarray]
    """The parts of the intrinsic reward, by name."""
    ended: Ended | None
    """None if the segment continues in the next piece."""

    def __post_init__(self) -> None:
        """Raises ValueError if the arrays do not have the lengths that belong together."""
        steps = len(self.actions)
        if not len(self.images) == len(self.object_state) == steps + 1:
            raise ValueError(
                f"expected one more observation than actions: got {len(self.images)} images, {len(self.object_state)} "
                f"states and {steps} actions"
            )
        for name in ("contacts", "intrinsic_reward", "world_model_loss", "policy_entropy", "value"):
            if len(getattr(self, name)) != steps:
                raise ValueError(f"expected one {name} per action: got {len(getattr(self, name))} for {steps} actions")


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
float64 intrinsic_reward
float64 world_model_loss
float64 policy_entropy
float64 value
float64[] reward_parts
float64[] object_state
gym_open_msgs/Contact[] contacts
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
uint32 segment_step
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
_STUCK = """\
uint64 step
uint32 segment
string kind
string name
bool began
float64[3] position
"""

DEFINITIONS: dict[str, tuple[str, str]] = {
    SEGMENT: ("gym_open_msgs/msg/Segment", _SEGMENT),
    STEP: ("gym_open_msgs/msg/Step", _STEP),
    IMAGE: ("sensor_msgs/msg/Image", _IMAGE + _HEADER),
    DEPTH: ("sensor_msgs/msg/Image", _IMAGE + _HEADER),
    SEGMENTATION: ("sensor_msgs/msg/Image", _IMAGE + _HEADER),
    SWITCH: ("gym_open_msgs/msg/Switch", _SWITCH),
    STUCK: ("gym_open_msgs/msg/Stuck", _STUCK),
    METRICS: ("sensor_msgs/msg/JointState", _JOINT_STATE + _HEADER),
    EVENTS: ("std_msgs/msg/String", "string data\n"),
}
"""Message type and ROS 2 definition of each topic. Our types hold the record; the standard types are for viewers."""
