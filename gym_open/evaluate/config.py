"""Configuration of `gym-open evaluate`."""

from typing import Literal

from gym_open.config import Config, PositiveInt, Seed
from gym_open.envs.puzzles.sets import Split


class EvaluateConfig(Config, frozen=True, kw_only=True):
    """How a policy is scored on 100 fixed puzzles of a task."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task whose fixed puzzles are played."""
    split: Split = "test"
    """Which set: `validation` to choose between models, `test` to report."""
    actions: Literal["sampled", "greedy"] = "sampled"
    """Draw actions from the policy, or take the most likely one."""
    threads: PositiveInt = 2
    """Threads of torch and of the worlds; part of the configuration because torch's may change the last bits."""
    seed: Seed = 0
    """Root seed of the sampled actions."""


class CheckpointConfig(EvaluateConfig, frozen=True, kw_only=True):
    """How a policy is scored as it was during its training."""

    at: PositiveInt
    """The checkpoint, by the agent steps that the policy's configuration asked for."""


class OracleConfig(Config, frozen=True, kw_only=True):
    """What decides the oracle's scores."""

    task: str
    """Task whose fixed puzzles are played."""
    split: Split
    """Which set."""
    witnesses: str
    """SHA-256 of the set's witnesses."""
