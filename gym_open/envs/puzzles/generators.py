"""Seeded generators of layouts, after the original's recipes.

Every draw ends: cells are drawn from lists of the cells that are still allowed. If a list is empty, the draw starts
again, a limited number of times.
"""

from collections.abc import Iterable

import numpy as np

from gym_open.config import Config, Count, Fraction, PositiveInt
from gym_open.envs.constants import CAPACITY, COLUMNS, ROWS
from gym_open.envs.puzzles.puzzle import (
    CORNERS,
    CUBES,
    GOALS,
    KINDS,
    SIDES,
    STACK_HEIGHT,
    Cell,
    Column,
    Kind,
    Patch,
    Pen,
    Placement,
    Puzzle,
    PuzzleError,
    Row,
    Side,
    Task,
    arranged,
    block,
    footprint,
    pen_wall_cells,
    ramp_cells,
)
from gym_open.envs.puzzles.sets import reserved_digests

ATTEMPTS = 200
"""Number of layouts tried before a request counts as unsatisfiable."""

INTERIOR = tuple((i, j) for i in range(1, ROWS - 1) for j in range(1, COLUMNS - 1))
"""Cells where objects may be placed: all except the outermost ring."""
CENTRES = tuple((i, j) for i in range(3, 13) for j in range(3, 6))
"""Possible centre cells of pens and danger patches."""
LINES = ((0, 2), (0, 3), (1, 2), (1, 3), (1, 4), (1, 5))
"""For preferences: axis of the line (0: row, 1: column), and possible distances in cells from the agent to a goal."""


COUNTED: tuple[Kind, ...] = tuple(kind for kind in KINDS if kind != "agent")
"""Kinds with a count in a sandbox world."""


class SandboxConfig(Config, frozen=True):
    """The contents of a sandbox world. Each pair is the smallest and the largest count, drawn uniformly."""

    yellow: tuple[Count, Count] = (1, 2)
    """Yellow goal spheres."""
    green: tuple[Count, Count] = (0, 2)
    """Green goal spheres."""
    heavy: tuple[Count, Count] = (1, 5)
    """Heavy cubes."""
    light: tuple[Count, Count] = (1, 5)
    """Light cubes."""
    push: tuple[Count, Count] = (0, 0)
    """Push spheres."""
    rectangle: tuple[Count, Count] = (0, 0)
    """Rectangles, along either axis."""
    cone: tuple[Count, Count] = (0, 0)
    """Cones."""
    stack: tuple[Count, Count] = (0, 0)
    """Stacks of two light cubes. They count against the model's light cubes."""
    meshes: tuple[str, ...] = ()
    """Names of the user's meshes, one object each; the world must have them (`WorldOptions.meshes`)."""
    agent_cell: tuple[Row, Column] | None = None
    """The agent's cell; None means a random cell."""
    yellow_cells: tuple[tuple[Row, Column], ...] = ()
    """Cells of yellow goal spheres; further spheres get random cells."""
    radius: PositiveInt = 3
    """Largest distance in cells from the agent to goal spheres, which are never in its row or column."""
    pen_probability: Fraction = 0.25
    """Share of worlds in which the agent starts in a pen with a ramp."""
    patch_probability: Fraction = 0.25
    """Share of worlds with a danger patch."""

    def counts(self) -> dict[Kind, tuple[int, int]]:
        """Smallest and largest count of each kind, in the order of the draws."""
        return {kind: getattr(self, kind) for kind in COUNTED}


_DEFAULT_SANDBOX = SandboxConfig()


class _NoRoomError(Exception):
    """No allowed cell is left in this draw; another attempt may succeed."""


class _Layout:
    """An unfinished layout: the objects so far, and the cells that are taken."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.objects: list[Placement] = []
        self.cubes: set[Cell] = set()
        self.taken: set[Cell] = set()
        self.pen: Pen | None = None
        self.patch: Patch | None = None

    def free(self, cells: Iterable[Cell] = INTERIOR) -> list[Cell]:
        return [cell for cell in cells if cell not in self.taken]

    def pick(self, cells: list[Cell]) -> Cell:
        if not cells:
            raise _NoRoomError
        return cells[int(self.rng.integers(len(cells)))]

    def place(self, kind: str, cell: Cell, *, turned: bool = False) -> Cell:
        item = Placement(kind, *cell, turned=turned)
        self.objects.append(item)
        self.taken |= footprint(item)
        if kind in CUBES:
            self.cubes.add(cell)
        return cell

    def place_anywhere(self, kind: str) -> None:
        if kind in CUBES:
            self.place_cube(kind)
        elif kind == "rectangle":
            free = set(self.free())
            lying = [Placement(kind, *cell, turned=turned) for cell in INTERIOR for turned in (False, True)]
            fits = [item for item in lying if footprint(item) <= free]
            if not fits:
                raise _NoRoomError
            item = fits[int(self.rng.integers(len(fits)))]
            self.place(kind, (item.row, item.column), turned=item.turned)
        else:
            self.place(kind, self.pick(self.free()))

    def next_to_cubes(self) -> set[Cell]:
        """Cells next to a cube on either axis, where no other cube may stand."""
        return {(i + k, j + l) for i, j in self.cubes for k, l in ((-1, 0), (1, 0), (0, -1), (0, 1))}

    def place_cube(self, kind: str) -> None:
        taken = self.next_to_cubes()
        self.place(kind, self.pick([cell for cell in self.free() if cell not in taken]))

    def place_cubes(self, least: int, most: int) -> None:
        for _ in range(self.rng.integers(least, most + 1)):
            self.place_cube("heavy" if self.rng.random() < 0.5 else "light")

    def place_patch(self) -> None:
        """Place a danger patch on free cells, where no object may be placed afterwards."""
        centres = [cell for cell in CENTRES if self.taken.isdisjoint(block(*cell, 1))]
        self.patch = Patch(*self.pick(centres))
        self.taken |= block(self.patch.row, self.patch.column, 1)

    def place_pen(self, agent: Cell | None = None) -> Cell:
        """Place a pen with its ramp around the agent, and the agent inside it if it has no cell yet.

        The cell behind the ramp, where the agent lands, stays free.
        """
        side = Side.__args__[int(self.rng.integers(4))]
        pens = [pen for pen in pens_around(agent, side) if self.taken.isdisjoint(_kept_free(pen))]
        if not pens:
            raise _NoRoomError
        self.pen = pen = pens[int(self.rng.integers(len(pens)))]
        self.taken |= _kept_free(pen)
        return agent or self.place("agent", self.pick(self.free(sorted(block(pen.row, pen.column, 1)))))

    def puzzle(self, task: Task) -> Puzzle:
        return Puzzle(task=task, objects=arranged(self.objects), pen=self.pen, patch=self.patch)


def pens_around(agent: Cell | None, side: Side) -> list[Pen]:
    """Pens with the ramp on this side that have the agent's cell (None: any) inside, and not under the ramp."""
    pens = [Pen(*centre, side) for centre in CENTRES]
    return [p for p in pens if agent is None or agent in block(p.row, p.column, 1) - ramp_cells(p)]


def _kept_free(pen: Pen) -> set[Cell]:
    i, j = SIDES[pen.ramp_side]
    return pen_wall_cells(pen) | ramp_cells(pen) | {(pen.row + 3 * i, pen.column + 3 * j)}


def _goal_seeking(layout: _Layout) -> None:
    layout.place("agent", layout.pick(layout.free()))
    layout.place("yellow", layout.pick(layout.free()))
    layout.place_cubes(5, 8)


def _preferences(layout: _Layout) -> None:
    """Agent midway between the goals on a row or column; each cell on that line has a heavy cube with probability ½."""
    axis, reach = LINES[int(layout.rng.integers(len(LINES)))]
    step = (0, 1) if axis == 0 else (1, 0)
    line = [(step[0] * k, step[1] * k) for k in range(-reach, reach + 1)]
    (first_i, first_j), (last_i, last_j) = line[0], line[-1]
    fits = [(i, j) for i, j in INTERIOR if {(i + first_i, j + first_j), (i + last_i, j + last_j)} <= set(INTERIOR)]
    agent = layout.pick(fits)
    cells = [(agent[0] + i, agent[1] + j) for i, j in line]
    yellow, green = (cells[0], cells[-1]) if layout.rng.random() < 0.5 else (cells[-1], cells[0])
    layout.place("agent", agent)
    layout.place("yellow", yellow)
    layout.place("green", green)
    for cell in layout.free(cells):
        if layout.rng.random() < 0.5 and cell not in layout.next_to_cubes():
            layout.place("heavy", cell)
    layout.place_cubes(5, 8)


def _avoidance(layout: _Layout) -> None:
    layout.place("agent", layout.pick(layout.free()))
    layout.place("yellow", layout.pick(layout.free()))
    layout.place_patch()
    layout.place_cubes(3, 6)


def _tool_use(layout: _Layout) -> None:
    layout.place_pen()
    assert layout.pen
    layout.taken |= block(layout.pen.row, layout.pen.column, 1)
    layout.place("yellow", layout.pick(layout.free()))
    layout.place_cubes(3, 6)


def _sandbox(layout: _Layout, config: SandboxConfig) -> None:
    rng = layout.rng
    counts = {kind: int(rng.integers(least, most + 1)) for kind, (least, most) in config.counts().items()}
    penned, patched = rng.random() < config.pen_probability, rng.random() < config.patch_probability
    agent = config.agent_cell and layout.place("agent", config.agent_cell)
    for cell in config.yellow_cells:
        layout.place("yellow", cell)
    if penned:
        agent = layout.place_pen(agent)
    agent = agent or layout.place("agent", layout.pick(layout.free()))
    if patched:
        layout.place_patch()
    counts["yellow"] -= len(config.yellow_cells)
    for kind in GOALS:
        for _ in range(counts.pop(kind)):
            near = block(*agent, config.radius)
            near = [cell for cell in layout.free() if cell in near and cell[0] != agent[0] and cell[1] != agent[1]]
            layout.place(kind, layout.pick(near))
    for name in config.meshes:
        layout.place_anywhere(f"mesh:{name}")
    for kind in sorted(counts, key=lambda kind: kind in CUBES):  # cubes come last, because they must not be neighbours
        for _ in range(counts[kind]):
            layout.place_anywhere(kind)


def draw_layout(task: Task, rng: np.random.Generator, sandbox: SandboxConfig = _DEFAULT_SANDBOX) -> Puzzle:
    """Draw a puzzle, perhaps a fixed one. Training uses `sample_puzzle`, which excludes fixed puzzles.

    Raises:
        PuzzleError: if `ATTEMPTS` tries gave no layout, or the configuration is impossible.
    """
    if task == "sandbox":
        _check_sandbox(sandbox)
    for _ in range(ATTEMPTS):
        layout = _Layout(rng)
        try:
            if task == "sandbox":
                _sandbox(layout, sandbox)
            else:
                _RECIPES[task](layout)
        except _NoRoomError:
            continue
        return layout.puzzle(task)
    raise PuzzleError(f"no {task} layout found in {ATTEMPTS} tries for {sandbox}; use fewer objects or a larger radius")


def sample_puzzle(task: Task, rng: np.random.Generator, sandbox: SandboxConfig = _DEFAULT_SANDBOX) -> Puzzle:
    """Draw a training puzzle, which never has a layout of the fixed sets.

    Args:
        task: a task or "sandbox".
        rng: the only source of randomness.
        sandbox: contents of a sandbox world; each task has its own recipe.

    Raises:
        PuzzleError: if the request cannot be satisfied.
    """
    for _ in range(ATTEMPTS):
        puzzle = draw_layout(task, rng, sandbox)
        if puzzle.digest not in reserved_digests():
            return puzzle
    raise PuzzleError(f"{ATTEMPTS} {task} layouts drawn for {sandbox} are all fixed puzzles; allow more variety")


_RECIPES = {
    "goal-seeking": _goal_seeking,
    "preferences": _preferences,
    "avoidance": _avoidance,
    "tool-use": _tool_use,
}


def _check_sandbox(config: SandboxConfig) -> None:
    for kind, (least, most) in config.counts().items():
        if least > most:
            raise PuzzleError(f"sandbox.{kind}: expected smallest ≤ largest, got {(least, most)}; swap them")
        if kind in CAPACITY and most > CAPACITY[kind]:
            raise PuzzleError(f"sandbox.{kind}: at most {CAPACITY[kind]} fit the model, got {most}; use fewer")
    lights = config.light[1] + STACK_HEIGHT * config.stack[1]
    if lights > CAPACITY["light"]:
        asked = f"{config.stack[1]} stacks of {STACK_HEIGHT} and {config.light[1]} more light cubes"
        raise PuzzleError(f"sandbox.stack: {asked}, but the model holds {CAPACITY['light']} light cubes")
    _check_cells(config)


def _check_cells(config: SandboxConfig) -> None:
    agent, yellow = config.agent_cell, config.yellow_cells
    if len(yellow) > config.yellow[0]:
        few = f"{len(yellow)} cells, but the least number of yellow spheres is {config.yellow[0]}"
        raise PuzzleError(f"sandbox.yellow_cells: {few}; give fewer cells")
    cells = [*yellow, agent] if agent else [*yellow]
    for cell in cells:
        if cells.count(cell) > 1:
            raise PuzzleError(f"sandbox.agent_cell and .yellow_cells: two objects on cell {cell}; give each its own")
        if cell in CORNERS:
            raise PuzzleError(f"sandbox: cell {cell} is cut off by the table's corner; choose another")
    if agent and config.pen_probability and not any(pens_around(agent, side) for side in SIDES):
        rows, columns = (sorted({cell[k] for cell in CENTRES}) for k in (0, 1))
        inside = f"rows {rows[0] - 1} to {rows[-1] + 1}, columns {columns[0] - 1} to {columns[-1] + 1}"
        raise PuzzleError(f"sandbox.agent_cell: no pen has cell {agent} inside; choose a cell of {inside}")
