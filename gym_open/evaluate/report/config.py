"""Configuration of `gym-open report`."""

from typing import Annotated

from msgspec import Meta

from gym_open.config import Config, Seed
from gym_open.envs.puzzles.sets import Split


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
