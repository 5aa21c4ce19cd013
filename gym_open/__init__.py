"""gym-open: OPEn, an open-ended physics environment for learning without a task, as data and offline learning."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium

from gym_open import extras

if TYPE_CHECKING:
    from gym_open.agents.encoder import Encoder

__version__ = "0.1.0"

ENV_IDS = {
    "sandbox": "gym_open/Sandbox-v1",
    "goal-seeking": "gym_open/GoalSeeking-v1",
    "preferences": "gym_open/Preferences-v1",
    "avoidance": "gym_open/Avoidance-v1",
    "tool-use": "gym_open/ToolUse-v1",
}
"""Gymnasium id of each task."""

for _task, _name in ENV_IDS.items():
    # The string is imported when an environment is made: physics and ray caster load only then.
    if _name not in gymnasium.registry:
        gymnasium.register(
            id=_name,
            entry_point="gym_open.envs.env:OpenEnv",
            vector_entry_point="gym_open.envs.vector:OpenVectorEnv",
            kwargs={"task": _task},
        )

PAPER_ENV_ID = "open_puzzle_proc-v0"
"""The id that the paper's supplement names, as `gym_open:open_puzzle_proc-v0`: its own interface, not Gymnasium's."""

if PAPER_ENV_ID not in gymnasium.registry:
    gymnasium.register(
        id=PAPER_ENV_ID,
        entry_point="gym_open.remote.supplement:OpenPuzzleEnv",
        order_enforce=False,  # its listings step before any reset, and a wrapper would hide its methods
        disable_env_checker=True,
    )


def load_encoder(path: Path | str) -> "Encoder":
    """The encoder in a folder: one that `train encoder` made, a log's own, or one fetched from the Hugging Face hub.

    `load_encoder(path).encode(images)` turns (B, 84, 84, 3) uint8 pictures into (B, features) float32.

    Raises:
        ArtefactError: if a file is missing or damaged, or a tensor is not what the architecture says.
        MissingExtraError: if torch is not installed.
    """
    extras.check("train")
    # By name, since every room imports this package, and none may import the rooms above it.
    return import_module("gym_open.formats.models").load_encoder(Path(path))
