"""The frames of a LeRobot episode, from a segment of a log or a piece of one.

    observation   o_0   o_1   …   o_T-1   o_T
    action        a_0   a_1   …   a_T-1    –      T actions, T + 1 frames
    valid          ✓     ✓    …    ✓       ✗      the last frame holds only the final observation
    truncated      –     –    …    ✓       ✓      nothing comes after it in this episode

A segment longer than the cap becomes several episodes. The observation at a cut ends one episode and begins the next.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gym_open.envs.constants import N_ACTIONS
from gym_open.formats.releases.features import fps
from gym_open.formats.releases.layout import PART

if TYPE_CHECKING:
    from gym_open.formats.logs.schemas import Segment

LENGTH_CAP = "length_cap"
"""`ended` of an episode that was cut for its length. The next episode begins with its last observation."""
NO_ACTION = -1
"""`action.index` of the frame after the last action."""


def numbers(segment: "Segment", parts: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """All features except image and bookkeeping, with steps + 1 rows each, by their names in `features.features`.

    Args:
        segment: a segment, or a piece of one.
        parts: names of the parts of the reward in the release. Parts that the log lacks are NaN.
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
        **{PART + name: _part(segment.reward_parts.get(name), steps) for name in parts},
        "policy.entropy": _padded(segment.policy_entropy, np.float32),
        "policy.value": _padded(segment.value, np.float32),
        "contact.count": _padded(np.array([len(step) for step in contacts]), np.int64),
        "contact.agent": _padded(np.array([sum("agent" in (c.a, c.b) for c in step) for step in contacts]), np.int64),
        "contact.impulse": _padded(np.array([sum(c.impulse for c in step) for step in contacts]), np.float32),
        "next.reward": np.zeros(steps + 1, dtype=np.float32),  # exploration has no task, so no extrinsic reward
        "next.done": np.zeros(steps + 1, dtype=bool),
        "next.truncated": row >= steps - 1,
        "transition.valid": row < steps,
        "timestamp": (row / fps()).astype(np.float32),
        "frame_index": row,
    }


def _padded(values: np.ndarray, dtype: type, fill: float = 0) -> np.ndarray:
    return np.append(values.astype(dtype), np.asarray(fill, dtype=dtype))


def _nothing(losses: np.ndarray) -> float:
    """The loss on the last frame: 0, or NaN as everywhere if the explorer has no world model."""
    return float("nan") if np.isnan(losses).all() and losses.size else 0.0


def _part(values: np.ndarray | None, steps: int) -> np.ndarray:
    """A part of the reward; NaN on the last frame, or everywhere if there is no such part."""
    return _padded(np.full(steps, np.nan) if values is None else values, np.float32, float("nan"))
