"""The protocol of client and server: MessagePack bodies of one unary gRPC method.

A body is a `Request`, and the answer is a `Reply`. The user's arguments are sent without a check; `Session` checks
them, so that a wrong argument gives the same error in this process and on a server.
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
"""Larger messages are refused. A reply with an image has about 25,000 bytes."""

Vector = tuple[float, float, float]


class ObjectInformation(TypedDict):
    """State of one object in the world's frame: metres, metres and radians per second, kilograms."""

    position: Vector
    rotation: tuple[float, float, float, float]
    """Quaternion, scalar first."""
    velocity: Vector
    angular_velocity: Vector
    mass: float
    model_name: str
    color_id: int


class Observation(TypedDict):
    """An observation of the paper's environment."""

    image: NotRequired[np.ndarray]
    """(84, 84, 3) uint8 RGB; missing while `set_observation` is off."""
    object_information: dict[int, ObjectInformation]
    """By the object's index in the inventory."""


class Debug(TypedDict):
    """The fourth value that a step returns."""

    puzzle_digest: str
    hits: tuple[str, ...]
    """Goals that the agent touched for the first time."""
    in_danger: bool
    truncated: bool
    """Whether done is true because the step budget is used up."""
    contacts: NotRequired[tuple[Contact, ...]]
    """Contacts during the step; only with `debug=True`, like `puzzle`."""
    puzzle: NotRequired[Puzzle]


StepResult = tuple[Observation, float, bool, Debug]


class Open(msgspec.Struct, frozen=True, tag=True):
    """Request a session. Every version of the protocol must be able to read these fields."""

    protocol: int
    package: str
    """Version of gym-open: another version may have another world."""
    debug: bool


class ChangePuzzle(msgspec.Struct, frozen=True, tag=True):
    """Call of `add_change_puzzle`."""

    mode: Any
    task: Any
    puzzle_config: Any


class SetObservation(msgspec.Struct, frozen=True, tag=True):
    """Call of `set_observation`."""

    output: Any


class Configure(msgspec.Struct, frozen=True, tag=True):
    """Call of `configure_env`."""

    first: Any
    action_space: Any
    skip_frame: Any


class TurnOffReward(msgspec.Struct, frozen=True, tag=True):
    """Call of `turn_off_reward`."""

    off: Any


class Reset(msgspec.Struct, frozen=True, tag=True):
    """Call of `reset`."""

    seed: Any


class Step(msgspec.Struct, frozen=True, tag=True):
    """Call of `step`."""

    action: Any


class Close(msgspec.Struct, frozen=True, tag=True):
    """End the session."""


Call = Open | ChangePuzzle | SetObservation | Configure | TurnOffReward | Reset | Step | Close


class Request(msgspec.Struct, frozen=True):
    """A call in a session (empty for `Open`)."""

    session: str
    call: Call


class Opened(msgspec.Struct, frozen=True, tag=True):
    """Reply to `Open`: the session's name."""

    session: str


class Done(msgspec.Struct, frozen=True, tag=True):
    """Reply without a value: the call succeeded."""


class Observed(msgspec.Struct, frozen=True, tag=True):
    """Reply with the return value of `reset`."""

    observation: Observation


class Stepped(msgspec.Struct, frozen=True, tag=True):
    """Reply with the return value of `step`."""

    result: StepResult


Kind = Literal["usage", "config", "puzzle", "failed"]


class Refused(msgspec.Struct, frozen=True, tag=True):
    """Reply to a refused call. The session is unchanged."""

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
    """Convert values to those that a message can hold: NumPy numbers to Python's, tuples to lists.

    Raises:
        TypeError: if a value has another type.
    """
    return msgspec.to_builtins(value, enc_hook=_encode_number)


def _encode_number(value: Any) -> Any:
    if isinstance(value, np.integer | np.floating | np.bool_):
        return value.item()
    raise TypeError(f"expected numbers, text, lists or dictionaries, got {type(value).__name__}")


def _encode_image(value: Any) -> bytes:
    assert isinstance(value, np.ndarray)
    return value.tobytes()


def _decode_image(kind: type, value: Any) -> np.ndarray:
    shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
    if kind is not np.ndarray or not isinstance(value, bytes) or len(value) != np.prod(shape):
        raise ValueError(f"expected an image of {shape} bytes")
    return np.frombuffer(value, np.uint8).reshape(shape).copy()


_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_image)
_requests = msgspec.msgpack.Decoder(Request)
_replies = msgspec.msgpack.Decoder(Reply, dec_hook=_decode_image)


def encode(message: Request | Reply) -> bytes:
    """The body of a message."""
    return _encoder.encode(message)


def decode_request(body: bytes) -> Request:
    """The request in a body.

    Raises:
        ValueError: if the body is not a request.
    """
    return _decoded(_requests, body)


def decode_reply(body: bytes) -> Reply:
    """The reply in a body.

    Raises:
        ValueError: if the body is not a reply.
    """
    return _decoded(_replies, body)


def _decoded(decoder: "msgspec.msgpack.Decoder[Any]", body: bytes) -> Any:
    try:
        return decoder.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, GymOpenError) as error:
        raise ValueError(f"not a message of protocol {PROTOCOL}: {error}") from None
