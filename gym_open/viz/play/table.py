"""The table: top and walls for good; pen, ramp and danger patch of the world in view. Metres, as `envs.constants`."""

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.envs.puzzles import SIDES, Puzzle

_FLAT = 0.002
_RIM = 0.25
"""Metres of ground that are shown around the table. Rerun puts its camera by the size of what there is to see, and
would cut the table's corners off without it."""


def log_table(rec: rr.RecordingStream, entity: str) -> None:
    """Log the table's top and walls, which no puzzle changes, under `entity`."""
    rec.log(entity, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    ground = rr.Boxes3D(
        centers=[0, 0, -4 * _FLAT],
        half_sizes=[c.WALL_X + _RIM, c.WALL_Y + _RIM, _FLAT],
        colors=c.SCENERY_COLOUR["floor"],
        fill_mode="solid",
    )
    rec.log(f"{entity}/ground", ground, static=True)
    top = rr.Boxes3D(
        centers=[0, 0, -_FLAT],
        half_sizes=[c.WALL_X, c.WALL_Y, _FLAT],
        colors=c.SCENERY_COLOUR["table"],
        fill_mode="solid",
    )
    rec.log(f"{entity}/top", top, static=True)
    x, y, half = c.WALL_X + c.WALL_THICKNESS / 2, c.WALL_Y + c.WALL_THICKNESS / 2, c.WALL_THICKNESS / 2
    walls = rr.Boxes3D(
        centers=[
            [x, 0, c.WALL_HEIGHT / 2],
            [-x, 0, c.WALL_HEIGHT / 2],
            [0, y, c.WALL_HEIGHT / 2],
            [0, -y, c.WALL_HEIGHT / 2],
        ],
        half_sizes=[[half, y, c.WALL_HEIGHT / 2]] * 2 + [[x, half, c.WALL_HEIGHT / 2]] * 2,
        colors=c.SCENERY_COLOUR["wall"],
        fill_mode="majorwireframe",
    )
    rec.log(f"{entity}/walls", walls, static=True)


def log_scenery(rec: rr.RecordingStream, entity: str, puzzle: Puzzle, at: list[rr.TimeColumn]) -> None:
    """Log pen, ramp and patch of `puzzle` from the time `at` on; none clears what the world before had."""
    _boxes(rec, f"{entity}/patch", _patch(puzzle), c.SCENERY_COLOUR["patch"], at)
    _boxes(rec, f"{entity}/pen", _pen(puzzle), c.SCENERY_COLOUR["pen"], at)
    _boxes(rec, f"{entity}/ramp", _ramp(puzzle), c.SCENERY_COLOUR["ramp"], at)


def _boxes(
    rec: rr.RecordingStream, entity: str, boxes: list[np.ndarray], colour: tuple[int, int, int], at: list[rr.TimeColumn]
) -> None:
    """Each of `boxes` is (2, 3): centre and half sizes."""
    values = np.array(boxes, dtype=np.float32).reshape(-1, 2, 3)
    columns = rr.Boxes3D.columns(
        centers=values[:, 0],
        half_sizes=values[:, 1],
        colors=[colour] * len(values),
        fill_mode=[rr.components.FillMode.Solid] * len(values),
    )
    rec.send_columns(entity, at, columns.partition([len(values)]))


def _patch(puzzle: Puzzle) -> list[np.ndarray]:
    if puzzle.patch is None:
        return []
    x, y = c.cell_centre(puzzle.patch.row, puzzle.patch.column)
    return [np.array([[x, y, _FLAT], [c.PATCH_HALF, c.PATCH_HALF, _FLAT]])]


def _pen(puzzle: Puzzle) -> list[np.ndarray]:
    if puzzle.pen is None:
        return []
    x, y = c.cell_centre(puzzle.pen.row, puzzle.pen.column)
    far, thin, high = c.PEN_HALF, c.PEN_WALL_THICKNESS / 2, c.RAMP_HEIGHT / 2
    along_x, along_y = [far + thin, thin, high], [thin, far - thin, high]
    return [
        np.array([[x, y + far, high], along_x]),
        np.array([[x, y - far, high], along_x]),
        np.array([[x + far, y, high], along_y]),
        np.array([[x - far, y, high], along_y]),
    ]


def _ramp(puzzle: Puzzle) -> list[np.ndarray]:
    """The ramp's outline as a box: where it lies, not its slope."""
    if puzzle.pen is None:
        return []
    x, y = c.cell_centre(puzzle.pen.row, puzzle.pen.column)
    row, column = SIDES[puzzle.pen.ramp_side]
    toward = np.array([column, -row, 0.0])  # rows go towards −y
    middle, half = (c.RAMP_FOOT + c.PEN_HALF) / 2, (c.PEN_HALF - c.RAMP_FOOT) / 2
    centre = np.array([x, y, 0.0]) + middle * toward + np.array([0, 0, c.RAMP_HEIGHT / 4])
    across = np.array([abs(row), abs(column), 0]) * c.RAMP_WIDTH / 2
    return [np.array([centre, half * np.abs(toward) + across + np.array([0, 0, c.RAMP_HEIGHT / 4])])]
