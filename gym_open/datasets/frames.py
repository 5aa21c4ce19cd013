"""A segment of a log, or a piece of one, as the frames of a LeRobot episode.

    observation   o_0   o_1   …   o_T-1   o_T
    action        a_0   a_1   …   a_T-1    –      T actions, T + 1 frames
    valid          ✓     ✓    …    ✓       ✗      the last frame carries the final observation alone
    truncated      –     –    …    ✓       ✓      nothing comes after it in this episode

Of a segment longer than the cap, each piece is an episode; the observation at a cut ends one and begins the next.
"""

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import numpy as np

from gym_open.envs.constants import N_ACTIONS
from gym_open.formats.pictures import encode_png
from gym_open.formats.releases.features import fps

if TYPE_CHECKING:
    from gym_open.formats.logs.schemas import Segment

LENGTH_CAP = "length_cap"
"""`ended` of an episode that was cut for its length; the next episode goes on from its last observation."""
NO_ACTION = -1
"""`action.index` of the frame after the last action."""
_SPAN = 32
"""Pictures that a thread codes at a time."""


def numbers(segment: "Segment", *, episode: int, start: int) -> dict[str, np.ndarray]:
    """Every feature but the picture, steps + 1 rows each, by the names of `features.features`.

    Args:
        segment: what becomes an episode.
        episode: its number in the release.
        start: number of its first frame in the release.
    """
    steps, contacts = len(segment.actions), segment.contacts
    state = segment.object_state.astype(np.float32)
    agent = segment.object_names.index("agent")
    row = np.arange(steps + 1)
    one_hot = np.zeros((steps + 1, N_ACTIONS), dtype=np.float32)
    one_hot[row[:-1], segment.actions] = 1
    return {
        "observation.state": state[:, agent],
        "observation.environment_state": state.reshape(steps + 1, -1),
        "action": one_hot,
        "action.index": _padded(segment.actions, np.int64, NO_ACTION),
        "reward.intrinsic": _padded(segment.intrinsic_reward, np.float32),
        "world_model.loss": _padded(segment.world_model_loss, np.float32, _nothing(segment.world_model_loss)),
        "policy.entropy": _padded(segment.policy_entropy, np.float32),
        "policy.value": _padded(segment.value, np.float32),
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


def _nothing(losses: np.ndarray) -> float:
    """What stands where there was no action: 0, or of an explorer without a model, what stands everywhere."""
    return float("nan") if np.isnan(losses).all() and losses.size else 0.0


def encode_pngs(images: np.ndarray, pool: Executor) -> list[bytes]:
    """PNG files of (n, H, W, 3) uint8 pictures, in their order, encoded by the threads of `pool`."""

    def encode(first: int) -> list[bytes]:
        return [encode_png(image) for image in images[first : first + _SPAN]]

    return [data for span in pool.map(encode, range(0, len(images), _SPAN)) for data in span]
