"""Configurations of `gym-open evaluate` and `gym-open report`."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.config import Config, PositiveInt, Seed
from gym_open.envs.puzzles.sets import Split


class EvaluateConfig(Config, frozen=True, kw_only=True):
    """How a policy is scored on the 100 fixed puzzles of a task."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task whose fixed puzzles are played."""
    split: Split = "test"
    """Set of puzzles: `validation` to choose between models, `test` to report."""
    actions: Literal["sampled", "greedy"] = "sampled"
    """Draw actions from the policy, or take the most likely action."""
    threads: PositiveInt = 2
    """Threads of torch and of the worlds; torch's threads may change the last bits of scores."""
    seed: Seed = 0
    """Root seed of the sampled actions."""


class CheckpointConfig(EvaluateConfig, frozen=True, kw_only=True):
    """How a checkpoint of a policy is scored."""

    at: PositiveInt
    """The checkpoint: agent steps, as in the policy's configuration."""


class OracleConfig(Config, frozen=True, kw_only=True):
    """Configuration of the oracle's scores."""

    task: str
    """Task whose fixed puzzles are played."""
    split: Split
    """Set of puzzles."""
    witnesses: str
    """SHA-256 of the set's witnesses."""


class ReportConfig(Config, frozen=True, kw_only=True):
    """What a report shows, and how its intervals are drawn."""

    title: Annotated[str, Meta(min_length=1, max_length=120)] = "What was exploration worth?"
    """Heading of the page."""
    split: Split = "test"
    """Set of puzzles; scores on the other set are left out, and the report says so."""
    reference: Annotated[str, Meta(max_length=80)] = ""
    """Agent that the others are compared with, task by task; if empty, the agent trained from scratch."""
    thresholds: tuple[Annotated[float, Meta(gt=0, lt=1)], ...] = (0.3, 0.5)
    """Values of A-Success; the report shows when fine-tuning first reaches each."""
    resamples: Annotated[int, Meta(ge=100, le=100_000)] = 2000
    """Bootstrap resamples for each interval."""
    confidence: Annotated[float, Meta(ge=0.5, lt=1)] = 0.95
    """Share of resamples inside an interval."""
    seed: Seed = 0
    """Root seed of the resamples."""
