"""A log's segment as the frames of LeRobot episodes.

    observation   o_0   o_1   …   o_T-1   o_T
    action        a_0   a_1   …   a_T-1    –      T actions, T + 1 frames
    valid          ✓     ✓    …    ✓       ✗      the last frame carries the final observation alone
    truncated      –     –    …    ✓       ✓      nothing comes after it in this episode

A segment longer than the cap is cut into pieces; the observation at a cut ends one piece and begins the next.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from gym_open.datasets.features import fps
from gym_open.envs.constants import N_ACTIONS
from gym_open.formats.pictures import encode_png

if TYPE_CHECKING:
    from gym_open.formats.log_schemas import Segment

LENGTH_CAP = "length_cap"
"""`ended` of an episode that was cut for its length; the next episode goes on from its last observation."""
NO_ACTION = -1
"""`action.index` of the frame after the last action."""
_SPAN = 32
"""Pictures that a thread codes at a time."""


class Piece(msgspec.Struct, frozen=True, eq=False):
    """Steps `first` to `stop` of a segment: one episode."""

    segment: "Segment"
    number: int
    first: int
    stop: int

    @property
    def steps(self) -> int:
        """Number of actions; there is one frame more."""
        return self.stop - self.first

    @property
    def ended(self) -> str:
        """Why the episode ends: the segment's reason, or `length_cap`."""
        return self.segment.ended if self.stop == len(self.segment.actions) else LENGTH_CAP

    @property
    def continued(self) -> bool:
        """Whether an earlier episode ended in the state that this one begins with."""
        return self.segment.continued or self.number > 0

    @property
    def images(self) -> np.ndarray:
        """(steps + 1, 84, 84, 3) uint8."""
        return self.segment.images[self.first : self.stop + 1]


def pieces(segment: "Segment", cap: int) -> Iterator[Piece]:
    """Cut a segment into episodes of at most `cap` steps; one without any action is one episode of one frame."""
    total = len(segment.actions)
    for number, first in enumerate(range(0, max(total, 1), cap)):
        yield Piece(segment, number, first, min(first + cap, total))


def numbers(piece: Piece, *, episode: int, start: int) -> dict[str, np.ndarray]:
    """Every feature but the picture, steps + 1 rows each, by the names of `features.features`.

    Args:
        piece: what becomes an episode.
        episode: its number in the release.
        start: number of its first frame in the release.
    """
    segment, steps = piece.segment, piece.steps
    span = slice(piece.first, piece.stop)
    state = segment.object_state[piece.first : piece.stop + 1].astype(np.float32)
    contacts = segment.contacts[span]
    agent = segment.object_names.index("agent")
    row = np.arange(steps + 1)
    one_hot = np.zeros((steps + 1, N_ACTIONS), dtype=np.float32)
    one_hot[row[:-1], segment.actions[span]] = 1
    return {
        "observation.state": state[:, agent],
        "observation.environment_state": state.reshape(steps + 1, -1),
        "action": one_hot,
        "action.index": _padded(segment.actions[span], np.int64, NO_ACTION),
        "reward.intrinsic": _padded(segment.intrinsic_reward[span], np.float32),
        "world_model.loss": _padded(segment.world_model_loss[span], np.float32),
        "policy.entropy": _padded(segment.policy_entropy[span], np.float32),
        "policy.value": _padded(segment.value[span], np.float32),
        "contact.count": _padded(np.array([len(step) for step in contacts]), np.int64),
        "contact.agent": _padded(np.array([sum("agent" in (c.a, c.b) for c in step) for step in contacts]), np.int64),
        "contact.impulse": _padded(np.array([sum(c.impulse for c in step) for step in contacts]), np.float32),
        "next.reward": np.zeros(steps + 1, dtype=np.float32),  # play has no task: there is no extrinsic reward
        "next.done": np.zeros(steps + 1, dtype=bool),
        "next.truncated": row >= steps - 1,
        "transition.valid": row < steps,
        "timestamp": (row / fps()).astype(np.float32),
        "frame_index": row,
        "episode_index": np.full(steps + 1, episode),
        "index": start + row,
        "task_index": np.zeros(steps + 1, dtype=np.int64),
    }


def _padded(values: np.ndarray, dtype: type, fill: float = 0) -> np.ndarray:
    return np.append(values.astype(dtype), np.asarray(fill, dtype=dtype))


def encode_pngs(images: np.ndarray, pool: Executor) -> list[bytes]:
    """PNG files of (n, H, W, 3) uint8 pictures, in their order, encoded by the threads of `pool`."""

    def encode(first: int) -> list[bytes]:
        return [encode_png(image) for image in images[first : first + _SPAN]]

    return [data for span in pool.map(encode, range(0, len(images), _SPAN)) for data in span]
