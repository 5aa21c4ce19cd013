"""What moves on the table: objects, the agent's trail and push, what touched what."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import SPHERES, kind_of
from gym_open.terminal import printable
from gym_open.viz.play.columns import SKY, VERMILION, times

HALF_SIZES: dict[str, tuple[float, float, float]] = {
    **dict.fromkeys(c.CAPACITY, (c.RADIUS, c.RADIUS, c.RADIUS)),
    "rectangle": (c.RECTANGLE_LENGTH / 2, c.RADIUS, c.RADIUS),
}
"""Of each kind's box or ball; a cone is shown as the box around it."""
PARKED_Y = -15.0
"""An object beyond this y is not on the table: the model parks unused ones 30 m behind the camera."""
MOVE_M = 0.12
"""Length of the arrow of a move along one axis."""
_TRAIL_POINTS = 50
"""Of a trail, about: it is written anew for every step that is shown."""
M_PER_NS = 0.006
"""Length of a contact's arrow for one newton second: a push from rest, 25 N s, is shown as 15 cm."""


def log_styles(rec: rr.RecordingStream, entity: str) -> None:
    """Log how trail, moves and contacts look under `entity`, the table's."""
    rec.log(f"{entity}/trail", rr.LineStrips3D.from_fields(radii=0.006, colors=c.COLOUR["agent"]), static=True)
    rec.log(f"{entity}/move", rr.Arrows3D.from_fields(radii=0.012, colors=(255, 255, 255)), static=True)
    rec.log(f"{entity}/contacts", rr.Arrows3D.from_fields(radii=0.01, show_labels=False), static=True)


def log_objects(
    rec: rr.RecordingStream, entity: str, names: Sequence[str], states: np.ndarray, steps: np.ndarray, *, begins: bool
) -> None:
    """Log where objects are, an entity a kind.

    Args:
        rec: the recording.
        entity: the table's.
        names: of all objects.
        states: (n, objects, 13) at these steps, of one world: what is parked is so in all of them.
        steps: (n,) numbers of the steps of the stream.
        begins: whether the world is shown from here on, so that sizes, colours and names are logged at the first step.
    """
    at, moved = times(steps), states.astype(np.float32)
    for kind, half_size in HALF_SIZES.items():
        there = [i for i, name in enumerate(names) if kind_of(name) == kind and states[0, i, 1] > PARKED_Y]
        archetype = rr.Ellipsoids3D if kind in SPHERES else rr.Boxes3D
        moving = archetype.columns(
            centers=moved[:, there, :3].reshape(-1, 3),
            quaternions=moved[:, there, 3:7][..., [1, 2, 3, 0]].reshape(-1, 4),  # Rerun wants x, y, z, w
        )
        rec.send_columns(f"{entity}/{kind}", at, moving.partition([len(there)] * len(steps)))
        if begins:
            fixed = archetype.columns(
                half_sizes=np.tile(np.array(half_size, np.float32), (len(there), 1)),
                colors=[c.COLOUR[kind]] * len(there),
                labels=[printable(names[i]) for i in there],
                fill_mode=[rr.components.FillMode.Solid] * len(there),
                show_labels=[False] * len(there),
            )
            rec.send_columns(f"{entity}/{kind}", times(steps[:1]), fixed.partition([len(there)]))


class Trail:
    """The agent's path over its last steps in this world, thinned or not: a line of its own at each step shown.

    Of one line a step, and not of a point a step and a range of time that is shown, which would hold the world before.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._every = steps, math.ceil(steps / _TRAIL_POINTS)
        self._past = np.empty((0, 3), np.float32)

    def log(
        self, rec: rr.RecordingStream, entity: str, agent: np.ndarray, first_step: int, numbers: np.ndarray,
        *, begins: bool,
    ) -> None:  # fmt: skip
        """Log the trail of a span, which goes on from the one before unless it `begins`.

        Args:
            rec: the recording.
            entity: the table's.
            agent: (T + 1, 3) where it was.
            first_step: number of the span's first step.
            numbers: of 0…T, those shown.
            begins: whether the world is shown from here on.
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
    """Log the push that the agent gives itself at each step, as an arrow from where it is.

    Args:
        rec: the recording.
        entity: the table's.
        agent: (n, 3) where it is before the action.
        actions: (n,) numbers of `envs.constants.MOVES`.
        steps: (n,) numbers of the steps.
    """
    moves = np.pad(np.array(c.MOVES)[actions], ((0, 0), (0, 1)))
    rec.send_columns(f"{entity}/move", times(steps), rr.Arrows3D.columns(origins=agent, vectors=MOVE_M * moves))


def log_contacts(
    rec: rr.RecordingStream, entity: str, contacts: Sequence[Sequence[Contact]], steps: np.ndarray
) -> None:
    """Log what touched what in each step: an arrow along the normal, `M_PER_NS` metres a newton second long.

    Those of the agent have a colour of their own. Names and impulse are shown where the mouse is.
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
