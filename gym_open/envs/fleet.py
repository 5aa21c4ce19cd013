"""Several worlds of one model, stepped and drawn in one compiled call, so that threads do not wait for one another.

Compiled code takes each array as an argument of its own, and cannot take those of as many worlds as there happen to be.
So each world's drawing comes as an *arrays*, a record of where its arrays are, and is put together again there.
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
from gym_open.envs.physics.stepper import StepConstants, play, read_states
from gym_open.envs.world import World

_IMAGES = ("still", "image")
_ARRAYS = (
    *Parts._fields,
    *(f"shape_{name}" for name in Shapes._fields),
    *(f"{image}_{name}" for image in _IMAGES for name in Image._fields),
)
_ADDRESSES = np.dtype([("parts", np.int64), *((name, np.int64) for name in _ARRAYS)])
"""How many parts are drawn, and the addresses of the arrays of a `Drawing`."""


@compiled
def play_and_draw(  # noqa: PLR0917  # compiled code takes arguments by position
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
    """Take the actions of worlds `first` to `last` − 1, and draw them; who has a negative action is left out.

    Args:
        boards: of all worlds, as are the addresses.
        addresses: where their drawings are.
        first: index of the first world.
        last: index past the last one.
        actions: (worlds,) int64.
        pushes: (actions, 2): change of the agent's velocity in m/s.
        substeps: of each action but 0, which lets no time pass.
        constants: of the worlds' model, as are the next two.
        triangles: of its meshes.
        camera: its camera.
        images: (worlds, height, width, 3) uint8, to be written.
    """
    for i in range(first, last):
        action = actions[i]
        if action < 0:
            continue
        play(boards, i, pushes[action, 0], pushes[action, 1], substeps if action > 0 else 0, action > 0, constants)
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
    """Worlds with equal options, with their boards side by side.

    Attributes:
        boards: of the worlds; `boards["states"]`, (worlds, N, 13), are their `object_state`.
    """

    def __init__(self, worlds: Sequence[World]) -> None:
        self._worlds = tuple(worlds)
        self.boards = np.array([world.stepper.board for world in worlds])
        for index, world in enumerate(worlds):
            world.stepper.move(self.boards, index)
        self._addresses = np.zeros(len(worlds), _ADDRESSES)
        self._drawings: list[Drawing | None] = [None] * len(worlds)  # kept, as long as their addresses are used
        one = worlds[0]
        self._common = one.options.substeps, one.stepper.constants, one.drawing.triangles, one.drawing.camera
        self._pushes = c.MOVE_SPEED * np.array(c.MOVES, float)

    def play(self, first: int, last: int, actions: np.ndarray, images: np.ndarray) -> None:
        """Take the actions (worlds,) int64 of worlds `first` to `last` − 1; who has a negative one is left out.

        Their pictures are written to `images` (worlds, height, width, 3). Other threads may play others meanwhile.
        """
        for i in range(first, last):
            drawing = self._worlds[i].drawing
            if drawing is not self._drawings[i]:  # the world was loaded
                arrays = *drawing.parts, *drawing.shapes, *drawing.still, *drawing.image
                self._addresses[i] = len(drawing.parts.carrier), *(address(array) for array in arrays)
                self._drawings[i] = drawing
        play_and_draw(self.boards, self._addresses, first, last, actions, self._pushes, *self._common, images)
