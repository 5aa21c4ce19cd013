"""The drawn scenery has the positions of the simulator's geoms."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

from gym_open.envs.puzzles import SIDES, Patch, Pen, Placement, Puzzle, Side
from gym_open.envs.world import World
from gym_open.viz.streams.table import log_scenery
from gym_open.viz.view import times

GEOMS = {
    "pen": ("pen_east", "pen_west", "pen_north", "pen_south"),
    "ramp": ("ramp_slope", "ramp_platform"),
    "patch": ("patch",),
}
CELL = 0.01
"""Metres between two sampled points of the table."""


def covered(centres: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Points of the table below axis-aligned boxes; centres and half sizes are (n, 3)."""
    points = np.stack(np.meshgrid(np.arange(-0.7, 0.7, CELL), np.arange(-1.2, 1.2, CELL)), axis=-1)
    apart = np.abs(points[:, :, None] - centres[:, :2])
    return np.any((apart <= halves[:, :2]).all(axis=-1), axis=-1)


def simulated(puzzle: Puzzle, names: tuple[str, ...]) -> np.ndarray:
    world = World()
    world.load(puzzle)
    numbers = [world.model.geom(name).id for name in names]
    turns = np.abs(world.data.geom_xmat[numbers].reshape(-1, 3, 3))
    return covered(world.data.geom_xpos[numbers], np.einsum("nij,nj->ni", turns, world.model.geom_size[numbers]))


@pytest.mark.parametrize("side", list(SIDES))
def test_scenery_is_where_the_simulator_has_it(side: Side, tmp_path: Path, read_back: Callable[[Path], Any]) -> None:
    objects = (Placement("agent", 14, 7),)
    puzzle = Puzzle(task="sandbox", objects=objects, pen=Pen(5, 3, side), patch=Patch(11, 5))
    with rr.RecordingStream("test", recording_id="test") as rec:
        rec.save(tmp_path / "table.rrd")
        log_scenery(rec, "table", puzzle, times([0]))
        log_scenery(rec, "table", Puzzle(task="sandbox", objects=objects), times([1]))
    recording = read_back(tmp_path / "table.rrd")
    for piece, names in GEOMS.items():
        _, (centres, none) = recording.column(f"/table/{piece}", "Boxes3D:centers")
        _, (halves, _) = recording.column(f"/table/{piece}", "Boxes3D:half_sizes")
        assert none == []  # the next world does not have it
        drawn, there = covered(np.array(centres), np.array(halves)), simulated(puzzle, names)
        differ = (drawn ^ there).sum() / there.sum()
        assert differ < (0.1 if piece == "ramp" else 0.001)  # the drawn ramp ends in the middle of the wall
