"""The user's meshes: read them, cut them into convex pieces, and lay them down at rest.

In collisions, MuJoCo replaces a mesh by its convex hull, which fills the hole of a ring and the notch of an L. So the
shape is cut into convex pieces (CoACD, with a fixed seed). The pieces collide; the mesh itself is visible.
"""

import functools
import io
from pathlib import Path
from typing import Any, NamedTuple

import coacd
import mujoco
import numpy as np
import trimesh

from gym_open.envs import constants as c
from gym_open.envs.options import LARGEST_SIZE, SMALLEST_SIZE, Colour, MeshObject
from gym_open.envs.physics.mjcf import text
from gym_open.errors import GymOpenError

FORMATS = ("obj", "stl", "ply", "glb")
MOST_FACES = 20_000
_GREY: Colour = (160, 160, 160)


class MeshError(GymOpenError):
    """A user's mesh is missing or unreadable, or does not fit the table."""


class MeshShape(NamedTuple):
    """A mesh at rest, ready for the model: in metres, z up, with the middle of its bounding box at the origin."""

    vertices: np.ndarray
    """(V, 3)."""
    faces: np.ndarray
    """(F, 3) int: corners, counter-clockwise when viewed from outside."""
    pieces: tuple[np.ndarray, ...]
    """Corners (P, 3) of each convex piece."""
    shares: tuple[float, ...]
    """Each piece's share of the mass."""
    extents: np.ndarray
    """(3,) edges of the bounding box of all pieces."""
    colour: Colour
    """Main colour in the file."""


def mesh_shape(mesh: MeshObject) -> MeshShape:
    """The shape of a mesh object. A process computes it once per file content and scale.

    Raises:
        MeshError: if the file is missing or not a closed mesh, has too many faces, or does not fit a cell.
    """
    path = Path(mesh.file)
    kind = path.suffix.lstrip(".").lower()
    if kind not in FORMATS:
        raise MeshError(f"mesh {mesh.name!r}: {path}: expected a file named .{', .'.join(FORMATS)}")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MeshError(f"mesh {mesh.name!r}: {path}: cannot be read ({error.strerror}); correct `file`") from None
    try:
        return _shape(kind, content, mesh.scale)
    except MeshError as error:
        raise MeshError(f"mesh {mesh.name!r}: {path}: {error}") from None


@functools.lru_cache(maxsize=32)
def _shape(kind: str, content: bytes, scale: float) -> MeshShape:
    mesh, colour = _read(kind, content)
    vertices, faces = mesh.vertices * scale, mesh.faces
    _check_size(np.ptp(vertices, axis=0), scale)
    convex = _convex_pieces(mesh, vertices)
    turn = _turn_at_rest([piece.vertices for piece in convex])
    pieces = [piece.vertices @ turn.T for piece in convex]
    low, high = np.min(np.vstack(pieces), axis=0), np.max(np.vstack(pieces), axis=0)
    _check_size(high - low, scale)
    middle, volumes = (low + high) / 2, np.array([piece.volume for piece in convex])
    return MeshShape(
        vertices=vertices @ turn.T - middle,
        faces=faces,
        pieces=tuple(points - middle for points in pieces),
        shares=tuple((volumes / volumes.sum()).tolist()),
        extents=high - low,
        colour=colour,
    )


def _read(kind: str, content: bytes) -> tuple[trimesh.Trimesh, Colour]:
    """Read a closed mesh, z up, and its main colour."""
    try:
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
        placed = [scene.graph[node] for node in sorted(scene.graph.nodes_geometry)]
        parts = [(scene.geometry[name], turn) for turn, name in placed]
    except Exception as error:  # each format's reader raises other errors
        raise MeshError(f"not a {kind.upper()} mesh ({error})") from None
    parts = [(part, turn) for part, turn in parts if isinstance(part, trimesh.Trimesh)]
    if sum(len(part.faces) for part, _ in parts) < 4 or not all(np.isfinite(part.vertices).all() for part, _ in parts):
        raise MeshError(f"not a {kind.upper()} mesh of at least four faces; export triangles")
    mesh = _joined(parts)
    if len(mesh.faces) > MOST_FACES:
        raise MeshError(f"{len(mesh.faces)} faces, at most {MOST_FACES} can be drawn; simplify it")
    if kind == "glb":  # in glTF, y points up
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise MeshError("not watertight, or its faces have inconsistent directions; close it in a mesh editor")
    if mesh.volume < 0:
        mesh.invert()
    return mesh, _main_colour(parts[0][0])


def _joined(parts: list[tuple[trimesh.Trimesh, np.ndarray]]) -> trimesh.Trimesh:
    """Join all parts, and merge corners at equal positions, which many formats repeat for each face."""
    corners, faces, count = [], [], 0
    for part, turn in parts:
        corners.append(trimesh.transform_points(part.vertices, turn))
        faces.append(part.faces + count)
        count += len(part.vertices)
    vertices, number = np.unique(np.vstack(corners), axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, number.reshape(-1)[np.vstack(faces)], process=False)


def _check_size(extents: np.ndarray, scale: float) -> None:
    largest = float(extents.max())
    size = " × ".join(f"{value:.3g}" for value in extents)
    if largest > LARGEST_SIZE:
        fits = 0.99 * scale * LARGEST_SIZE / largest
        raise MeshError(f"{size} m is larger than a cell of {c.PITCH} m; use `scale` {fits:.3g} or less")
    if largest < SMALLEST_SIZE:
        fits = 1.01 * scale * SMALLEST_SIZE / largest
        raise MeshError(f"{size} m is smaller than {SMALLEST_SIZE} m; use `scale` {fits:.3g} or more")


def _convex_pieces(mesh: trimesh.Trimesh, vertices: np.ndarray) -> list[trimesh.Trimesh]:
    """Cut the mesh into convex pieces."""
    coacd.set_log_level("error")
    shells = [trimesh.Trimesh(vertices, faces) for faces in _shells(mesh)]
    if any(shell.volume <= 0 for shell in shells):  # a shell is a cavity in another shell
        shells = [trimesh.Trimesh(vertices, mesh.faces)]
    cut: list[tuple[np.ndarray, np.ndarray]] = []
    for shell in shells:  # separately: CoACD never ends on overlapping shells
        part = coacd.Mesh(shell.vertices, shell.faces)
        cut += coacd.run_coacd(part, threshold=0.05, max_ch_vertex=64, preprocess_mode="off", seed=0)
    return [trimesh.Trimesh(points, faces) for points, faces in cut]


def _shells(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Faces (F, 3) of each connected part of the mesh."""
    label = np.arange(len(mesh.vertices))
    while True:
        least = label.copy()
        np.minimum.at(least, mesh.faces.ravel(), label[mesh.faces].min(axis=1).repeat(3))
        if (least == label).all():
            return [mesh.faces[label[mesh.faces[:, 0]] == number] for number in np.unique(label[mesh.faces])]
        label = least


def _turn_at_rest(pieces: list[np.ndarray]) -> np.ndarray:
    """Rotation (3, 3) at rest, after the pieces were put on the table in the file's orientation."""
    lowest = min(float(points[:, 2].min()) for points in pieces)
    names = [f"piece_{i}" for i in range(len(pieces))]
    assets = "".join(f'<mesh name="{n}" vertex="{text(p.ravel())}"/>' for n, p in zip(names, pieces, strict=True))
    geoms = "".join(f'<geom type="mesh" mesh="{name}" density="1000"/>' for name in names)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.002" cone="elliptic" integrator="implicitfast"/>'
        '<default><geom condim="6" friction="1 0.01 0.01"/></default>'
        f'<asset>{assets}</asset><worldbody><geom type="plane" size="0 0 1"/>'
        f'<body pos="0 0 {-lowest:.9g}"><freejoint/>{geoms}</body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    for _ in range(5000):
        mujoco.mj_step(model, data)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:])
    return turn.reshape(3, 3)


def _main_colour(mesh: trimesh.Trimesh) -> Colour:
    visual: Any = mesh.visual  # its class depends on the file
    if visual.kind == "texture":
        visual = visual.to_color()
    if not visual.defined:
        return _GREY
    red, green, blue = (int(value) for value in visual.main_color[:3])
    return red, green, blue
