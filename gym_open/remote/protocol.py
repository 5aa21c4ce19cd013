"""What client and server say to each other: MessagePack bodies of one unary gRPC method.

A body is a `Request`; the answer is a `Reply`. What the user gave travels as it is and is checked by `Session`, so that
a wrong argument gives the same error near and far.
"""

from typing import Any, Literal, NotRequired, TypedDict

import msgspec
import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle, PuzzleError
from gym_open.errors import ConfigError, GymOpenError, UsageError

PROTOCOL = 1
"""Version of everything in this module."""
SERVICE, METHOD = "gym_open.World", "Call"
DEFAULT_PORT = 10710
TOKEN_VARIABLE = "GYM_OPEN_TOKEN"  # noqa: S105  # a name
TOKEN_KEY = "gym-open-token"  # noqa: S105
"""Metadata key that carries the token."""
REQUEST_BYTES = 64 * 1024
REPLY_BYTES = 1024 * 1024
"""Larger messages are refused. A reply with a picture takes about 25,000 bytes."""

Vector = tuple[float, float, float]


class ObjectInformation(TypedDict):
    """State of one object: metres, metres and radians a second, kilograms, in the world's frame."""

    position: Vector
    rotation: tuple[float, float, float, float]
    """Quaternion, scalar first."""
    velocity: Vector
    angular_velocity: Vector
    mass: float
    model_name: str
    color_id: int


class Observation(TypedDict):
    """What the paper's environment returns."""

    image: NotRequired[np.ndarray]
    """(84, 84, 3) uint8 RGB; not there while `set_observation` is off."""
    object_information: dict[int, ObjectInformation]
    """By the object's number in the inventory."""


class Debug(TypedDict):
    """The fourth thing that a step returns."""

    puzzle_digest: str
    hits: tuple[str, ...]
    """Goals that the agent touched for the first time."""
    in_danger: bool
    truncated: bool
    """Done because the step budget is spent."""
    contacts: NotRequired[tuple[Contact, ...]]
    """What touched what; with `debug=True` only, like the next."""
    puzzle: NotRequired[Puzzle]


StepResult = tuple[Observation, float, bool, Debug]


class Open(msgspec.Struct, frozen=True, tag=True):
    """Ask for a session. Every version of the protocol must be able to read these fields."""

    protocol: int
    package: str
    """Version of gym-open: another one may hold another world."""
    debug: bool


class ChangePuzzle(msgspec.Struct, frozen=True, tag=True):
    """`add_change_puzzle`."""

    mode: Any
    task: Any
    puzzle_config: Any


class SetObservation(msgspec.Struct, frozen=True, tag=True):
    """`set_observation`."""

    output: Any


class Configure(msgspec.Struct, frozen=True, tag=True):
    """`configure_env`."""

    first: Any
    action_space: Any
    skip_frame: Any


class TurnOffReward(msgspec.Struct, frozen=True, tag=True):
    """`turn_off_reward`."""

    off: Any


class Reset(msgspec.Struct, frozen=True, tag=True):
    """`reset`."""

    seed: Any


class Step(msgspec.Struct, frozen=True, tag=True):
    """`step`."""

    action: Any


class Close(msgspec.Struct, frozen=True, tag=True):
    """The session is not needed any more."""


Call = Open | ChangePuzzle | SetObservation | Configure | TurnOffReward | Reset | Step | Close


class Request(msgspec.Struct, frozen=True):
    """A call in a session (empty for `Open`)."""

    session: str
    call: Call


class Opened(msgspec.Struct, frozen=True, tag=True):
    """A session was opened."""

    session: str


class Done(msgspec.Struct, frozen=True, tag=True):
    """It is done, and there is nothing to return."""


class Observed(msgspec.Struct, frozen=True, tag=True):
    """What `reset` returns."""

    observation: Observation


class Stepped(msgspec.Struct, frozen=True, tag=True):
    """What `step` returns."""

    result: StepResult


Kind = Literal["usage", "config", "puzzle", "failed"]


class Refused(msgspec.Struct, frozen=True, tag=True):
    """The call was understood and not done; the session is as it was."""

    kind: Kind
    message: str


Reply = Opened | Done | Observed | Stepped | Refused

_ERRORS: dict[Kind, type[GymOpenError]] = {
    "config": ConfigError,
    "usage": UsageError,
    "puzzle": PuzzleError,
    "failed": GymOpenError,
}
"""Subclasses before their bases."""


def refusal(error: GymOpenError) -> Refused:
    """The reply that carries an error to the client."""
    return Refused(next(kind for kind, known in _ERRORS.items() if isinstance(error, known)), str(error))


def raised(refused: Refused) -> GymOpenError:
    """The error that a refusal carries."""
    return _ERRORS[refused.kind](refused.message)


def plain(value: Any) -> Any:
    """Numbers of numpy as Python's, tuples as lists: what a message can hold.

    Raises:
        TypeError: if a value is of no such type.
    """
    return msgspec.to_builtins(value, enc_hook=_encode_number)


def _encode_number(value: Any) -> Any:
    if isinstance(value, np.integer | np.floating | np.bool_):
        return value.item()
    raise TypeError(f"numbers, text, lists and dictionaries are possible, got {type(value).__name__}")


def _encode_picture(value: Any) -> bytes:
    assert isinstance(value, np.ndarray)
    return value.tobytes()


def _decode_picture(kind: type, value: Any) -> np.ndarray:
    shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
    if kind is not np.ndarray or not isinstance(value, bytes) or len(value) != np.prod(shape):
        raise ValueError(f"expected a picture of {shape} bytes")
    return np.frombuffer(value, np.uint8).reshape(shape).copy()


_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_picture)
_requests = msgspec.msgpack.Decoder(Request)
_replies = msgspec.msgpack.Decoder(Reply, dec_hook=_decode_picture)


def encode(message: Request | Reply) -> bytes:
    """The body of a message."""
    return _encoder.encode(message)


def decode_request(body: bytes) -> Request:
    """The request in a body.

    Raises:
        ValueError: if it is none.
    """
    return _decoded(_requests, body)


def decode_reply(body: bytes) -> Reply:
    """The reply in a body.

    Raises:
        ValueError: if it is none.
    """
    return _decoded(_replies, body)


def _decoded(decoder: "msgspec.msgpack.Decoder[Any]", body: bytes) -> Any:
    try:
        return decoder.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, GymOpenError) as error:
        raise ValueError(f"not a message of protocol {PROTOCOL}: {error}") from None
