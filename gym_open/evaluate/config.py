"""Configurations of `gym-open evaluate` and `gym-open report`."""

from typing import Annotated, Literal

from msgspec import Meta

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


class ReportConfig(Config, frozen=True, kw_only=True):
    """What a report is of, and how its intervals are drawn."""

    title: Annotated[str, Meta(min_length=1, max_length=120)] = "What was play worth?"
    """Heading of the page."""
    split: Split = "test"
    """Scores on this set of puzzles are reported; those on the other are left out, which the report says."""
    reference: Annotated[str, Meta(max_length=80)] = ""
    """Agent that the others are compared with, task by task; if empty, the one from scratch."""
    thresholds: tuple[Annotated[float, Meta(gt=0, lt=1)], ...] = (0.3, 0.5)
    """Values of A-Success whose first crossing in fine-tuning is looked for."""
    resamples: Annotated[int, Meta(ge=100, le=100_000)] = 2000
    """Bootstrap resamples behind every interval."""
    confidence: Annotated[float, Meta(ge=0.5, lt=1)] = 0.95
    """Share of resamples within an interval."""
    seed: Seed = 0
    """Root seed of the resamples."""
