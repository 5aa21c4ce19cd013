"""The table in 3D: top and walls, scenery of the current world, objects, the agent's trail and moves, and contacts.

Lengths are in metres, as in `envs.constants`.
"""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import SPHERES, kind_of
from gym_open.envs.puzzles import SIDES, Puzzle
from gym_open.terminal import printable
from gym_open.viz.view import SKY, VERMILION, times

_FLAT = 0.002
_RIM = 0.25
"""Metres of ground around the table. Rerun places its camera by the size of the scene, and would cut off the table's
corners without this margin."""
HALF_SIZES: dict[str, tuple[float, float, float]] = {
    **dict.fromkeys(c.CAPACITY, (c.RADIUS, c.RADIUS, c.RADIUS)),
    "rectangle": (c.RECTANGLE_LENGTH / 2, c.RADIUS, c.RADIUS),
}
"""Half sizes of each kind's box or ball; a cone is shown as its bounding box."""
PARKED_Y = -15.0
"""An object with a lower y is not on the table: the model parks unused objects 30 m behind the camera."""
MOVE_M = 0.12
"""Length in metres of the arrow of a move along one axis."""
_TRAIL_POINTS = 50
"""Approximate number of points of a trail, which is written again for every shown step."""
M_PER_NS = 0.006
"""Length of a contact's arrow per newton second: a push from rest, 25 N s, is 15 cm long."""


def log_table(rec: rr.RecordingStream, entity: str) -> None:
    """Log the table's top and walls, which are the same in all worlds, under `entity`."""
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
    """Log pen, ramp and patch of `puzzle` from the time `at` on; a missing one clears that of the previous world."""
    _boxes(rec, f"{entity}/patch", _patch(puzzle), c.SCENERY_COLOUR["patch"], at)
    _boxes(rec, f"{entity}/pen", _pen(puzzle), c.SCENERY_COLOUR["pen"], at)
    _boxes(rec, f"{entity}/ramp", _ramp(puzzle), c.SCENERY_COLOUR["ramp"], at)


def _boxes(
    rec: rr.RecordingStream, entity: str, boxes: list[np.ndarray], colour: tuple[int, int, int], at: list[rr.TimeColumn]
) -> None:
    """Log boxes, each (2, 3): centre and half sizes."""
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
    """The ramp as a box, which shows its place but not its slope."""
    if puzzle.pen is None:
        return []
    x, y = c.cell_centre(puzzle.pen.row, puzzle.pen.column)
    row, column = SIDES[puzzle.pen.ramp_side]
    toward = np.array([column, -row, 0.0])  # rows go towards −y
    middle, half = (c.RAMP_FOOT + c.PEN_HALF) / 2, (c.PEN_HALF - c.RAMP_FOOT) / 2
    centre = np.array([x, y, 0.0]) + middle * toward + np.array([0, 0, c.RAMP_HEIGHT / 4])
    across = np.array([abs(row), abs(column), 0]) * c.RAMP_WIDTH / 2
    return [np.array([centre, half * np.abs(toward) + across + np.array([0, 0, c.RAMP_HEIGHT / 4])])]


def log_styles(rec: rr.RecordingStream, entity: str) -> None:
    """Log the style of trail, moves and contacts under the table's `entity`."""
    rec.log(f"{entity}/trail", rr.LineStrips3D.from_fields(radii=0.006, colors=c.COLOUR["agent"]), static=True)
    rec.log(f"{entity}/move", rr.Arrows3D.from_fields(radii=0.012, colors=(255, 255, 255)), static=True)
    rec.log(f"{entity}/contacts", rr.Arrows3D.from_fields(radii=0.01, show_labels=False), static=True)


def log_objects(
    rec: rr.RecordingStream, entity: str, names: Sequence[str], states: np.ndarray, steps: np.ndarray, *, begins: bool
) -> None:
    """Log the positions of objects, with one entity per kind.

    Args:
        rec: the recording.
        entity: entity of the table.
        names: names of all objects.
        states: states of one world at these steps, (n, objects, 13); an object is parked in all of them or in none.
        steps: numbers of the steps in the stream, (n,).
        begins: whether the world is shown from here on; if so, sizes, colours and names are logged at the first step.
    """
    at, moved = times(steps), states.astype(np.float32)
    for kind, half_size in HALF_SIZES.items():
        present = [i for i, name in enumerate(names) if kind_of(name) == kind and states[0, i, 1] > PARKED_Y]
        archetype = rr.Ellipsoids3D if kind in SPHERES else rr.Boxes3D
        moving = archetype.columns(
            centers=moved[:, present, :3].reshape(-1, 3),
            quaternions=moved[:, present, 3:7][..., [1, 2, 3, 0]].reshape(-1, 4),  # Rerun's order is x, y, z, w
        )
        rec.send_columns(f"{entity}/{kind}", at, moving.partition([len(present)] * len(steps)))
        if begins:
            fixed = archetype.columns(
                half_sizes=np.tile(np.array(half_size, np.float32), (len(present), 1)),
                colors=[c.COLOUR[kind]] * len(present),
                labels=[printable(names[i]) for i in present],
                fill_mode=[rr.components.FillMode.Solid] * len(present),
                show_labels=[False] * len(present),
            )
            rec.send_columns(f"{entity}/{kind}", times(steps[:1]), fixed.partition([len(present)]))


class Trail:
    """The agent's path over its last steps in the current segment, as a separate line at each shown step.

    Rerun could instead show one point per step over a range of time, but that would include the previous segment.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._every = steps, math.ceil(steps / _TRAIL_POINTS)
        self._past = np.empty((0, 3), np.float32)

    def log(
        self, rec: rr.RecordingStream, entity: str, agent: np.ndarray, first_step: int, numbers: np.ndarray,
        *, begins: bool,
    ) -> None:  # fmt: skip
        """Log the trail of a span; it continues the trail of the previous span unless the segment `begins`.

        Args:
            rec: the recording.
            entity: entity of the table.
            agent: positions of the agent, (T + 1, 3).
            first_step: number of the span's first step.
            numbers: numbers (0…T) of the shown steps.
            begins: whether this is the first shown span of its segment.
        """
        past = agent[:0] if begins else self._past
        path = np.concatenate([past, agent])
        start = first_step - len(past)
        strips: list[np.ndarray] = []
        for here in (len(past) + numbers).tolist():
            oldest = max(0, here - self._steps)
            between = [i for i in range(oldest + 1, here) if (start + i) % self._every == 0]
            strips.append(path[[oldest, *between, here]].astype(np.float32))
        if strips:
            rec.send_columns(f"{entity}/trail", times(first_step + numbers), rr.LineStrips3D.columns(strips=strips))
        self._past = path[:-1][-self._steps :]


def log_moves(rec: rr.RecordingStream, entity: str, agent: np.ndarray, actions: np.ndarray, steps: np.ndarray) -> None:
    """Log the agent's push at each step as an arrow that starts at the agent.

    Args:
        rec: the recording.
        entity: entity of the table.
        agent: positions of the agent before the action, (n, 3).
        actions: indices into `envs.constants.MOVES`, (n,).
        steps: numbers of the steps, (n,).
    """
    moves = np.pad(np.array(c.MOVES)[actions], ((0, 0), (0, 1)))
    rec.send_columns(f"{entity}/move", times(steps), rr.Arrows3D.columns(origins=agent, vectors=MOVE_M * moves))


def log_contacts(
    rec: rr.RecordingStream, entity: str, contacts: Sequence[Sequence[Contact]], steps: np.ndarray
) -> None:
    """Log the contacts of each step as arrows along the normal, `M_PER_NS` metres long per newton second.

    The agent's contacts have another colour. Rerun shows the names and the impulse of the contact under the mouse.
    """
    flat = [contact for found in contacts for contact in found]
    impulses = np.array([contact.impulse for contact in flat], np.float32).reshape(-1, 1)
    arrows = rr.Arrows3D.columns(
        origins=np.array([contact.position for contact in flat], np.float32).reshape(-1, 3),
        vectors=M_PER_NS * impulses * np.array([contact.normal for contact in flat], np.float32).reshape(-1, 3),
        colors=[VERMILION if "agent" in (contact.a, contact.b) else SKY for contact in flat],
        labels=[printable(f"{contact.a} → {contact.b}: {contact.impulse:.3g} N s") for contact in flat],
    )
    rec.send_columns(f"{entity}/contacts", times(steps), arrows.partition([len(found) for found in contacts]))
