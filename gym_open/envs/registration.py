"""The Gymnasium ids. Each entry point is a string: physics and ray caster load when an environment is made."""

import gymnasium

ENV_IDS = {
    "sandbox": "gym_open/Sandbox-v1",
    "goal-seeking": "gym_open/GoalSeeking-v1",
    "preferences": "gym_open/Preferences-v1",
    "avoidance": "gym_open/Avoidance-v1",
    "tool-use": "gym_open/ToolUse-v1",
}
"""Gymnasium id of each task."""

PAPER_ENV_ID = "open_puzzle_proc-v0"
"""The id in the paper's supplement: `gym_open:open_puzzle_proc-v0` has the supplement's interface, not Gymnasium's."""


def register() -> None:
    """Register all ids that are not registered yet."""
    for task, env_id in ENV_IDS.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                id=env_id,
                entry_point="gym_open.envs.env:OpenEnv",
                vector_entry_point="gym_open.envs.vector:OpenVectorEnv",
                kwargs={"task": task},
            )
    if PAPER_ENV_ID not in gymnasium.registry:
        gymnasium.register(
            id=PAPER_ENV_ID,
            entry_point="gym_open.remote.supplement:OpenPuzzleEnv",
            order_enforce=False,  # the supplement steps before any reset, and a wrapper would hide its methods
            disable_env_checker=True,
        )
