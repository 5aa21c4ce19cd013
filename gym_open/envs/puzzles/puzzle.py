"""The record of a puzzle: a task, and the placement of objects on the table's cells."""

import functools
import hashlib
import re
from collections import Counter
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from gym_open.envs.constants import CAPACITY, COLUMNS, ROWS
from gym_open.errors import GymOpenError

Task = Literal["sandbox", "goal-seeking", "preferences", "avoidance", "tool-use"]
Kind = Literal["agent", "yellow", "green", "heavy", "light", "push", "rectangle", "cone", "stack"]
Side = Literal["north", "east", "south", "west"]
Row = Annotated[int, Meta(ge=0, lt=ROWS)]
Column = Annotated[int, Meta(ge=0, lt=COLUMNS)]
Cell = tuple[int, int]

TASKS: tuple[Task, ...] = ("goal-seeking", "preferences", "avoidance", "tool-use")
"""The four evaluation tasks. The sandbox is not one of them."""
KINDS: tuple[Kind, ...] = get_args(Kind)
"""The built-in kinds. A user's mesh has the kind `mesh:NAME`."""
GOALS: tuple[Kind, ...] = ("yellow", "green")
CUBES: tuple[Kind, ...] = ("heavy", "light", "stack")
STACK_HEIGHT = 2
"""Number of light cubes in a stack."""
CORNERS = frozenset({(0, 0), (0, COLUMNS - 1), (ROWS - 1, 0), (ROWS - 1, COLUMNS - 1)})
"""Cells that the table's corner pieces cover."""
_MESH = re.compile(r"mesh:[A-Za-z0-9][A-Za-z0-9_-]*")
_NEEDS: dict[Task, tuple[Kind, ...]] = {
    "sandbox": (),
    "goal-seeking": ("yellow",),
    "preferences": ("yellow", "green"),
    "avoidance": ("yellow",),
    "tool-use": ("yellow",),
}
SIDES: dict[Side, Cell] = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
"""Step (row, column) towards each side; north is away from the camera."""


_RANK: dict[str, int] = {kind: rank for rank, kind in enumerate(KINDS)}


class PuzzleError(GymOpenError):
    """A puzzle record is malformed or cannot be built, or no layout satisfies a request."""


class Placement(msgspec.Struct, frozen=True, forbid_unknown_fields=True, order=True, omit_defaults=True):
    """One object at the centre of one cell.

    Raises:
        PuzzleError: if the kind is unknown, or an object that is not a rectangle is turned.
    """

    kind: str
    """One of `KINDS`, or `mesh:NAME`."""
    row: Row
    column: Column
    turned: bool = False
    """Only for a rectangle: its long side is along the column (y), not along the row (x)."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS and not _MESH.fullmatch(self.kind):
            known = f"{', '.join(KINDS)}, or 'mesh:' and a name of letters, digits, '-' and '_'"
            raise PuzzleError(f"puzzle: no kind {self.kind!r}; the kinds are {known}")
        if self.turned and self.kind != "rectangle":
            raise PuzzleError(f"puzzle: {self.kind!r} is turned, but only a rectangle can be; leave `turned` out")


class Pen(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A walled room of 3×3 cells around a centre cell; a ramp inside leads to the top of the wall on one side."""

    row: Row
    column: Column
    ramp_side: Side


class Patch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A danger patch of 3×3 cells on the table, around a centre cell."""

    row: Row
    column: Column


class Puzzle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A task and a layout.

    Raises:
        PuzzleError: if objects are unsorted, share a cell, stand in a wall or are more than the model holds, or if a
            piece is partly off the table.
    """

    task: Task
    objects: tuple[Placement, ...]
    pen: Pen | None = None
    patch: Patch | None = None

    def __post_init__(self) -> None:
        _check_types(self)
        check_puzzle(self)

    @property
    def digest(self) -> str:
        """SHA-256 in hex of the layout, without the task: equal layouts have equal digests."""
        return _layout_digest(self.objects, self.pen, self.patch)

    def to_json(self) -> bytes:
        """The puzzle as canonical JSON, without a line end."""
        return msgspec.json.encode(self, order="sorted")

    @classmethod
    def from_json(cls, text: bytes | str) -> "Puzzle":
        """Read the output of `to_json`.

        Raises:
            PuzzleError: if the text is not a puzzle; names the field, the expected value and the found value.
        """
        try:
            return msgspec.json.decode(text, type=cls)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise PuzzleError(f"not a puzzle: {error}; expected the JSON that Puzzle.to_json writes") from None


_FIELDS = tuple[Task, tuple[Placement, ...], Pen | None, Patch | None]


def arranged(objects: list[Placement]) -> tuple[Placement, ...]:
    """The objects in canonical order: by kind (meshes last, by name), then row, then column."""
    return tuple(sorted(objects, key=lambda item: (_RANK.get(item.kind, len(KINDS)), item)))


def footprint(item: Placement) -> set[Cell]:
    """The cells that an object covers: one cell, or three along the long side of a rectangle."""
    i, j = item.row, item.column
    if item.kind != "rectangle":
        return {(i, j)}
    return {(i + k, j) if item.turned else (i, j + k) for k in (-1, 0, 1)}


def bodies_used(objects: tuple[Placement, ...]) -> dict[str, int]:
    """Number of the model's bodies of each kind that the objects use; a stack uses two light cubes."""
    used = Counter(item.kind for item in objects)
    used["light"] += STACK_HEIGHT * used.pop("stack", 0)
    return dict(used)


def block(row: int, column: int, reach: int) -> set[Cell]:
    """The cells within `reach` rows and columns of a cell."""
    span = range(-reach, reach + 1)
    return {(row + i, column + j) for i in span for j in span}


def pen_wall_cells(pen: Pen) -> set[Cell]:
    """The ring of 16 cells under a pen's walls."""
    return block(pen.row, pen.column, 2) - block(pen.row, pen.column, 1)


def ramp_cells(pen: Pen) -> set[Cell]:
    """The two cells under a pen's ramp: the centre, and its neighbour on the ramp's side."""
    i, j = SIDES[pen.ramp_side]
    return {(pen.row, pen.column), (pen.row + i, pen.column + j)}


def check_puzzle(puzzle: Puzzle) -> None:
    """Raise PuzzleError unless the layout can be built and has the objects that its task needs."""
    _check_objects(puzzle)
    _check_pieces(puzzle)


def _check_cells(objects: tuple[Placement, ...]) -> None:
    holder: dict[Cell, str] = {}
    for item in objects:
        name = f"{item.kind!r} at {(item.row, item.column)}"
        for cell in sorted(footprint(item)):
            if not (0 <= cell[0] < ROWS and 0 <= cell[1] < COLUMNS) or cell in CORNERS:
                raise PuzzleError(f"puzzle: {name} is partly off the table, at cell {cell}; move it")
            if cell in holder:
                raise PuzzleError(f"puzzle: two objects on cell {cell}, {holder[cell]} and {name}; move one")
            holder[cell] = name


def _check_types(puzzle: Puzzle) -> None:
    """Check the types and bounds of a puzzle that was built in Python, as JSON decoding does."""
    fields = (puzzle.task, puzzle.objects, puzzle.pen, puzzle.patch)
    try:
        msgspec.convert(msgspec.to_builtins(fields), _FIELDS)
    except (msgspec.ValidationError, TypeError) as error:
        raise PuzzleError(f"puzzle: {error}; in the order task, objects, pen, patch") from None


def _check_objects(puzzle: Puzzle) -> None:
    _check_cells(puzzle.objects)
    for kind, count in bodies_used(puzzle.objects).items():
        if kind in CAPACITY and count > CAPACITY[kind]:
            note = f" (a stack takes {STACK_HEIGHT})" if kind == "light" else ""
            raise PuzzleError(f"puzzle: {count} objects of kind {kind!r}{note}, but the model holds {CAPACITY[kind]}")
    if sum(item.kind == "agent" for item in puzzle.objects) != 1:
        raise PuzzleError("puzzle: expected exactly one object of kind 'agent'")
    for kind in _NEEDS[puzzle.task]:
        if all(item.kind != kind for item in puzzle.objects):
            raise PuzzleError(f"puzzle: task {puzzle.task!r} needs an object of kind {kind!r}")
    if puzzle.objects != arranged(list(puzzle.objects)):
        raise PuzzleError("puzzle: objects are not in canonical order; build them with puzzles.arranged")


def _check_pieces(puzzle: Puzzle) -> None:
    if puzzle.task == "avoidance" and puzzle.patch is None:
        raise PuzzleError("puzzle: task 'avoidance' needs a patch")
    if puzzle.task == "tool-use" and puzzle.pen is None:
        raise PuzzleError("puzzle: task 'tool-use' needs a pen")
    cells = {cell for item in puzzle.objects for cell in footprint(item)}
    for name, piece, reach in (("pen", puzzle.pen, 2), ("patch", puzzle.patch, 1)):
        if piece and not (reach <= piece.row < ROWS - reach and reach <= piece.column < COLUMNS - reach):
            raise PuzzleError(f"puzzle: {name} at cell {(piece.row, piece.column)} is partly off the table; move it")
    if puzzle.pen and (blocked := (pen_wall_cells(puzzle.pen) | ramp_cells(puzzle.pen)) & cells):
        raise PuzzleError(f"puzzle: objects on cells {sorted(blocked)}, where the pen's wall or ramp is; move them")


@functools.lru_cache(maxsize=4096)
def _layout_digest(objects: tuple[Placement, ...], pen: Pen | None, patch: Patch | None) -> str:
    layout = {"objects": objects, "pen": pen, "patch": patch}
    return hashlib.sha256(msgspec.json.encode(layout, order="sorted")).hexdigest()
