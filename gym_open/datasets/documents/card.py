"""README.md: the card of a release in the form of the hub. It is written from the data, without dates or paths."""

import functools
from typing import TYPE_CHECKING

from gym_open.datasets.config import Header
from gym_open.datasets.documents.facts import ReleaseFacts
from gym_open.formats.releases.features import ACTION_NAMES, fps
from gym_open.formats.releases.layout import PART
from gym_open.markdown import cell

if TYPE_CHECKING:
    from jinja2 import Template

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
"""The hub's size categories, by number of frames."""
_LARGEST = "10M<n<100M"
MEANINGS = {
    "observation.image": "image of the camera, RGB",
    "observation.state": "the agent: position (m), quaternion wxyz, linear (m/s) and angular velocity (rad/s)",
    "observation.environment_state": "like `observation.state`, for every object; unused ones are parked at y = −30 m",
    "action": "one-hot, nine moves",
    "action.index": "number of the action; −1 on the last frame of an episode",
    "reward.intrinsic": "intrinsic reward of the explorer",
    "reward_part": "part of the intrinsic reward; NaN for explorers without it",
    "world_model.loss": "loss of the world model in the current world, as the curriculum scales it; or NaN",
    "policy.entropy": "entropy in nats of the policy that chose the action",
    "policy.value": "value that the critic of the policy predicted",
    "contact.count": "contacts in the step",
    "contact.agent": "contacts of the agent in the step",
    "contact.impulse": "sum of the impulses of all contacts (N s)",
    "next.reward": "extrinsic reward: always 0",
    "next.done": "always False",
    "next.truncated": "True for the last action and the frame after it",
    "transition.valid": "False on the last frame of an episode, which has no action",
    "timestamp": "seconds since the start of the episode",
    "frame_index": "within the episode",
    "episode_index": "within the release",
    "index": "within the release",
    "task_index": "always 0: there is no task",
}
"""Descriptions of the features, for the card."""


def description(facts: ReleaseFacts) -> str:
    """Describe the release in one sentence."""
    release = facts.release
    return (
        f"Observations and actions of exploration policies in gym-open's sandbox, a table with spheres and cubes that "
        f"an agent pushes with nine discrete moves, without a task and without extrinsic reward: {len(release):,} "
        f"frames of 84×84 RGB in {len(release.episodes):,} episodes, {facts.steps:,} actions at {fps()} per simulated "
        "second."
    )


def card(header: Header, facts: ReleaseFacts) -> str:
    """Text of the card."""
    release = facts.release
    return _template().render(
        header=header, facts=facts, release=release, ours=release.info["gym_open"], description=description(facts),
        size=next((name for most, name in _SIZES if len(release) < most), _LARGEST), actions=ACTION_NAMES, fps=fps(),
    )  # fmt: skip


@functools.cache
def _template() -> "Template":
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gym_open.datasets.documents", "."), autoescape=jinja2.select_autoescape(),
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= {
        "cell": cell, "code": _code, "meaning": _meaning,
        "count": "{:,}".format, "digits": "{:.4g}".format,
        "decimals": lambda value, places: f"{value:,.{places}f}",
        "percent": lambda value, places: f"{value:.{places}%}",
    }  # fmt: skip
    return environment.get_template("card.md.jinja")


def _meaning(feature: str) -> str:
    return MEANINGS["reward_part"] if feature.startswith(PART) else MEANINGS.get(feature, "")


def _code(name: str) -> str:
    """The name of a feature for use between back-ticks, where escapes do not work."""
    return "".join(c if c.isalnum() or c in "._-+ " else "?" for c in name)
