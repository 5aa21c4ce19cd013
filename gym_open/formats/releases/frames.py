"""The frames of a LeRobot episode, from a segment of a log or a piece of one.

    observation   o_0   o_1   …   o_T-1   o_T
    action        a_0   a_1   …   a_T-1    –      T actions, T + 1 frames
    valid          ✓     ✓    …    ✓       ✗      the last frame holds only the final observation
    truncated      –     –    …    ✓       ✓      nothing comes after it in this episode

A segment longer than the cap becomes several episodes. The observation at a cut ends one episode and begins the next.
"""

from collections.abc import Mapping, Sequence
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
    touching = [len(step) for step in segment.contacts]
    with_agent = [sum("agent" in (pair.a, pair.b) for pair in step) for step in segment.contacts]
    nothing = np.full(len(segment.actions), np.nan)
    return frame_numbers(
        segment.actions,
        segment.object_state,
        segment.object_names.index("agent"),
        np.array([touching, with_agent], dtype=np.int64).T,
        np.array([_sum([pair.impulse for pair in step]) for step in segment.contacts], dtype=np.float64),
        {
            "reward.intrinsic": segment.intrinsic_reward,
            **{PART + name: segment.reward_parts.get(name, nothing) for name in parts},
            "world_model.loss": segment.world_model_loss,
            "policy.entropy": segment.policy_entropy,
            "policy.value": segment.value,
        },
    )


def frame_numbers(  # noqa: PLR0917  # what a replay gives, in its order
    actions: np.ndarray,
    states: np.ndarray,
    agent: int,
    contacts: np.ndarray,
    impulses: np.ndarray,
    learned: Mapping[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """The same from arrays.

    Args:
        actions: (T,) integers.
        states: (T + 1, N, 13): states of all objects.
        agent: index of the agent among them.
        contacts: (T, 2): number of contacts in each step, and of those with the agent.
        impulses: (T,): their impulses, summed.
        learned: (T,) values of `LEARNED` and of parts of the reward, by feature; those that the release has.
    """
    steps = len(actions)
    state = states.astype(np.float32)
    row = np.arange(steps + 1)
    one_hot = np.zeros((steps + 1, N_ACTIONS), dtype=np.float32)
    one_hot[row[:-1], actions] = 1
    return {
        "observation.state": state[:, agent],
        "observation.environment_state": state.reshape(steps + 1, -1),
        "action": one_hot,
        "action.index": _padded(actions, np.int64, NO_ACTION),
        **{name: _padded(values, np.float32, _after_last(name, values)) for name, values in learned.items()},
        "contact.count": _padded(contacts[:, 0], np.int64),
        "contact.agent": _padded(contacts[:, 1], np.int64),
        "contact.impulse": _padded(impulses, np.float32),
        "next.reward": np.zeros(steps + 1, dtype=np.float32),  # exploration has no task, so no extrinsic reward
        "next.done": np.zeros(steps + 1, dtype=bool),
        "next.truncated": row >= steps - 1,
        "transition.valid": row < steps,
        "timestamp": (row / fps()).astype(np.float32),
        "frame_index": row,
    }


def _sum(values: Sequence[float]) -> float:
    """Sum in order, without the compensation of `sum` since Python 3.12: the same bits in every Python."""
    total = 0.0
    for value in values:
        total += value
    return total


def _after_last(name: str, values: np.ndarray) -> float:
    """Value on the last frame: NaN for a part of the reward and without a world model, else 0."""
    lacks_model = name == "world_model.loss" and values.size > 0 and bool(np.isnan(values).all())
    return float("nan") if name.startswith(PART) or lacks_model else 0.0


def _padded(values: np.ndarray, dtype: type, fill: float = 0) -> np.ndarray:
    return np.append(values.astype(dtype), np.asarray(fill, dtype=dtype))
