"""Play many actions in one world in one compiled call, so that threads that play worlds do not wait for one another."""

from typing import NamedTuple

import numpy as np
from numba.np.numpy_support import carray

from gym_open.envs import constants as c
from gym_open.envs.jit import compiled
from gym_open.envs.observation.scene import Drawing, draw
from gym_open.envs.physics.native import pointer
from gym_open.envs.physics.stepper import StepConstants, read_states, simulate
from gym_open.envs.world import World
from gym_open.errors import UsageError


class Recording(NamedTuple):
    """What happened during T actions."""

    states: np.ndarray
    """(T, N, 13) float64: `World.object_state` after each action."""
    contacts: np.ndarray
    """(T, 2) int64: pairs in contact during each action, and those of them with the agent."""
    impulses: np.ndarray
    """(T,) float64: the contacts' impulses, summed (N s)."""
    images: np.ndarray
    """(T, height, width, 3) uint8: the observation after each action; (0, …) if none were drawn."""


def record(world: World, actions: np.ndarray, *, images: bool = True) -> Recording:
    """Take `actions` (T,) in a loaded world, exactly as `World.step` does, and return what happened.

    Args:
        world: the world, which is left as the last action leaves it.
        actions: integers from 0 to 8.
        images: whether to draw the observations. Drawing takes a third of the time.

    Raises:
        UsageError: if an action is not one of 0–8.
        PuzzleError: if no puzzle was loaded.
    """
    taken = np.asarray(actions, dtype=np.int64)
    if taken.size and not 0 <= taken.min() <= taken.max() < c.N_ACTIONS:
        raise UsageError(f"actions: expected 0 to {c.N_ACTIONS - 1}, got {taken.min()} to {taken.max()}")
    _ = world.puzzle
    count, size = len(taken), world.options.image_size
    made = Recording(
        np.empty((count, len(world.inventory), 13)),
        np.empty((count, 2), np.int64),
        np.empty(count),
        np.empty((count if images else 0, size, size, 3), np.uint8),
    )
    pushes = c.MOVE_SPEED * np.array(c.MOVES, float)
    constants, substeps = world.stepper.constants, world.options.substeps
    _record(*world.stepper.place, taken, pushes, substeps, constants, world.drawing, made)
    return made


@compiled
def _record(  # noqa: PLR0917  # compiled code takes arguments by position
    boards: np.ndarray,
    index: int,
    actions: np.ndarray,
    pushes: np.ndarray,
    substeps: int,
    constants: StepConstants,
    drawing: Drawing,
    made: Recording,
) -> None:
    board = boards[index]
    poses = carray(pointer(board.qpos), 7 * len(board.states), np.float64)
    for t in range(len(actions)):
        action = actions[t]
        moves = action > 0  # during action 0 no time passes
        simulate(boards, index, pushes[action, 0], pushes[action, 1], substeps if moves else 0, moves, constants)
        read_states(boards, index, constants)
        made.states[t] = board.states
        touches = board.counts[0]
        with_agent, impulse = 0, 0.0
        for slot in range(touches):
            impulse += board.sums[slot, 0]
            if board.pairs[slot, 0] == constants.agent or board.pairs[slot, 1] == constants.agent:
                with_agent += 1
        made.contacts[t, 0], made.contacts[t, 1], made.impulses[t] = touches, with_agent, impulse
        if len(made.images):
            draw(poses, board.hit, drawing, False)
            made.images[t] = drawing.image.rgb
