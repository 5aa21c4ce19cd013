"""Compare the ray caster with `mujoco.Renderer` (colour, depth, segmentation) and its normals with geometry."""

import copy
from pathlib import Path
from typing import NamedTuple, Self

import mujoco
import numpy as np
import pytest
import trimesh

from gym_open.envs import constants as c
from gym_open.envs.look.backend import find_backend
from gym_open.envs.look.gl import open_renderer
from gym_open.envs.observation.scene import Scene, model_camera
from gym_open.envs.options import CameraOptions, LightOptions, MeshObject, ObjectOptions, WorldOptions
from gym_open.envs.puzzles import TASKS, Patch, Pen, Placement, Puzzle, arranged
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.world import World

needs_gl = pytest.mark.skipif(
    find_backend() is None, reason="no OpenGL here: on Debian, apt-get install libegl1 libopengl0 libgl1-mesa-dri"
)
EVERYTHING = arranged([
    Placement("agent", 8, 4), Placement("yellow", 3, 2), Placement("green", 6, 6), Placement("heavy", 10, 2),
    Placement("light", 12, 5), Placement("push", 2, 6), Placement("rectangle", 5, 2),
    Placement("rectangle", 11, 6, turned=True), Placement("cone", 9, 6), Placement("cone", 13, 2),
    Placement("stack", 7, 2),
])  # fmt: skip


class Pictures(NamedTuple):
    rgb: np.ndarray
    depth: np.ndarray
    label: np.ndarray


class Reference:
    """Images of a model from `mujoco.Renderer`, without shadow and sky."""

    def __init__(self, model: mujoco.MjModel, size: int) -> None:
        self._model = copy.copy(model)
        self._model.vis.quality.numslices = self._model.vis.quality.numstacks = 48  # rounder spheres
        self._data = mujoco.MjData(self._model)
        self._renderer = open_renderer(self._model, size, size)
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
            self._renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def pictures(self, data: mujoco.MjData) -> Pictures:
        for field in ("qpos", "mocap_pos", "mocap_quat"):
            getattr(self._data, field)[:] = getattr(data, field)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        renderer = self._renderer
        renderer.update_scene(self._data, camera="observation")
        rgb = renderer.render().copy()
        renderer.enable_depth_rendering()
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        label = renderer.render()[..., 0].copy()
        renderer.disable_segmentation_rendering()
        return Pictures(rgb, depth, label)


def compare(model: mujoco.MjModel, theirs: list[Pictures], ours: list[Pictures]) -> None:
    """Compare both: silhouettes may differ by single pixels, and round shapes have facets in OpenGL."""
    a, b = (Pictures(*(np.array(parts) for parts in zip(*each, strict=True))) for each in (ours, theirs))
    same = a.label == b.label
    assert same.mean() > 0.999, f"labels: {same.mean():.5f} the same"
    assert same.mean(axis=(1, 2)).min() > 0.997
    for geom in set(np.unique(b.label)) - {-1}:
        seen = b.label == geom
        if seen.sum() > 50 * len(theirs):
            assert (a.label == geom)[seen].mean() > 0.9, model.geom(geom).name
    colour = np.abs(a.rgb.astype(int) - b.rgb)
    assert colour.mean() < 0.2
    assert np.quantile(colour[same], 0.999) <= 2
    near = same & (b.label >= 0)
    assert np.quantile(np.abs(a.depth - b.depth)[near], 0.999) < 0.001


def ours(world: World) -> Pictures:
    return Pictures(world.observe(), world.depth(), world.segmentation())


@needs_gl
def test_fixed_puzzles_in_play() -> None:
    rng, world = np.random.default_rng(0), World()
    mine, theirs = [], []
    with Reference(world.model, world.options.image_size) as reference:
        for task in TASKS:
            for puzzle in fixed_puzzles(task)[::10]:
                world.load(puzzle)
                for action in rng.integers(1, 9, 8):
                    world.step(int(action))
                mine.append(ours(world))
                theirs.append(reference.pictures(world.data))
    compare(world.model, theirs, mine)


CAMERAS = {
    "from above": CameraOptions(position=(0, 0, 2.1), direction=(90, 0, 0)),
    "low, aslant": CameraOptions(position=(0.9, -1.9, 0.5), direction=(14, -25, -20), field_of_view=75),
    "close": CameraOptions(position=(0.0, -0.5, 0.35), direction=(25, 3, 0), field_of_view=80),
}
LIGHTS = {
    "from above": LightOptions(angle_deg=0, elevation_deg=85),
    "low, aslant": LightOptions(angle_deg=150, elevation_deg=20),
}


@needs_gl
@pytest.mark.parametrize("view", ["as it is", *CAMERAS])
def test_every_kind_of_object_with_other_cameras_and_lights(view: str, tmp_path: Path) -> None:
    options = WorldOptions(
        camera=CAMERAS.get(view, CameraOptions()),
        light=LIGHTS.get(view, LightOptions()),
        objects={
            "heavy": ObjectOptions(size=0.12, colour=(250, 240, 10)),
            "cone": ObjectOptions(colour=(20, 200, 250)),
        },
        meshes=(MeshObject(name="pill", file=str(pill(tmp_path)), colour=(200, 90, 30)),),
        image_size=168,
    )
    world = World(options)
    extra = [Placement("mesh:pill", 4, 5)]
    puzzles = [
        Puzzle("sandbox", arranged([*EVERYTHING, *extra])),
        Puzzle("sandbox", arranged([Placement("agent", 8, 5), *extra]), pen=Pen(8, 4, "west"), patch=Patch(2, 4)),
    ]
    rng, mine, theirs = np.random.default_rng(1), [], []
    with Reference(world.model, world.options.image_size) as reference:
        for puzzle in puzzles:
            world.load(puzzle)
            for _ in range(6):
                mine.append(ours(world))
                theirs.append(reference.pictures(world.data))
                for action in rng.integers(1, 9, 3):
                    world.step(int(action))
    compare(world.model, theirs, mine)
    kinds = {world.model.geom(i).name.rsplit("_", 1)[0] for i in set(np.unique(mine[0].label)) - {-1}}
    if view != "close":
        assert {"agent", "yellow", "heavy", "push", "rectangle", "cone"} <= kinds


def pill(folder: Path) -> Path:
    """A file with a capsule."""
    path = folder / "pill.stl"
    trimesh.creation.capsule(0.05, 0.03, count=(12, 12)).export(path)
    return path


@needs_gl
def test_a_mesh_of_many_triangles_that_hides_parts_of_itself() -> None:
    ring = trimesh.creation.torus(0.5, 0.2, major_sections=100, minor_sections=50)
    vertices, faces = (" ".join(map(str, part.ravel().tolist())) for part in (ring.vertices, ring.faces))
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <visual><headlight active="0"/><quality offsamples="0"/></visual>
          <asset><mesh name="ring" vertex="{vertices}" face="{faces}"/></asset>
          <worldbody>
            <light type="directional" dir="0.3 0.4 -0.8" castshadow="false"
                   diffuse="0.6 0.6 0.6" ambient="0.4 0.4 0.4" specular="0 0 0"/>
            <camera name="observation" pos="0 -2 0.6" xyaxes="1 0 0 0 0.3 1"/>
            <body><freejoint/><geom name="ring" type="mesh" mesh="ring" rgba="0.8 0.3 0.1 1"/></body>
          </worldbody>
        </mujoco>""")
    data, scene = mujoco.MjData(model), Scene(model, 168)
    scene.load(data, np.ones(1, bool), recolour_hits=False)
    with Reference(model, 168) as reference:
        for turn in ((1, 0, 0, 0), (0.8, 0.6, 0, 0), (0.5, 0.5, -0.5, 0.5), (0.7, 0.1, 0.6, 0.3)):
            data.qpos[3:] = np.array(turn) / np.linalg.norm(turn)
            seen = scene.image(data.qpos, np.zeros(1, bool))
            assert (seen.label >= 0).mean() > 0.1
            compare(model, [reference.pictures(data)], [Pictures(seen.rgb, seen.depth, seen.label)])


def test_normals_are_those_of_the_geometry() -> None:
    world = World(WorldOptions(image_size=252))
    world.load(Puzzle("sandbox", EVERYTHING, patch=Patch(3, 5)))
    rng = np.random.default_rng(2)
    for action in rng.integers(1, 9, 5):
        world.step(int(action))
    normals, depth, label = world.normals(), world.depth().astype(float), world.segmentation()
    assert normals.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), label >= 0, atol=1e-5)
    camera = model_camera(world.model, 252)
    points = camera.position + depth[..., None] * camera.rays
    for geom in np.unique(label):
        kind, name = world.model.geom_type[geom], world.model.geom(geom).name
        seen = label == geom
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            centre = world.data.qpos.reshape(-1, 7)[world.inventory.index(name), :3]
            np.testing.assert_allclose(normals[seen], (points[seen] - centre) / c.RADIUS, atol=1e-4)
        elif (flat := seen & _on_plane(depth)).sum() > 20:
            alike = (_square_to(points) * normals).sum(axis=2)[flat]
            # A cone's normals are interpolated over its facets.
            assert alike.min() > (0.95 if name.startswith("cone") else 1 - 1e-3), name


def _on_plane(depth: np.ndarray) -> np.ndarray:
    """Pixels on one plane with their neighbours: there, 1/depth is linear over the image."""
    near, flat = 1 / depth, np.zeros(depth.shape, bool)
    middle = near[1:-1, 1:-1]
    bend = [near[1:-1, 2:] + near[1:-1, :-2] - 2 * middle, near[2:, 1:-1] + near[:-2, 1:-1] - 2 * middle]
    flat[1:-1, 1:-1] = np.abs(bend).max(axis=0) < 2e-6
    return flat


def _square_to(points: np.ndarray) -> np.ndarray:
    """Unit normals, towards the camera, of the surface through the points (H, W, 3) of an image."""
    found = np.zeros_like(points)
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    found[1:-1, 1:-1] = np.cross(down, across)
    return found / np.maximum(np.linalg.norm(found, axis=2, keepdims=True), 1e-12)
