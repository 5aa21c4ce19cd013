"""What happened during an exploration run: counts per world, and the record of the run, for `summary.json`."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np

from gym_open.collect.config import CollectConfig
from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.logs.schemas import Ended, Stuck

CURVE = ["step", "world_model_loss", "world_loss", "intrinsic_reward", "policy_entropy"]
"""Columns of the curve, with one row per rollout: steps of all streams so far; the world model's loss in the update
and the mean loss of the current worlds as the curriculum measures it (both scaled); and means over the rollout."""
STOPS = ("budget", "exhausted")
"""Reasons that end the last segment of a stream."""
TOUCHED = ("yellow", "green", "heavy", "light", "push", "rectangle", "cone", "wall", "corner", "pen", "ramp")
"""Kinds of things that the agent can touch: objects, then scenery. Kinds that were never touched count 0."""
STUCK = ("agent", "corner")


class StuckCount(msgspec.Struct):
    """How often things got stuck, and for how many steps at least one thing was stuck."""

    times: int = 0
    steps: int = 0


def _none_touched() -> dict[str, int]:
    return dict.fromkeys(TOUCHED, 0)


def _none_stuck() -> dict[str, StuckCount]:
    return {kind: StuckCount() for kind in STUCK}


class WorldCounts(msgspec.Struct):
    """Counts of one world over all streams, as plain data for a checkpoint."""

    visits: int = 0
    """Times that a stream entered the world."""
    steps: int = 0
    cells: list[int] = msgspec.field(default_factory=lambda: [0] * (ROWS * COLUMNS))
    """Steps after which the agent was in each cell of the placement grid, row by row."""
    touches: dict[str, int] = msgspec.field(default_factory=_none_touched)
    """Things of each kind that the agent touched, summed over steps."""
    stuck: dict[str, StuckCount] = msgspec.field(default_factory=_none_stuck)
    """Counts of the stuck `agent`, and of objects stuck in a `corner`."""

    def step(self, agent: tuple[float, float, float], contacts: Iterable[Contact]) -> None:
        """Count a step, given the position of the agent after it (metres) and the contacts during it."""
        self.steps += 1
        self.cells[cell_at(agent[0], agent[1])] += 1
        for contact in contacts:
            if "agent" in (contact.a, contact.b):
                other = contact.b if contact.a == "agent" else contact.a
                self.touches[other.split("_")[0]] += 1

    def stuck_step(self, turns: Iterable[Stuck], *, agent: bool, corner: bool) -> None:
        """Count what got stuck in a step, and whether the agent or an object in a corner is stuck after it."""
        for turn in turns:
            self.stuck[turn.kind].times += turn.began
        self.stuck["agent"].steps += agent
        self.stuck["corner"].steps += corner

    def cells_seen(self) -> int:
        """Cells of the table in which the agent was."""
        return sum(count > 0 for count in self.cells)


def cell_at(x: float, y: float) -> int:
    """Number, row by row, of the placement grid's cell at or nearest to a position on the table (metres)."""
    row, column = round((CELL_0[1] - y) / PITCH), round((x - CELL_0[0]) / PITCH)
    return min(max(row, 0), ROWS - 1) * COLUMNS + min(max(column, 0), COLUMNS - 1)


class SegmentRecord(msgspec.Struct):
    """A finished segment: consecutive steps of a stream in one world."""

    stream: int
    segment: int
    world: int
    steps: int
    loss_at_entry: float
    """Loss in the decision to enter the world; infinite (null in JSON) for a fresh world."""
    loss_at_exit: float
    ended: Ended


class RunRecord(msgspec.Struct):
    """What happened so far in a run, as plain data for a checkpoint."""

    rollouts: int = 0
    steps: int = 0
    """Steps of all streams."""
    decisions: int = 0
    """Decisions of the curriculum, including those to stay."""
    last_losses: list[float] = []
    """Loss of every world at the last decision of the curriculum; empty before the first."""
    segments: list[SegmentRecord] = []
    """Finished segments."""
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
    config: CollectConfig, record: RunRecord, puzzles: Sequence[Puzzle], counts: Sequence[WorldCounts]
) -> dict[str, Any]:
    """The summary of a finished run as JSON-ready data. Losses that are infinite or NaN become null.

    Coverage is the share of cells of the placement grid: 16 rows from the far end by 9 columns from the left.
    """
    cells = np.array([count.cells for count in counts])
    worlds = [
        {
            "world": index,
            "puzzle": puzzle.digest,
            "visits": count.visits,
            "steps": count.steps,
            "final_loss": loss,
            "coverage": count.cells_seen() / cells.shape[1],
            "touches": count.touches,
            "stuck": count.stuck,
        }
        for index, (puzzle, count, loss) in enumerate(zip(puzzles, counts, record.final_losses, strict=True))
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
        "touches": {kind: sum(count.touches[kind] for count in counts) for kind in TOUCHED},
        "stuck": {
            kind: {name: sum(getattr(count.stuck[kind], name) for count in counts) for name in ("times", "steps")}
            for kind in STUCK
        },
        "worlds": worlds,
        "segments": record.segments,
        "curve": {"columns": CURVE, "rows": record.curve},
    }
    return msgspec.json.decode(msgspec.json.encode(summary))
