"""The picture of a world: still scenery cast once a layout, moving objects every frame."""

import functools

import mujoco
import numpy as np

from gym_open.envs import constants as c
from gym_open.envs import model as m
from gym_open.envs.puzzles import GOALS, SIDES, Puzzle
from gym_open.envs.raycast import Camera, Picture, Shapes, empty_picture, observation_camera, paint, rotations

_SPHERES = np.array([m.kind_of(name) in ("agent", "yellow", "green") for name in m.INVENTORY])


class Scene:
    """Draws one world's table; keeps its buffers from frame to frame."""

    def __init__(self) -> None:
        n = len(m.INVENTORY)
        self._camera = _camera()
        self._still = empty_picture()
        self._picture = empty_picture()
        self._shapes = Shapes(
            np.zeros((n, 3)),
            np.zeros((n, 3, 3)),
            np.full((n, 3), c.RADIUS),
            np.zeros(n, bool),
            np.zeros((n, 3)),
            np.zeros(n, np.int32),
        )
        self._quaternions = np.zeros((n, 4))
        self._present = np.zeros(0, np.int64)
        self._recoloured: list[tuple[int, str]] = []

    def load(self, puzzle: Puzzle, present: np.ndarray, *, recolour_hits: bool) -> None:
        """Cast what stands still in this puzzle, and note which of the inventory moves."""
        _copy(_table_picture(), self._still)
        pieces = _pieces(puzzle)
        paint(pieces, len(pieces.label), self._camera, self._still)
        self._present = present.nonzero()[0]
        names = [m.INVENTORY[i] for i in self._present]
        self._recoloured = [(i, name) for i, name in enumerate(names) if recolour_hits and m.kind_of(name) in GOALS]
        n = len(self._present)
        self._shapes.sphere[:n] = _SPHERES[self._present]
        self._shapes.label[:n] = _labels()[self._present]
        self._shapes.colour[:n] = _colours()[self._present]

    def picture(self, qpos: np.ndarray, hit: set[str]) -> Picture:
        """The picture (reused by the next call) of the objects at `qpos`, with these goals hit."""
        n = len(self._present)
        poses = qpos.reshape(-1, 7)[self._present]
        self._shapes.position[:n] = poses[:, :3]
        self._quaternions[:n] = poses[:, 3:]
        rotations(self._quaternions[:n], self._shapes.rotation)
        for slot, name in self._recoloured:
            self._shapes.colour[slot] = (c.HIT_COLOUR if name in hit else c.COLOUR)[m.kind_of(name)]
        _copy(self._still, self._picture)
        paint(self._shapes, n, self._camera, self._picture)
        return self._picture


def _copy(source: Picture, target: Picture) -> None:
    for have, put in zip(source, target, strict=True):
        put[...] = have


@functools.cache
def _camera() -> Camera:
    return observation_camera()


@functools.cache
def _labels() -> np.ndarray:
    return np.array([m.fixed_model().geom(name).id for name in m.INVENTORY], np.int32)


@functools.cache
def _colours() -> np.ndarray:
    return np.array([c.COLOUR[m.kind_of(name)] for name in m.INVENTORY], float)


@functools.cache
def _table_picture() -> Picture:
    """What is the same in every puzzle."""
    model = m.fixed_model()
    geoms = [i for i in range(model.ngeom) if model.geom_bodyid[i] == 0 and model.geom_group[i] == 0]
    picture = empty_picture()
    shapes = _boxes(geoms, np.zeros(3), np.eye(3))
    paint(shapes, len(shapes.label), _camera(), picture)
    return picture


def _pieces(puzzle: Puzzle) -> Shapes:
    """Pen, ramp and patch of a puzzle as boxes in the world's frame."""
    model = m.fixed_model()
    parts: list[Shapes] = []
    for name, piece in (("pen", puzzle.pen), ("ramp", puzzle.pen), ("patch", puzzle.patch)):
        if piece is None:
            continue
        turn = np.eye(3)
        if name == "ramp" and puzzle.pen is not None:
            i, j = SIDES[puzzle.pen.ramp_side]
            turn = np.array([[j, i, 0], [-i, j, 0], [0, 0, 1]], float)
        body = model.body(name).id
        geoms = [i for i in range(model.ngeom) if model.geom_bodyid[i] == body]
        parts.append(_boxes(geoms, np.array([*c.cell_centre(piece.row, piece.column), 0.0]), turn))
    if not parts:
        return _boxes([], np.zeros(3), np.eye(3))
    return Shapes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _boxes(geoms: list[int], place: np.ndarray, turn: np.ndarray) -> Shapes:
    """Box geoms of a body that stands at `place`, turned by `turn`, in the colours that the model gives them."""
    model = m.fixed_model()
    n = len(geoms)
    rotation = np.zeros((n, 3, 3))
    flat = np.zeros(9)
    for row, geom in enumerate(geoms):
        mujoco.mju_quat2Mat(flat, model.geom_quat[geom])
        rotation[row] = turn @ flat.reshape(3, 3)
    position = place + model.geom_pos[geoms].reshape(n, 3) @ turn.T
    colour = np.round(model.geom_rgba[geoms, :3].reshape(n, 3).astype(float) * 255)
    size = model.geom_size[geoms].reshape(n, 3)
    return Shapes(position, rotation, size, np.zeros(n, bool), colour, np.array(geoms, np.int32))
