"""Compare the ray caster with closed forms, and with brute force over all pixels."""

import os
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numba
import numpy as np
import pytest
from numba.core import config as numba_config

from gym_open.envs import constants as c
from gym_open.envs import jit
from gym_open.envs.observation.raycast import BOX, SPHERE, Camera, Shapes, Triangles, empty_image, paint
from gym_open.envs.observation.scene import Parts, model_camera, place_parts
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.model import build_model
from gym_open.envs.puzzles import SIDES, Patch, Pen, Placement, Puzzle, arranged
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.world import World

NO_TRIANGLES = Triangles(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 4)))


def observation_camera() -> Camera:
    return model_camera(build_model(WorldOptions()), c.IMAGE_SIZE)


def on_screen(point: np.ndarray) -> np.ndarray:
    """Image coordinates (x, y) in pixels of a point in space, by the plain pinhole formula."""
    camera = observation_camera()
    across, up, ahead = camera.axes @ (point - camera.position)
    half = np.tan(np.deg2rad(30)) * ahead
    return np.array([(1 + across / half) * c.IMAGE_SIZE / 2, (1 - up / half) * c.IMAGE_SIZE / 2])


def centre_of(mask: np.ndarray) -> np.ndarray:
    return np.argwhere(mask).mean(axis=0)[::-1] + 0.5


def test_camera_axes_are_the_originals() -> None:
    right, up, forward = c.camera_axes()
    np.testing.assert_allclose(np.cross(right, up), -forward, atol=1e-12)  # right-handed, looking along −z
    yaw, pitch = np.deg2rad(25.489), np.deg2rad(43.376)
    expected = np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), -np.sin(pitch)
    np.testing.assert_allclose(forward, expected, atol=1e-12)
    assert right[2] == pytest.approx(np.sin(np.deg2rad(1.481)) * np.cos(pitch), abs=1e-12)


def test_every_cell_of_the_table_is_in_the_image() -> None:
    for row in range(c.ROWS):
        for column in range(c.COLUMNS):
            point = on_screen(np.array([*c.cell_centre(row, column), c.RADIUS]))
            assert (point > 1).all()
            assert (point < c.IMAGE_SIZE - 1).all()


@pytest.mark.parametrize("cell", [(1, 1), (1, 7), (8, 4), (14, 1), (14, 7)])
def test_objects_are_seen_where_they_are(cell: tuple[int, int]) -> None:
    world = World()
    away = (5, 2) if cell != (5, 2) else (6, 6)
    for kind in ("yellow", "green", "heavy", "light"):
        world.load(Puzzle("sandbox", arranged([Placement("agent", *away), Placement(kind, *cell)])))
        name = f"{kind}_0"
        seen = world.segmentation() == world.model.geom(name).id
        assert 4 <= seen.sum() <= 60
        point = np.array([*c.cell_centre(*cell), c.RADIUS])
        assert np.abs(centre_of(seen) - on_screen(point)).max() < 1
        # It has its own colour, with a brightness between the ambient light only and both lights.
        pixels = world.observe()[seen].astype(float) / np.array(c.COLOUR[kind])
        assert (pixels.max(axis=0) <= c.LIGHT_AMBIENT + c.LIGHT_DIFFUSE + 0.05).all()
        assert (pixels.min(axis=0) >= c.LIGHT_AMBIENT - 0.05).all()


def random_shapes(rng: np.random.Generator, count: int) -> Shapes:
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    turns = np.empty((count, 9))
    for turn, q in zip(turns, quaternion, strict=True):
        mujoco.mju_quat2Mat(turn, q)
    position = rng.uniform([-0.6, -1, 0], [0.6, 1, 0.3], (count, 3))
    sphere = rng.random(count) < 0.5
    size = np.where(sphere[:, None], rng.uniform(0.03, 0.2, (count, 1)), rng.uniform(0.02, 0.3, (count, 3)))
    form = np.where(sphere, SPHERE, BOX).astype(np.int8)
    colour = rng.uniform(0, 255, (count, 3))
    return Shapes(
        position,
        turns.reshape(-1, 3, 3),
        size,
        form,
        np.zeros((count, 2), np.int32),
        colour,
        np.arange(count, dtype=np.int32),
    )


def brute_depth(shapes: Shapes, i: int) -> np.ndarray:
    """Depth of one shape at every pixel, by NumPy formulas that are independent of the ray caster."""
    camera = observation_camera()
    rays = camera.rays
    start = camera.position - shapes.position[i]
    if shapes.form[i] == SPHERE:
        a, b = (rays**2).sum(-1), 2 * rays @ start
        under = b**2 - 4 * a * (start @ start - shapes.size[i, 0] ** 2)
        with np.errstate(invalid="ignore"):
            return np.where(under > 0, (-b - np.sqrt(under)) / (2 * a), np.inf)
    local_start, local_rays = shapes.rotation[i].T @ start, rays @ shapes.rotation[i]
    depth = np.full(rays.shape[:2], np.inf)
    for axis in range(3):
        for side in (-1, 1):  # intersections of rays with each face's plane that are on the face
            t = (side * shapes.size[i, axis] - local_start[axis]) / local_rays[..., axis]
            others = [k for k in range(3) if k != axis]
            crossing = local_start + t[..., None] * local_rays
            on_face = (np.abs(crossing[..., others]) <= shapes.size[i, others] + 1e-12).all(-1) & (t > 0)
            depth = np.where(on_face, np.minimum(depth, t), depth)
    return depth


@pytest.mark.parametrize("seed", range(4))
def test_rectangles_cut_nothing_off(seed: int) -> None:
    shapes = random_shapes(np.random.default_rng(seed), 12)
    image = empty_image(c.IMAGE_SIZE)
    paint(shapes, NO_TRIANGLES, observation_camera(), image)
    depths = np.array([brute_depth(shapes, i) for i in range(12)])
    np.testing.assert_allclose(image.depth, depths.min(axis=0), rtol=1e-9)
    labels = np.where(np.isinf(depths.min(axis=0)), -1, depths.argmin(axis=0))
    assert (image.label == labels).mean() > 0.9999
    assert not image.rgb[image.label == -1].any()


def test_parts_are_placed_as_mujoco_places_them() -> None:
    """A part's pose on its carrier is like a geom's pose on its body."""
    rng = np.random.default_rng(0)
    poses, places = rng.normal(size=(2, 20, 7))
    for each in (poses, places):
        each[:, 3:] /= np.linalg.norm(each[:, 3:], axis=1, keepdims=True)
    shapes = random_shapes(rng, 20)
    carrier = rng.permutation(20)
    place_parts(poses.ravel(), Parts(carrier, places, np.zeros((20, 2, 3))), shapes)
    position, quaternion, turn = np.empty(3), np.empty(4), np.empty(9)
    for i, place in enumerate(places):
        body = poses[carrier[i]]
        mujoco.mju_mulPose(position, quaternion, body[:3], body[3:], place[:3], place[3:])
        mujoco.mju_quat2Mat(turn, quaternion)
        np.testing.assert_allclose(shapes.position[i], position, atol=1e-12)
        np.testing.assert_allclose(shapes.rotation[i], turn.reshape(3, 3), atol=1e-12)


def test_shading_is_lamberts() -> None:
    shapes = Shapes(
        np.zeros((1, 3)),
        np.eye(3)[None],
        np.full((1, 3), 0.2),
        np.full(1, BOX, np.int8),
        np.zeros((1, 2), np.int32),
        np.full((1, 3), 200.0),
        np.zeros(1, np.int32),
    )
    image = empty_image(c.IMAGE_SIZE)
    paint(shapes, NO_TRIANGLES, observation_camera(), image)
    light = -np.array(c.LIGHT_DIRECTION) / np.linalg.norm(c.LIGHT_DIRECTION)
    facing = (light[2], -light[1], -light[0])  # top, front and left side, which this camera sees
    expected = sorted(round(200 * (c.LIGHT_AMBIENT + c.LIGHT_DIFFUSE * max(cosine, 0.0))) for cosine in facing)
    np.testing.assert_allclose(np.unique(image.rgb[image.label == 0]), expected, atol=1)


def test_hit_goals_change_colour_only_on_request() -> None:
    puzzle = Puzzle("sandbox", arranged([Placement("agent", 8, 3), Placement("yellow", 8, 4)]))
    world = World()
    for recolour in (True, False):
        world.load(puzzle, recolour_hits=recolour)
        assert world.step(1).hits == ("yellow_0",)
        pixels = world.observe()[world.segmentation() == world.model.geom("yellow_0").id]
        red, blue = pixels[:, 0].mean(), pixels[:, 2].mean()
        assert (blue > red) == recolour
        # In a restored state from before the touch, the goal is yellow.
        before = World()
        before.load(puzzle)
        world.restore_state(before.save_state())
        np.testing.assert_array_equal(world.observe(), before.observe())


def test_out_is_filled_and_returned() -> None:
    world = World()
    world.load(fixed_puzzles("tool-use")[0])
    out = np.zeros((84, 84, 3), np.uint8)
    assert world.observe(out) is out
    np.testing.assert_array_equal(out, world.observe())
    assert world.observe() is not world.observe()


def test_patch_pen_and_ramp_are_seen() -> None:
    world = World()
    cell = c.cell_centre(8, 4)
    for side, (i, j) in SIDES.items():
        world.load(Puzzle("sandbox", arranged([Placement("agent", 8 - i, 4 - j)]), pen=Pen(8, 4, side), patch=None))
        seen = world.segmentation()
        assert all((seen == world.model.geom(f"pen_{name}").id).sum() > 20 for name in SIDES)
        platform = seen == world.model.geom("ramp_platform").id
        towards = on_screen(np.array([cell[0] + 0.225 * j, cell[1] - 0.225 * i, c.RAMP_HEIGHT]))
        assert np.abs(centre_of(platform) - towards).max() < 2
    world.load(Puzzle("sandbox", arranged([Placement("agent", 1, 1)]), patch=Patch(8, 4)))
    seen = world.segmentation() == world.model.geom("patch").id
    assert np.abs(centre_of(seen) - on_screen(np.array([*cell, 0]))).max() < 1
    assert (world.observe()[seen].mean(axis=0).argsort() == [2, 1, 0]).all()  # orange


def next_number(x: int) -> int:
    return x + 1


def test_without_a_cache_folder_it_still_compiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[object] = []
    real: Any = numba.njit

    def refusing(**options: Any) -> Any:
        calls.append(options)
        if len(calls) == 1:
            raise RuntimeError("cannot cache function: no locator available")
        return real(**options)

    monkeypatch.setattr(numba, "njit", refusing)
    monkeypatch.setattr(numba_config, "CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert jit.compiled(next_number)(2) == 3
    (own,) = tmp_path.iterdir()
    assert own.stat().st_mode & 0o077 == 0  # files from it are executed
    assert list(own.rglob("*.nbc"))


def test_a_folder_that_others_can_write_to_is_not_read_from(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real: Any = numba.njit

    def refusing(**options: Any) -> Any:
        if options["cache"]:
            raise RuntimeError("cannot cache function: no locator available")
        return real(**options)

    monkeypatch.setattr(numba, "njit", refusing)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = tmp_path / f"gym-open-numba-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    assert jit.compiled(next_number)(2) == 3
    assert not list(folder.iterdir())
