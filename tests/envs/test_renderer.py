"""The handsome look: visible and invisible things."""

import ctypes
import os

import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.envs.look import backend, gl
from gym_open.envs.look.renderer import Renderer
from gym_open.envs.options import CameraOptions, ObjectOptions, WorldOptions
from gym_open.envs.physics.model import build_model
from gym_open.envs.puzzles import Pen, Placement, Puzzle, arranged
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.world import World

needs_gl = pytest.mark.skipif(
    backend.find_backend() is None,
    reason="no OpenGL here: on Debian, apt-get install libegl1 libopengl0 libgl1-mesa-dri",
)


def hues(picture: np.ndarray) -> np.ndarray:
    """Each pixel's colour without its brightness, (H, W, 3)."""
    return picture / np.maximum(np.linalg.norm(picture.astype(float), axis=2, keepdims=True), 1.0)


def pixels_of(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(H, W) bool: pixels with this colour, without gloss."""
    wanted = np.array(colour) / np.linalg.norm(colour)
    return (hues(picture) @ wanted > 0.995) & (picture.max(axis=2) > 40)


def grown(mask: np.ndarray) -> np.ndarray:
    """The mask and its neighbouring pixels."""
    return np.any([np.roll(mask, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)


@needs_gl
def test_from_the_observations_camera_both_looks_show_the_same_objects() -> None:
    options = WorldOptions(image_size=256)
    world, rng = World(options), np.random.default_rng(0)
    with Renderer(options, (256, 256), "observation") as renderer:
        for task in ("preferences", "avoidance", "tool-use"):
            world.load(fixed_puzzles(task)[1])
            for action in rng.integers(1, 9, 4):
                world.step(int(action))
            picture, label = renderer.render(world), world.segmentation()
            assert picture.shape == (256, 256, 3)
            assert picture.dtype == np.uint8
            for name in ("agent", "yellow_0"):
                seen = label == world.model.geom(name).id
                there = pixels_of(picture, c.COLOUR[name.split("_")[0]])
                # Gloss is white, and edge pixels are mixed with the background.
                assert (seen & there).sum() > 0.5 * seen.sum(), name
                assert not (there & ~grown(seen)).any(), name


@needs_gl
def test_shadow_gloss_and_cloth_are_there() -> None:
    world = World()
    world.load(Puzzle("sandbox", arranged([Placement("agent", 8, 4)])))
    with Renderer(world.options, (384, 384)) as renderer:
        picture = renderer.render(world).copy()
        table = pixels_of(picture, c.SCENERY_COLOUR["table"])
        assert table.mean() > 0.15
        bright = picture.max(axis=2)[table].astype(float)
        assert bright.std() > 2  # cloth, not one uniform green
        assert (bright < 0.6 * np.median(bright)).sum() > 20  # the agent's and the walls' shadows
        red = picture[pixels_of(picture, c.COLOUR["agent"])]
        assert np.ptp(red.max(axis=1)) > 60  # round and glossy


@needs_gl
def test_a_goal_shows_its_hit_and_parked_things_never() -> None:
    world = World()
    puzzle = Puzzle("sandbox", arranged([Placement("agent", 8, 3), Placement("yellow", 8, 4)]))
    with Renderer(world.options, (256, 256)) as renderer:
        for recolour, colour in ((True, c.HIT_COLOUR["yellow"]), (False, c.COLOUR["yellow"])):
            world.load(puzzle, recolour_hits=recolour)
            before = renderer.render(world).copy()
            assert world.step(1).hits == ("yellow_0",)
            after = renderer.render(world).copy()
            assert pixels_of(before, c.COLOUR["yellow"]).sum() > 20
            assert pixels_of(after, colour).sum() > 20
            assert pixels_of(after, c.COLOUR["yellow"]).any() == (not recolour)
    # A camera in the north points at parked objects behind the table, which are not drawn.
    back = WorldOptions(camera=CameraOptions(position=(0, 2.5, 3.0), direction=(20, 180, 0)))
    world = World(back)
    world.load(puzzle)
    with Renderer(back, (512, 512), "observation") as renderer:
        assert not pixels_of(renderer.render(world), c.COLOUR["heavy"]).any()
    seen = {world.model.geom(int(i)).name for i in np.unique(world.segmentation()) if i >= 0}
    assert not {name for name in seen if name.startswith(("heavy", "pen", "ramp", "lid"))}


@needs_gl
def test_invisible_geoms_are_not_drawn() -> None:
    world = World()
    world.load(Puzzle("sandbox", arranged([Placement("agent", 8, 5)]), pen=Pen(8, 4, "west")))
    unseen = [i for i in range(world.model.ngeom) if world.model.geom_group[i] >= 3]
    assert {"wall_north", "lid"} <= {world.model.geom(i).name for i in unseen}
    with Renderer(world.options, (256, 256)) as renderer:
        # If the tall walls or the lid were drawn, they would hide the agent and the pen from a camera in the south.
        picture = renderer.render(world)
        assert pixels_of(picture, c.COLOUR["agent"]).sum() > 20
        assert pixels_of(picture, c.SCENERY_COLOUR["table"]).mean() > 0.15
        assert pixels_of(picture, c.SCENERY_COLOUR["ramp"]).sum() > 50


@needs_gl
def test_options_and_size_change_the_image_and_not_the_worlds_model() -> None:
    options = WorldOptions(objects={"agent": ObjectOptions(colour=(20, 60, 240))})
    world = World(options)
    world.load(fixed_puzzles("goal-seeking")[0], recolour_hits=True)
    before = world.model.geom_rgba.copy()
    with Renderer(options, (320, 180)) as renderer:
        picture = renderer.render(world)
        assert picture.shape == (180, 320, 3)
        assert pixels_of(picture, (20, 60, 240)).sum() > 10
        assert not pixels_of(picture, c.COLOUR["agent"]).any()
    np.testing.assert_array_equal(world.model.geom_rgba, before)


def test_without_opengl_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(ctypes, "CDLL", missing)
    backend.check_backend()  # MUJOCO_GL is not set: physics needs no OpenGL
    assert backend.find_backend() is None
    with pytest.raises(backend.OpenGLError, match="apt-get install libegl1 libopengl0 libgl1-mesa-dri") as caught:
        gl.open_renderer(build_model(WorldOptions()), 64, 64)
    assert caught.value.exit_code == 1
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(backend.OpenGLError, match=r"MUJOCO_GL asks for 'egl'.*unset MUJOCO_GL"):
        backend.check_backend()


@needs_gl
def test_a_failure_of_opengl_is_an_opengl_error() -> None:
    with pytest.raises(backend.OpenGLError, match="5000×64"):
        gl.open_renderer(build_model(WorldOptions()), 5000, 64)


def test_mujoco_gl_decides_if_it_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "MUJOCO_GL", "osmesa")
    assert backend.find_backend() == "osmesa"
