"""The simulator state as a vector, for a policy that sees it instead of images: the upper bound for any encoder."""

from typing import Final

import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles import SIDES, Patch, Pen
from gym_open.envs.world import World

_REACH: Final = 5.0 * c.PITCH
"""Unit of positions in metres: about half of the table."""

STATE_SIZE: Final = 5 * len(INVENTORY) + 2 + 7 + 3
"""Numbers in a state vector."""


def state_vector(world: World) -> np.ndarray:
    """The simulator state, (`STATE_SIZE`,) float32.

    - For each object of the model, in the inventory's order: 1 if the puzzle has it, then x, y, z in units of half a
      table, then 1 if it is a goal that was hit. Zeros if the puzzle does not have it.
    - The agent's velocity (x, y) in m/s.
    - For the pen: 1, its position (x, y), and the side of its ramp as one of four. Zeros if there is no pen.
    - For the danger patch: 1 and its position. Zeros if there is no patch.
    """
    n = len(INVENTORY)
    objects = np.zeros((n, 5), np.float32)
    states = world.object_state()
    objects[:, 0] = 1
    objects[:, 1:4] = states[:, :3] / _REACH
    objects[:, 4] = world.stepper.hit
    objects[~world.present] = 0
    agent = states[INVENTORY.index("agent"), 7:9]
    return np.concatenate([objects.ravel(), agent, _pen(world.puzzle.pen), _patch(world.puzzle.patch)]).astype(
        np.float32
    )


def _pen(pen: Pen | None) -> list[float]:
    if pen is None:
        return [0.0] * 7
    return [1.0, *_place(pen), *(float(pen.ramp_side == side) for side in SIDES)]


def _patch(patch: Patch | None) -> list[float]:
    return [0.0] * 3 if patch is None else [1.0, *_place(patch)]


def _place(piece: Pen | Patch) -> list[float]:
    x, y = c.cell_centre(piece.row, piece.column)
    return [x / _REACH, y / _REACH]
