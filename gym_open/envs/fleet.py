"""Step and draw several worlds of one model in one compiled call, so that threads do not wait for one another.

Compiled code has a fixed number of arguments, and each array is one argument. It cannot take the arrays of any number
of worlds. So each world's `Drawing` is passed as a record of its arrays' addresses, and compiled code rebuilds it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.np.numpy_support import carray

from gym_open.envs import constants as c
from gym_open.envs.jit import compiled
from gym_open.envs.observation.raycast import Camera, Image, Shapes, Triangles
from gym_open.envs.observation.scene import Drawing, Parts, draw
from gym_open.envs.physics.native import address, pointer
from gym_open.envs.physics.stepper import StepConstants, read_states, simulate
from gym_open.envs.world import World

_IMAGES = ("still", "image")
_ARRAYS = (
    *Parts._fields,
    *(f"shape_{name}" for name in Shapes._fields),
    *(f"{image}_{name}" for image in _IMAGES for name in Image._fields),
)
_ADDRESSES = np.dtype([("parts", np.int64), *((name, np.int64) for name in _ARRAYS)])
"""The number of parts, and the addresses of all arrays of a `Drawing`."""


@compiled
def step_and_draw(  # noqa: PLR0917  # compiled code takes arguments by position
    boards: np.ndarray,
    addresses: np.ndarray,
    first: int,
    last: int,
    actions: np.ndarray,
    pushes: np.ndarray,
    substeps: int,
    constants: StepConstants,
    triangles: Triangles,
    camera: Camera,
    images: np.ndarray,
) -> None:
    """Step worlds `first` to `last` − 1, and draw them; worlds with a negative action are left out.

    Args:
        boards: boards of all worlds.
        addresses: addresses of the drawings of all worlds.
        first: index of the first world.
        last: index after the last world.
        actions: (worlds,) int64.
        pushes: (actions, 2): change of the agent's velocity in m/s.
        substeps: number of substeps of each action, except action 0, during which no time passes.
        constants: constants of the worlds' model.
        triangles: triangles of the model's meshes.
        camera: the model's camera.
        images: (worlds, height, width, 3) uint8, overwritten.
    """
    for i in range(first, last):
        action = actions[i]
        if action < 0:
            continue
        simulate(boards, i, pushes[action, 0], pushes[action, 1], substeps if action > 0 else 0, action > 0, constants)
        read_states(boards, i, constants)
        board, drawing = boards[i], _drawing(addresses[i], triangles, camera)
        poses = carray(pointer(board.qpos), 7 * len(board.states), np.float64)
        draw(poses, board.hit, drawing, False)
        have, put = drawing.image.rgb.reshape(-1), images[i].reshape(-1)
        for k in range(have.size):
            put[k] = have[k]


@compiled
def _drawing(arrays: Any, triangles: Triangles, camera: Camera) -> Drawing:
    n, size = arrays.parts, camera.rays.shape[0]
    parts = Parts(
        carray(pointer(arrays.carrier), n, np.int64),
        carray(pointer(arrays.place), (n, 7), np.float64),
        carray(pointer(arrays.colour), (n, 2, 3), np.float64),
    )
    shapes = Shapes(
        carray(pointer(arrays.shape_position), (n, 3), np.float64),
        carray(pointer(arrays.shape_rotation), (n, 3, 3), np.float64),
        carray(pointer(arrays.shape_size), (n, 3), np.float64),
        carray(pointer(arrays.shape_form), n, np.int8),
        carray(pointer(arrays.shape_mesh), (n, 2), np.int32),
        carray(pointer(arrays.shape_colour), (n, 3), np.float64),
        carray(pointer(arrays.shape_label), n, np.int32),
    )
    still = Image(
        carray(pointer(arrays.still_rgb), (size, size, 3), np.uint8),
        carray(pointer(arrays.still_depth), (size, size), np.float64),
        carray(pointer(arrays.still_label), (size, size), np.int32),
        carray(pointer(arrays.still_normal), (size, size, 3), np.float32),
    )
    image = Image(
        carray(pointer(arrays.image_rgb), (size, size, 3), np.uint8),
        carray(pointer(arrays.image_depth), (size, size), np.float64),
        carray(pointer(arrays.image_label), (size, size), np.int32),
        carray(pointer(arrays.image_normal), (size, size, 3), np.float32),
    )
    return Drawing(parts, shapes, triangles, camera, still, image)


class Fleet:
    """Worlds with equal options, with their boards in one array.

    Attributes:
        boards: boards of the worlds; `boards["states"]`, (worlds, N, 13), holds each `object_state`.
    """

    def __init__(self, worlds: Sequence[World]) -> None:
        self._worlds = tuple(worlds)
        self.boards = np.array([world.stepper.board for world in worlds])
        for index, world in enumerate(worlds):
            world.stepper.move(self.boards, index)
        self._addresses = np.zeros(len(worlds), _ADDRESSES)
        self._drawings: list[Drawing | None] = [None] * len(worlds)  # kept alive while their addresses are used
        one = worlds[0]
        self._common = one.options.substeps, one.stepper.constants, one.drawing.triangles, one.drawing.camera
        self._pushes = c.MOVE_SPEED * np.array(c.MOVES, float)

    def step(self, first: int, last: int, actions: np.ndarray, images: np.ndarray) -> None:
        """Step worlds `first` to `last` − 1 by their `actions` (worlds,) int64; negative actions are left out.

        Their observations are written to `images` (worlds, height, width, 3). Other threads may step other worlds at
        the same time.
        """
        for i in range(first, last):
            drawing = self._worlds[i].drawing
            if drawing is not self._drawings[i]:  # the world was loaded
                arrays = *drawing.parts, *drawing.shapes, *drawing.still, *drawing.image
                self._addresses[i] = len(drawing.parts.carrier), *(address(array) for array in arrays)
                self._drawings[i] = drawing
        step_and_draw(self.boards, self._addresses, first, last, actions, self._pushes, *self._common, images)
