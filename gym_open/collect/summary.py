"""What happened during a run, for `summary.json`."""

from collections.abc import Sequence
from typing import Any

import msgspec

from gym_open.collect.pool import Visits
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.log_schemas import Reason

CURVE = ["step", "world_model_loss", "world_loss", "intrinsic_reward", "policy_entropy"]
"""Columns of the curve, one row a rollout: steps of all streams so far, then the world model's loss in the update, the
mean loss of the worlds being played in as the curriculum measures it, and means over the rollout."""


class SegmentRecord(msgspec.Struct):
    """One stay of a stream in a world."""

    stream: int
    segment: int
    world: int
    steps: int
    loss_at_entry: float
    """As it decided; infinite (null in JSON) for a world that was fresh."""
    loss_at_exit: float
    ended: Reason


class Record(msgspec.Struct):
    """What happened so far; part of a checkpoint."""

    rollouts: int = 0
    steps: int = 0
    """Of all streams."""
    segments: list[SegmentRecord] = []
    """Those that have ended."""
    curve: list[tuple[int, float, float, float, float]] = []
    """Rows of `CURVE`."""
    final_losses: list[float] = []
    """Loss of every world when the run ended."""
    ended: Reason | None = None

    @property
    def switches(self) -> int:
        """How many times a stream went from one world to another."""
        return sum(segment.ended == "learned" for segment in self.segments)


def summarise(record: Record, puzzles: Sequence[Puzzle], visits: Sequence[Visits]) -> dict[str, Any]:
    """The summary as JSON-ready data; infinite losses become null."""
    worlds = [
        {"world": index, "puzzle": puzzle.digest, "visits": seen.visits, "steps": seen.steps, "final_loss": loss}
        for index, (puzzle, seen, loss) in enumerate(zip(puzzles, visits, record.final_losses, strict=True))
    ]
    return {
        "steps": record.steps,
        "ended": record.ended,
        "switches": record.switches,
        "worlds": worlds,
        "segments": msgspec.to_builtins(record.segments),
        "curve": {"columns": CURVE, "rows": record.curve},
    }
