"""Counts of what happened in a world."""

import pytest

from gym_open.collect.summary import WorldCounts, cell_at
from gym_open.envs.constants import COLUMNS, PITCH, ROWS, WALL_X, WALL_Y, cell_centre
from gym_open.envs.physics.contacts import Contact
from gym_open.formats.logs import Stuck


def contact(a: str, b: str) -> Contact:
    return Contact(a, b, (0, 0, 0), (1, 0, 0), 1.0)


def test_a_position_is_in_the_cell_with_the_nearest_centre() -> None:
    for row in range(ROWS):
        for column in range(COLUMNS):
            x, y = cell_centre(row, column)
            for dx, dy in ((0, 0), (0.49, 0.49), (-0.49, 0.49), (0.49, -0.49)):
                assert cell_at(x + dx * PITCH, y + dy * PITCH) == row * COLUMNS + column


@pytest.mark.parametrize(
    ("x", "y", "cell"), [(-WALL_X, WALL_Y, 0), (WALL_X, -WALL_Y, ROWS * COLUMNS - 1), (9, 9, COLUMNS - 1)]
)
def test_a_position_beyond_the_grid_is_in_the_nearest_cell(x: float, y: float, cell: int) -> None:
    assert cell_at(x, y) == cell


def test_steps_cells_and_touches_of_the_agent_are_counted() -> None:
    counts = WorldCounts()
    counts.step((*cell_centre(0, 1), 0.05), [contact("agent", "heavy_11"), contact("heavy_11", "agent")])
    counts.step((*cell_centre(0, 1), 0.05), [contact("corner_north_east", "agent"), contact("light_0", "heavy_0")])
    counts.step((*cell_centre(2, 0), 0.05), [contact("agent", "ramp_slope"), contact("agent", "wall_east")])
    assert counts.steps == 3
    assert {cell: count for cell, count in enumerate(counts.cells) if count} == {1: 2, 2 * COLUMNS: 1}
    assert counts.cells_seen() == 2
    touched = {kind: count for kind, count in counts.touches.items() if count}
    assert touched == {"heavy": 2, "corner": 1, "ramp": 1, "wall": 1}


def test_stuck_things_are_counted_by_starts_and_steps() -> None:
    counts = WorldCounts()
    began, ceased = (Stuck(5, 0, "corner", "light_0", began, (0, 0, 0)) for began in (True, False))
    counts.stuck_step([began, began], agent=False, corner=True)
    counts.stuck_step([], agent=True, corner=True)
    counts.stuck_step([ceased], agent=True, corner=False)
    assert (counts.stuck["corner"].times, counts.stuck["corner"].steps) == (2, 2)
    assert (counts.stuck["agent"].times, counts.stuck["agent"].steps) == (0, 2)
