"""What happened during a run, for `summary.json`."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from gym_open.collect.config import CollectConfig
from gym_open.collect.tally import STUCK, TOUCHED, Tally
from gym_open.envs.constants import COLUMNS, ROWS
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.logs.schemas import Ended

CURVE = ["step", "world_model_loss", "world_loss", "intrinsic_reward", "policy_entropy"]
"""Columns of the curve, one row a rollout: steps of all streams so far, then the world model's loss in the update and
the mean loss of the worlds being played in as the curriculum measures it (both scaled), and means over the rollout."""
STOPS = ("budget", "exhausted")
"""Why a stay ended that no other followed."""


class SegmentRecord(msgspec.Struct):
    """One stay of a stream in a world."""

    stream: int
    segment: int
    world: int
    steps: int
    loss_at_entry: float
    """As it decided; infinite (null in JSON) for a world that was fresh."""
    loss_at_exit: float
    ended: Ended


class Record(msgspec.Struct):
    """What happened so far; part of a checkpoint."""

    rollouts: int = 0
    steps: int = 0
    """Of all streams."""
    decisions: int = 0
    """Of the curriculum, to stay included."""
    last_losses: list[float] = []
    """Loss of every world when the curriculum last decided; empty before that."""
    segments: list[SegmentRecord] = []
    """Those that have ended."""
    curve: list[tuple[int, float, float, float, float]] = []
    """Rows of `CURVE`."""
    final_losses: list[float] = []
    """Loss of every world when the run ended."""
    ended: Ended | None = None

    @property
    def switches(self) -> int:
        """How many times a stream went from one world to another."""
        return sum(segment.ended not in STOPS for segment in self.segments)


def summarise(
    config: CollectConfig, record: Record, puzzles: Sequence[Puzzle], tallies: Sequence[Tally]
) -> dict[str, Any]:
    """The summary of a run that has ended, as JSON-ready data; losses that are infinite or no numbers become null.

    Shares of the table are of the cells of the placement grid, 16 rows from the far end by 9 columns from the left.
    """
    cells = np.array([tally.cells for tally in tallies])
    worlds = [
        {
            "world": index,
            "puzzle": puzzle.digest,
            "visits": tally.visits,
            "steps": tally.steps,
            "final_loss": loss,
            "coverage": tally.cells_seen() / cells.shape[1],
            "touches": tally.touches,
            "stuck": tally.stuck,
        }
        for index, (puzzle, tally, loss) in enumerate(zip(puzzles, tallies, record.final_losses, strict=True))
    ]
    summary = {
        "explorer": config.explorer.name,
        "rule": config.curriculum.rule,
        "steps": record.steps,
        "ended": record.ended,
        "switches": record.switches,
        "reasons": dict(sorted(Counter(segment.ended for segment in record.segments).items())),
        "coverage": {
            "share": float((cells.sum(axis=0) > 0).mean()),
            "share_of_visited_worlds": float((cells[cells.any(axis=1)] > 0).mean()),
            "cells": cells.sum(axis=0).reshape(ROWS, COLUMNS).tolist(),
        },
        "touches": {kind: sum(tally.touches[kind] for tally in tallies) for kind in TOUCHED},
        "stuck": {
            kind: {name: sum(getattr(tally.stuck[kind], name) for tally in tallies) for name in ("times", "steps")}
            for kind in STUCK
        },
        "worlds": worlds,
        "segments": record.segments,
        "curve": {"columns": CURVE, "rows": record.curve},
    }
    return msgspec.json.decode(msgspec.json.encode(summary))
