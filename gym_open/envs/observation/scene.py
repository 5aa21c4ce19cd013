"""Draw a world from its compiled model: static shapes once per puzzle, moving shapes once per image.

The model determines the whole look: the geoms of MuJoCo's visible groups (0–2), their sizes and colours, the camera
named `observation`, and the directional light.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.jit import compiled
from gym_open.envs.observation.raycast import (
    BOX,
    MESH,
    SPHERE,
    Camera,
    Image,
    Shapes,
    Triangles,
    empty_image,
    paint,
    square_camera,
)
from gym_open.envs.physics.model import kind_of

_GEOM = mujoco.mjtGeom
_FORMS = {int(_GEOM.mjGEOM_SPHERE): SPHERE, int(_GEOM.mjGEOM_BOX): BOX, int(_GEOM.mjGEOM_MESH): MESH}
_UNSEEN_GROUP = 3
_SMOOTH = 0.8
"""Cosine between a triangle's normal and the mesh's normal at its corner, above which the mesh is smooth there."""
_STILL_POSE = np.array([0, 0, 0, 1, 0, 0, 0], float)


class Parts(NamedTuple):
    """Geoms, each fixed to a moving body (its carrier), one per row."""

    carrier: np.ndarray
    """(n,) row of the carrier in the array of poses (position and quaternion: 7 numbers each)."""
    place: np.ndarray
    """(n, 7): pose in the carrier's frame."""
    colour: np.ndarray
    """(n, 2, 3): 0–255, before and after the carrier was hit."""


class Drawing(NamedTuple):
    """All data needed to draw an image, as one argument of compiled code."""

    parts: Parts
    shapes: Shapes
    triangles: Triangles
    camera: Camera
    still: Image
    image: Image


@compiled
def place_parts(poses: np.ndarray, parts: Parts, shapes: Shapes) -> None:
    """Set position and rotation of the shapes of all parts; `poses` is a flat array."""
    for i in range(parts.carrier.shape[0]):
        k = 7 * parts.carrier[i]
        x, y, z = parts.place[i, 0], parts.place[i, 1], parts.place[i, 2]
        a, b, c, d = poses[k + 3], poses[k + 4], poses[k + 5], poses[k + 6]
        p, q, r, s = parts.place[i, 3], parts.place[i, 4], parts.place[i, 5], parts.place[i, 6]
        position, turn = shapes.position[i], shapes.rotation[i]
        _set_rotation(a, b, c, d, turn)
        for j in range(3):
            position[j] = poses[k + j] + (turn[j, 0] * x + turn[j, 1] * y + turn[j, 2] * z)
        _set_rotation(
            a * p - b * q - c * r - d * s,
            a * q + b * p + c * s - d * r,
            a * r - b * s + c * p + d * q,
            a * s + b * r - c * q + d * p,
            turn,
        )


@compiled
def _set_rotation(w: float, x: float, y: float, z: float, out: np.ndarray) -> None:
    """The rotation matrix (3, 3) of a unit quaternion."""
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def _copy(source: np.ndarray, target: np.ndarray) -> None:
    have, put = source.reshape(-1), target.reshape(-1)
    for i in range(have.size):  # four times as fast as numba's own copy
        put[i] = have[i]


@compiled
def draw(qpos: np.ndarray, hit: np.ndarray, drawing: Drawing, normals: bool) -> None:
    """Draw the objects at `qpos` into the drawing's image.

    Args:
        qpos: (7 · n_objects,).
        hit: (n_objects,) bool: whether each object was hit.
        drawing: the shapes and the image.
        normals: whether to compute all normals; if False, only those of objects are valid.
    """
    parts, shapes, still, image = drawing.parts, drawing.shapes, drawing.still, drawing.image
    place_parts(qpos, parts, shapes)
    for i in range(parts.carrier.shape[0]):
        state = 1 if hit[parts.carrier[i]] else 0
        for k in range(3):
            shapes.colour[i, k] = parts.colour[i, state, k]
    _copy(still.rgb, image.rgb)
    _copy(still.depth, image.depth)
    _copy(still.label, image.label)
    if normals:
        _copy(still.normal, image.normal)
    paint(shapes, drawing.triangles, drawing.camera, image)


class Scene:
    """Draws one world; it reuses its buffers for all images."""

    def __init__(self, model: mujoco.MjModel, image_size: int) -> None:
        self._model = model
        self._camera = model_camera(model, image_size)
        self._triangles, self._mesh_range = _triangles(model)
        seen = [i for i in range(model.ngeom) if model.geom_group[i] < _UNSEEN_GROUP and model.geom_rgba[i, 3] > 0]
        # A body welded to the world never moves; a mocap body moves only at a load; all others have a free joint.
        body = model.geom_bodyid
        movers = [i for i in seen if model.body_dofnum[body[i]]]
        self._pieces = [i for i in seen if model.body_mocapid[body[i]] >= 0]
        self._table = empty_image(image_size)
        fixed = [i for i in seen if i not in movers and i not in self._pieces]
        self._cast(fixed, np.zeros(len(fixed), np.int64), _STILL_POSE, self._table)
        self._still = empty_image(image_size)
        self._picture = empty_image(image_size)
        self._objects = np.array([self._object_of(i) for i in movers], np.int64)
        self._parts_of_objects, self._shapes_of_objects = self._parts(movers, self._objects), self._shapes(movers)
        for row, geom in enumerate(movers):
            colour = self._parts_of_objects.colour[row]
            colour[1] = c.HIT_COLOUR.get(kind_of(model.body(body[geom]).name), colour[0])
        self._drawing = self._drawing_of(np.zeros(0, np.int64), recolour_hits=False)

    def load(self, data: mujoco.MjData, present: np.ndarray, *, recolour_hits: bool) -> None:
        """Draw the static shapes of this puzzle, and select the objects that move.

        Args:
            data: MuJoCo data; a mocap body at its position in the model is parked, and is not drawn.
            present: (n_objects,) bool: whether each object is on the table.
            recolour_hits: whether touched goals turn their hit colour.
        """
        for have, put in zip(self._table, self._still, strict=True):
            put[...] = have
        body, mocap = self._model.geom_bodyid, self._model.body_mocapid
        placed = [i for i in self._pieces if (data.mocap_pos[mocap[body[i]]] != self._model.body_pos[body[i]]).any()]
        poses = np.concatenate([data.mocap_pos, data.mocap_quat], axis=1).ravel()
        self._cast(placed, mocap[body[placed]].astype(np.int64), poses, self._still)
        self._drawing = self._drawing_of(present[self._objects].nonzero()[0], recolour_hits=recolour_hits)

    @property
    def drawing(self) -> Drawing:
        """The argument of `draw`; valid until the next `load`."""
        return self._drawing

    def image(self, qpos: np.ndarray, hit: np.ndarray, *, normals: bool = False) -> Image:
        """Draw the objects at `qpos`; the next call overwrites the image.

        Args:
            qpos: (7 · n_objects,).
            hit: (n_objects,) bool: whether each goal was hit.
            normals: whether to compute all normals; if False, do not use them.
        """
        draw(qpos, hit, self._drawing, normals)
        return self._picture

    def shown_colours(self, hit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Geoms (n,) of moving objects, and their colours (n, 3), 0–255; `hit` (n_objects,): whether each was hit."""
        parts, shapes = self._drawing.parts, self._drawing.shapes
        return shapes.label.copy(), parts.colour[np.arange(len(shapes.label)), hit[parts.carrier].astype(int)]

    def _object_of(self, geom: int) -> int:
        joint = self._model.body_jntadr[self._model.geom_bodyid[geom]]
        return int(self._model.jnt_qposadr[joint]) // 7

    def _drawing_of(self, rows: np.ndarray, *, recolour_hits: bool) -> Drawing:
        parts = Parts(*(array[rows] for array in self._parts_of_objects))
        if not recolour_hits:
            parts.colour[:, 1] = parts.colour[:, 0]
        shapes = Shapes(*(array[rows] for array in self._shapes_of_objects))
        return Drawing(parts, shapes, self._triangles, self._camera, self._still, self._picture)

    def _cast(self, geoms: list[int], carrier: np.ndarray, poses: np.ndarray, image: Image) -> None:
        shapes = self._shapes(geoms)
        place_parts(poses, self._parts(geoms, carrier), shapes)
        paint(shapes, self._triangles, self._camera, image)

    def _parts(self, geoms: list[int], carrier: np.ndarray) -> Parts:
        place = np.concatenate([self._model.geom_pos[geoms], self._model.geom_quat[geoms]], axis=1)
        colour = np.repeat(self._colours(geoms)[:, None], 2, axis=1)
        return Parts(carrier, place, colour)

    def _shapes(self, geoms: list[int]) -> Shapes:
        n, model = len(geoms), self._model
        form = np.array([_FORMS[model.geom_type[i]] for i in geoms], np.int8)
        ranges = [self._mesh_range.get(model.geom_dataid[i], (0, 0)) for i in geoms]
        size = np.where(form[:, None] == BOX, model.geom_size[geoms], model.geom_rbound[geoms, None])
        return Shapes(
            np.zeros((n, 3)),
            np.zeros((n, 3, 3)),
            size.reshape(n, 3),
            form,
            np.array(ranges, np.int32).reshape(n, 2),
            self._colours(geoms),
            np.array(geoms, np.int32),
        )

    def _colours(self, geoms: list[int]) -> np.ndarray:
        return np.round(self._model.geom_rgba[geoms, :3].astype(float) * 255)


def model_camera(model: mujoco.MjModel, image_size: int) -> Camera:
    """The model's camera `observation`, with the model's light."""
    index = model.camera("observation").id
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.cam_quat[index])
    right, up, back = axes.reshape(3, 3).T
    strength = model.light_diffuse[0, 0], model.light_ambient[0, 0]
    light = np.array([*-model.light_dir[0], *strength], float)
    return square_camera(
        model.cam_pos[index].copy(), np.array([right, up, -back]), float(model.cam_fovy[index]), image_size, light
    )


def _triangles(model: mujoco.MjModel) -> tuple[Triangles, dict[int, tuple[int, int]]]:
    """The triangles of all meshes, and the range (first, past-last) of each mesh."""
    corners, normals, ranges, count = [np.zeros((0, 3, 3))], [np.zeros((0, 3, 3))], {}, 0
    for mesh in range(model.nmesh):
        first, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        faces = slice(first, first + number)
        corner = model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[faces]].astype(float)
        corners.append(corner)
        smooth = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces]].astype(float)
        normals.append(_creased(corner, smooth))
        ranges[mesh] = (count, count + number)
        count += number
    corner = np.concatenate(corners)
    plane = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    plane = np.concatenate([plane, (plane * corner[:, 0]).sum(axis=1, keepdims=True)], axis=1)
    return Triangles(corner, np.concatenate(normals), plane), ranges


def _creased(corner: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Normals (T, 3, 3) at triangles' corners, as MuJoCo draws: smooth ones, but the triangle's own at an edge."""
    flat = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    flat = np.broadcast_to(flat[:, None], smooth.shape)
    return np.where((flat * smooth).sum(axis=2, keepdims=True) > _SMOOTH, smooth, flat)
