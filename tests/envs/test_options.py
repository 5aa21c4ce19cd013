"""The effect of each option of a world, compared with its closed form, and options that are refused."""

import numpy as np
import pytest

from gym_open import config
from gym_open.envs import constants as c
from gym_open.envs.options import CameraOptions, LightOptions, MeshObject, ObjectOptions, WorldOptions
from gym_open.envs.physics import model as m
from gym_open.envs.puzzles import Placement, Puzzle, arranged
from gym_open.envs.world import World
from gym_open.errors import ConfigError

EAST = 1


def world_of(kind: str, options: ObjectOptions, *objects: tuple) -> World:
    world = World(WorldOptions(objects={kind: options}))
    world.load(Puzzle("sandbox", arranged([Placement(*item) for item in objects])))
    return world


def place(world: World, name: str) -> np.ndarray:
    return world.data.qpos.reshape(-1, 7)[world.inventory.index(name), :3]


def speed(world: World, name: str) -> np.ndarray:
    return world.data.qvel.reshape(-1, 6)[world.inventory.index(name), :3]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ObjectOptions(mass=0), "object mass: expected 0.1 to 1000, got 0"),
        (lambda: ObjectOptions(mass=float("nan")), "object mass"),
        (lambda: ObjectOptions(friction=-0.1), "object friction: expected 0 to 2"),
        (lambda: ObjectOptions(bounciness=1), "object bounciness: expected 0 to 0.9"),
        (lambda: ObjectOptions(size=0.3), r"0.3 m does not fit a cell of 0.141 m; choose 0.04 to 0.139"),
        (lambda: ObjectOptions(size=0.01), "choose 0.04"),
        (lambda: ObjectOptions(colour=(0, 0, 256)), "colour: expected three numbers from 0 to 255"),
        (lambda: WorldOptions(objects={"stack": ObjectOptions()}), "no kind 'stack'; the kinds are agent, yellow"),
        (lambda: WorldOptions(timestep_s=0.01), "timestep_s: expected 0.0002 to 0.004, got 0.01"),
        (lambda: WorldOptions(substeps=0), "substeps: expected 1 to 1000"),
        (lambda: WorldOptions(image_size=4), "image_size: expected 16 to 1024"),
        (lambda: CameraOptions(field_of_view=200), "field_of_view: expected 1 to 170"),
        (lambda: CameraOptions(position=(0, 0, float("inf"))), "camera position: expected three finite numbers"),
        (lambda: LightOptions(elevation_deg=-10), "elevation_deg: expected 5 to 90"),
        (lambda: MeshObject(name="a b", file="x.obj"), "mesh name 'a b'"),
        (lambda: MeshObject(name="a", file="x.obj", scale=0), "scale: expected a positive number, got 0"),
        (lambda: MeshObject(name="a", file="x.obj", count=99), "count: expected 1 to 8, got 99"),
        (
            lambda: WorldOptions(meshes=(MeshObject(name="a", file="x"), MeshObject(name="a", file="y"))),
            "two are named",
        ),
    ],
)
def test_impossible_values_are_refused(make: object, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make()  # pyright: ignore[reportCallIssue]


def test_options_are_read_from_plain_data_and_misspelt_ones_refused() -> None:
    options = config.decode({"objects": {"light": {"mass": 3.0}}}, WorldOptions, source="a file")
    assert options == WorldOptions(objects={"light": ObjectOptions(mass=3)})
    with pytest.raises(ConfigError, match="a file"):
        config.decode({"objects": {"light": {"weight": 3.0}}}, WorldOptions, source="a file")


def test_equal_options_share_a_model_and_the_defaults_are_v1() -> None:
    light, heavy = ObjectOptions(mass=3), ObjectOptions(size=0.12)
    one = WorldOptions(objects={"light": light, "heavy": heavy})
    other = WorldOptions(objects={"heavy": heavy, "light": light})
    assert m.build_model(one) is m.build_model(other) is not m.build_model(WorldOptions())
    assert m.build_model(WorldOptions(objects={"light": ObjectOptions()})) is m.build_model(WorldOptions())
    assert World().model is m.build_model(WorldOptions())
    stated = {
        kind: ObjectOptions(mass=c.MASS[kind], size=0.1, colour=c.COLOUR[kind], bounciness=0.6) for kind in c.MASS
    }
    assert m.model_xml(WorldOptions(objects=stated)) == m.model_xml()


@pytest.mark.parametrize("mass", [1.0, 20.0])
@pytest.mark.parametrize("kind", ["light", "yellow", "cone"])
def test_mass_shares_out_the_momentum(kind: str, mass: float) -> None:
    world = world_of(kind, ObjectOptions(mass=mass, friction=0), ("agent", 8, 3), (kind, 8, 5))
    speed(world, "agent")[0] = 2.0
    world.advance(30)
    assert speed(world, f"{kind}_0")[0] > 0.3
    assert mass * speed(world, f"{kind}_0")[0] == pytest.approx(7 * (2.0 - speed(world, "agent")[0]), rel=1e-3)


@pytest.mark.parametrize("friction", [0.1, 0.7])
def test_friction_brakes_by_coulombs_law(friction: float) -> None:
    world = world_of("light", ObjectOptions(friction=friction), ("agent", 1, 1), ("light", 14, 4))
    before = place(world, "light_0")[1]
    start = 1.5
    speed(world, "light_0")[1] = start
    world.advance(600)
    slow = friction * 9.81 / 10  # below this speed the brake is viscous: 10/s of the speed
    expected = (start**2 - slow**2) / (2 * friction * 9.81) + slow / 10
    # With little friction it would slide 11.5 m, so it reaches the wall at 2 m and comes back.
    if friction == 0.7:
        assert place(world, "light_0")[1] - before == pytest.approx(expected, rel=0.05)
    else:
        world.load(world.puzzle)
        speed(world, "light_0")[1] = start
        world.advance(100)
        assert speed(world, "light_0")[1] == pytest.approx(start - friction * 9.81 * 0.4, rel=0.01)


def test_without_friction_nothing_slows_down() -> None:
    world = world_of("yellow", ObjectOptions(friction=0), ("agent", 1, 1), ("yellow", 14, 4))
    speed(world, "yellow_0")[1] = 1.0
    world.advance(200)
    assert speed(world, "yellow_0")[1] == pytest.approx(1.0, abs=1e-9)


def restitution(world: World, a: str, b: str | None) -> float:
    """Mean ratio of separating to closing speed along x, over the phases between substeps at which contact begins."""
    ratios = []
    for phase in np.linspace(0, 1, 16, endpoint=False):
        world.load(world.puzzle)
        place(world, a)[0] += phase * 2.0 * c.TIMESTEP_S
        speed(world, a)[0] = 2.0
        closing = 2.0
        for _ in range(100):
            now = speed(world, a)[0] - (speed(world, b)[0] if b else 0)
            if world.advance(1).contacts:
                closing = max(now, closing) if now > 0 else closing
            elif now < 0:
                ratios.append(-now / closing)
                break
    assert len(ratios) == 16
    return float(np.mean(ratios))


@pytest.mark.parametrize("bounciness", [0.2, 0.9])
def test_bounciness_is_the_mean_of_two_and_half_of_it_at_walls(bounciness: float) -> None:
    options = ObjectOptions(bounciness=bounciness, friction=0)
    world = world_of("light", options, ("agent", 8, 3), ("light", 8, 5))
    assert restitution(world, "agent", "light_0") == pytest.approx((0.6 + bounciness) / 2, abs=0.03)
    world = world_of("light", options, ("agent", 1, 1), ("light", 8, 3), ("light", 8, 5))
    assert restitution(world, "light_0", "light_1") == pytest.approx(bounciness, abs=0.03)
    world = world_of("light", options, ("agent", 1, 1), ("light", 8, 7))
    assert restitution(world, "light_0", None) == pytest.approx(bounciness / 2, abs=0.03)


@pytest.mark.parametrize(("kind", "across"), [("light", 1), ("rectangle", 3), ("push", 1), ("cone", 1), ("agent", 1)])
def test_size_is_the_distance_at_which_objects_touch(kind: str, across: int) -> None:
    size = 0.13
    other = "heavy" if kind == "agent" else kind
    world = world_of(kind, ObjectOptions(size=size), ("agent", 8, 2), (other, 8, 6))
    names = "agent", f"{other}_0"
    for name in names:
        expected = size if name.startswith(kind) else 0.1
        assert place(world, name)[2] == pytest.approx(expected / 2, abs=1e-3)  # it lies on the table
    gap = place(world, names[1])[0] - place(world, "agent")[0]
    speed(world, "agent")[0] = 0.1
    while not (outcome := world.advance(1)).contacts:
        gap = place(world, names[1])[0] - place(world, "agent")[0]
    assert {outcome.contacts[0].a, outcome.contacts[0].b} == set(names)
    radius = (size if kind == "agent" else 0.1) / 2
    half = (0.1 if kind == "agent" else size * across) / 2
    expected = {
        "push": np.sqrt((radius + half) ** 2 - (radius - half) ** 2),  # two spheres on one table
        # The slope's half angle is atan ½: its distance from the axis at the agent's height, and the radius across it.
        "cone": (size - radius) / 2 + radius / np.cos(np.arctan(0.5)),
    }.get(kind, radius + half)
    assert gap == pytest.approx(expected, abs=1e-3)


def test_colour_is_visible_in_the_observation() -> None:
    world = world_of("light", ObjectOptions(colour=(20, 40, 80)), ("agent", 8, 4), ("light", 12, 4))
    seen = world.observe()[world.segmentation() == world.model.geom("light_0").id].astype(float)
    assert len(seen) > 8
    inner = seen[np.argsort(seen.sum(axis=1))][2:-2].mean(axis=0)  # without the mixed colours at its edges
    np.testing.assert_allclose(inner / inner.sum(), np.array([20, 40, 80]) / 140, atol=0.03)


def test_the_camera_has_the_position_of_its_options() -> None:
    options = CameraOptions(position=(0.0, 0.0, 2.5), direction=(90.0, 0.0, 0.0), field_of_view=60.0)
    world = World(WorldOptions(camera=options, image_size=160))
    world.load(Puzzle("sandbox", arranged([Placement("agent", 3, 6)])))
    rows, columns = np.nonzero(world.segmentation() == world.model.geom("agent").id)
    x, y = c.cell_centre(3, 6)
    half = np.tan(np.deg2rad(30)) * (2.5 - c.RADIUS)  # metres from the middle to the image's edge, at its height
    assert world.observe().shape == (160, 160, 3)
    assert columns.mean() == pytest.approx(80 + 80 * x / half - 0.5, abs=0.7)
    assert rows.mean() == pytest.approx(80 - 80 * y / half - 0.5, abs=0.7)


def test_light_has_the_direction_of_its_options() -> None:
    def brightness(light: LightOptions) -> dict[str, float]:
        world = World(WorldOptions(light=light))
        world.load(Puzzle("sandbox", arranged([Placement("agent", 8, 4)])))
        image, label = world.observe().astype(float), world.segmentation()
        return {name: float(image[label == world.model.geom(name).id].mean()) for name in ("table", "seen_wall_north")}

    low, high = brightness(LightOptions(elevation_deg=20)), brightness(LightOptions(elevation_deg=80))
    assert high["table"] > low["table"] + 5
    front, behind = brightness(LightOptions(angle_deg=270)), brightness(LightOptions(angle_deg=90))
    assert front["seen_wall_north"] > behind["seen_wall_north"] + 3  # its visible face points south
    assert front["table"] == pytest.approx(behind["table"], abs=1)
    np.testing.assert_allclose(LightOptions(angle_deg=0, elevation_deg=90).direction, (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(
        LightOptions(angle_deg=180, elevation_deg=45).direction, (0.5**0.5, 0, -(0.5**0.5)), atol=1e-12
    )


def test_timestep_and_substeps_divide_time() -> None:
    for options in (WorldOptions(timestep_s=0.001, substeps=40), WorldOptions(substeps=5)):
        world = World(options)
        world.load(Puzzle("sandbox", arranged([Placement("agent", 8, 2)])))
        before = place(world, "agent")[0]
        world.step(EAST)
        assert place(world, "agent")[0] - before == pytest.approx(c.MOVE_SPEED * options.timestep_s * options.substeps)
        assert world.data.time == pytest.approx(options.timestep_s * options.substeps)
