"""Configuration of `gym-open evaluate`."""

from typing import Literal

from gym_open.config import Config, PositiveInt, Seed


class EvaluateConfig(Config, frozen=True, kw_only=True):
    """How a policy is scored on the fixed 100 puzzles of a task."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task whose fixed test puzzles are played."""
    actions: Literal["sampled", "greedy"] = "sampled"
    """Draw actions from the policy, or take the most likely one."""
    threads: PositiveInt = 2
    """Torch threads; part of the configuration because the number of threads may change the last bits."""
    seed: Seed = 0
    """Root seed of the sampled actions."""
