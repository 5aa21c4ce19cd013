"""Difficulty of the fixed puzzles: the oracle and the shortest path on the grid. Prints the table of docs/puzzles.md.

.venv/bin/python benchmarks/measure_puzzles.py
"""

import math
from collections import deque

import numpy as np
from rich.console import Console
from rich.table import Table

from gym_open.envs.constants import COLUMNS, ROWS
from gym_open.envs.puzzles import CUBES, SIDES, TASKS, Cell, Puzzle, Task, block, pen_wall_cells, ramp_cells
from gym_open.envs.puzzles.sets import SPLITS, Split, puzzles_of
from gym_open.envs.puzzles.witnesses import witnesses_of
from gym_open.envs.tasks import REWARDS, step_budget
from gym_open.evaluate.play import replay
from gym_open.evaluate.scores import summarise

STEPS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
PAPERS_HUMANS = {"goal-seeking": 0.584, "preferences": 0.588, "avoidance": 0.453, "tool-use": 0.363}
ORIGINALS_GRID = {"goal-seeking": 0.678, "preferences": 0.667, "avoidance": 0.661}
"""Shortest path on the grid over 1000 puzzles of the original's generators."""


def grid_distance(blocked: set[Cell], start: Cell, goal: Cell) -> int | None:
    """Fewest moves over free cells to any of the eight cells around, without cutting corners of blocked cells."""
    seen = {start: 0}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell == goal:
            return seen[cell]
        for i, j in STEPS:
            there = cell[0] + i, cell[1] + j
            on_table = 0 <= there[0] < ROWS and 0 <= there[1] < COLUMNS
            beside = {there, (cell[0] + i, cell[1]), (cell[0], cell[1] + j)}
            if on_table and there not in seen and blocked.isdisjoint(beside):
                seen[there] = seen[cell] + 1
                queue.append(there)
    return None


def grid_path(puzzle: Puzzle) -> list[tuple[float, int]] | None:
    """Value of each goal, and the action at which the shortest path touches it without pushing cubes; None: no path.

    Green comes before yellow. A pen is left straight over its ramp, from the foot to the cell behind the wall.
    """
    cells = {item.kind: (item.row, item.column) for item in puzzle.objects}
    blocked = {(item.row, item.column) for item in puzzle.objects if item.kind in CUBES}
    at, moves, path = cells["agent"], 0, []
    if puzzle.patch:
        blocked |= block(puzzle.patch.row, puzzle.patch.column, 1)
    if pen := puzzle.pen:
        i, j = SIDES[pen.ramp_side]
        blocked |= pen_wall_cells(pen) | ramp_cells(pen)
        to_foot = grid_distance(blocked, at, (pen.row - i, pen.column - j))
        assert to_foot is not None
        at, moves = (pen.row + 3 * i, pen.column + 3 * j), to_foot + 4
    for kind in ("green", "yellow"):
        if kind in REWARDS[puzzle.task]:
            way = grid_distance(blocked, at, cells[kind])
            if way is None:
                return None
            at, moves = cells[kind], moves + way
            path.append((REWARDS[puzzle.task][kind], moves))
    return path


def grid_success(task: Task, puzzles: tuple[Puzzle, ...]) -> tuple[float, float, float, int]:
    """A-Success of the shortest paths, with all goals and with the first alone; its mean action; puzzles without path.

    A puzzle without a path scores 0.
    """
    paths = [path for path in map(grid_path, puzzles) if path is not None]

    def score(k: int) -> float:
        return 1 - math.log(k) / math.log(step_budget(task) + 1)

    everything = sum(worth * score(k) for path in paths for worth, k in path) / len(puzzles)
    first = sum(score(path[0][1]) for path in paths) / len(puzzles)
    return everything, first, float(np.mean([path[0][1] for path in paths])), len(puzzles) - len(paths)


def rows(task: Task, split: Split) -> list[str]:
    puzzles = puzzles_of(task, split)
    grid, grid_first, moves, missing = grid_success(task, puzzles)
    episodes = replay(task, puzzles, [witness.actions for witness in witnesses_of(task, split)])
    oracle = summarise(episodes)
    to_first = float(np.mean((episodes.rewards > 0).argmax(axis=1) + 1))
    return [
        f"{task} {split}",
        f"{oracle['a_success']:.3f} ± {oracle['a_success_half_width_95']:.3f}",
        f"{to_first:.1f}, {oracle['mean_steps']:.1f}",
        f"{grid:.3f}",
        f"{grid_first:.3f} ({moves:.1f})",
        f"{missing}",
        f"{ORIGINALS_GRID[task]:.3f}" if task in ORIGINALS_GRID else "–",
        f"{PAPERS_HUMANS[task]:.3f}",
    ]


def main() -> None:
    first = ("set", "oracle (95%)", "its actions: first goal, all", "grid", "grid, first goal (actions)", "no path")
    table = Table(*first, "original's grid, first goal", "paper's humans")
    for split in SPLITS:
        for task in TASKS:
            table.add_row(*rows(task, split))
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
