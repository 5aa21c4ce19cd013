"""Show a fixed puzzle to a person, and check all fixed puzzles."""

import itertools

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gym_open.envs import puzzles
from gym_open.envs.constants import COLOUR, COLUMNS, ROWS, SCENERY_COLOUR
from gym_open.envs.planner import solves
from gym_open.envs.puzzles import TASKS, Puzzle, PuzzleError
from gym_open.envs.puzzles.sets import (
    SPLITS,
    actual_digests,
    published_digests,
    puzzle_by_id,
    puzzle_id,
    puzzles_of,
    set_name,
)
from gym_open.envs.puzzles.witnesses import witness_name, witness_of, witnesses_of
from gym_open.envs.world import World
from gym_open.terminal import titled_table

ARROWS = "·→↗↑↖←↙↓↘"
"""A symbol for each action, with north up."""
_SIGNS = {
    "agent": "A",
    "yellow": "Y",
    "green": "G",
    "heavy": "H",
    "light": "L",
    "push": "P",
    "rectangle": "R",
    "cone": "C",
    "stack": "S",
}
_RAMP = {"north": "▲", "east": "▶", "south": "▼", "west": "◀"}
_MESH = "M"


def show(name: str) -> RenderableType:
    """Show the fixed puzzle with this id: a map of its cells, its digest and its witness.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
    """
    puzzle, witness = puzzle_by_id(name), witness_of(name)
    facts = Table.grid(padding=(0, 2))
    facts.add_column(no_wrap=True)
    facts.add_column(overflow="fold")
    facts.add_row("puzzle", name)
    facts.add_row("task", puzzle.task)
    facts.add_row("digest", puzzle.digest)
    actions = " ".join(map(str, witness.actions))
    facts.add_row("witness", f"{''.join(ARROWS[a] for a in witness.actions)}  (actions {actions})")
    return Group(cell_map(puzzle), Text(), facts)


def cell_map(puzzle: Puzzle) -> Text:
    """A map of the 16 × 9 cells, north up: one letter per object, # pen, ▲ ramp (points upwards), ░ patch."""
    signs: dict[puzzles.Cell, tuple[str, tuple[int, int, int]]] = {}
    if puzzle.patch:
        for cell in puzzles.block(puzzle.patch.row, puzzle.patch.column, 1):
            signs[cell] = "░", SCENERY_COLOUR["patch"]
    if puzzle.pen:
        signs |= dict.fromkeys(puzzles.pen_wall_cells(puzzle.pen), ("#", SCENERY_COLOUR["pen"]))
        sign = _RAMP[puzzle.pen.ramp_side]
        signs |= dict.fromkeys(puzzles.ramp_cells(puzzle.pen), (sign, SCENERY_COLOUR["ramp"]))
    for item in puzzle.objects:
        colour = COLOUR["light" if item.kind == "stack" else item.kind] if item.kind in _SIGNS else (128, 128, 128)
        signs |= {cell: (_SIGNS.get(item.kind, _MESH), colour) for cell in puzzles.footprint(item)}
    text = Text("    " + " ".join(map(str, range(COLUMNS))), "dim")
    for row in range(ROWS):
        text.append(f"\n{row:2}  ", "dim")
        for column in range(COLUMNS):
            sign, (red, green, blue) = signs.get((row, column), ("·", (128, 128, 128)))
            text.append(sign, f"bold rgb({red},{green},{blue})").append(" ")
    used = [kind for kind in _SIGNS if any(item.kind == kind for item in puzzle.objects)]
    text.append("\n\n    " + ", ".join(f"{_SIGNS[kind]} {kind}" for kind in used), "dim")
    return text


def verify() -> Table:
    """Check that each set is the published file, and that each witness solves its puzzle on this machine.

    Raises:
        PuzzleError: if a check fails; names the file or the puzzles.
    """
    published, actual = published_digests(), actual_digests()
    if wrong := [name for name, digest in published.items() if actual.get(name) != digest]:
        raise PuzzleError(f"puzzles/data/{wrong[0]}: missing, or not as in digests.json; reinstall gym-open")
    columns = ("set", "solved", "puzzles' SHA-256", "witnesses' SHA-256")
    table = titled_table("fixed puzzles", columns, unbroken=columns)
    world = World()
    for task, split in itertools.product(TASKS, SPLITS):
        pairs = list(zip(puzzles_of(task, split), witnesses_of(task, split), strict=True))
        failed = [puzzle_id(task, split, i) for i, (p, w) in enumerate(pairs) if not solves(world, p, w.actions)]
        if failed:
            raise PuzzleError(f"{len(failed)} witnesses fail, the first is {failed[0]}: the physics differs here")
        names = set_name(task, split), witness_name(task, split)
        table.add_row(f"{task} {split}", f"{len(pairs)}/{len(pairs)}", *(published[name][:12] for name in names))
    return table
