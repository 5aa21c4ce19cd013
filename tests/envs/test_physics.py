"""Events that must never happen, for every kind of object: passing through, escaping, gaining energy; the new kinds."""

import mujoco
import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.bounciness import restitution
from gym_open.envs.puzzles import Pen, Placement, Puzzle, arranged
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World

EAST, NORTH, WEST, SOUTH = 1, 3, 5, 7
KINDS = tuple(kind for kind in c.CAPACITY if kind != "agent")
EVERYTHING = SandboxConfig(heavy=(1, 3), light=(1, 3), push=(1, 2), rectangle=(1, 2), cone=(1, 2), stack=(1, 1))
HALF = WorldOptions(timestep_s=c.TIMESTEP_S / 2, substeps=2 * c.SUBSTEPS)


def laid(*objects: tuple, pen: Pen | None = None, options: WorldOptions | None = None) -> World:
    world = World(options)
    world.load(Puzzle("sandbox", arranged([Placement(*item) for item in objects]), pen=pen))
    return world


def pose(world: World, name: str) -> np.ndarray:
    """(7,) view."""
    return world.data.qpos.reshape(-1, 7)[world.inventory.index(name)]


def velocity(world: World, name: str) -> np.ndarray:
    """(6,) view."""
    return world.data.qvel.reshape(-1, 6)[world.inventory.index(name)]


def depth(world: World) -> float:
    """Deepest overlap in the last substep, without the ground."""
    contact = world.data.contact
    aside = ~(contact.geom == world.model.geom("ground").id).any(axis=1)
    return -float(contact.dist[aside].min(initial=0))


def deepest_of(world: World, substeps: int) -> float:
    found = 0.0
    for _ in range(substeps):
        mujoco.mj_step(world.model, world.data)
        found = max(found, depth(world))
    return found


@pytest.mark.parametrize("kind", [*KINDS, "stack"])
@pytest.mark.parametrize("action", [EAST, 2, SOUTH, 6])
def test_the_agent_at_full_speed_passes_through_nothing(kind: str, action: int) -> None:
    x, y = c.MOVES[action]
    for phase in (0.0, 0.3, 0.6):
        world = laid(("agent", 8, 4), (kind, 8 - 2 * y, 4 + 2 * x))
        pose(world, "agent")[:2] += phase * c.MOVE_SPEED * c.TIMESTEP_S * np.array((x, y))
        for _ in range(3):
            velocity(world, "agent")[:2] = c.MOVE_SPEED * x, c.MOVE_SPEED * y
            assert deepest_of(world, c.SUBSTEPS) < 0.03  # half a cube is 0.05


@pytest.mark.parametrize("kind", ["agent", *KINDS])
def test_no_thrown_object_passes_a_pen_or_the_table_walls(kind: str) -> None:
    rng, centre = np.random.default_rng(0), np.array(c.cell_centre(8, 4))
    name = kind if kind == "agent" else f"{kind}_0"
    for angle in rng.uniform(0, 2 * np.pi, 12):
        direction = np.array([np.cos(angle), np.sin(angle)])
        world = (
            laid(("agent", 9, 4), pen=Pen(8, 4, "north"))
            if kind == "agent"
            else laid(("agent", 1, 1), (kind, 13, 4), pen=Pen(8, 4, "north"))
        )
        world.data.mocap_pos[world.model.body("ramp").mocapid[0]] = 0, -60, 0
        # The agent starts in the middle and moves outwards, all other objects start outside and move to the pen.
        inside = kind == "agent"
        pose(world, name)[:2] = centre if inside else centre - (0.46, 0.5) * direction / np.abs(direction).max()
        mujoco.mj_forward(world.model, world.data)
        velocity(world, name)[:2] = 6 * direction
        assert deepest_of(world, 25) < 0.045
        assert (np.abs(pose(world, name)[:2] - centre) < c.PEN_HALF).all() == inside
        deepest_of(world, 50)
        assert (np.abs(pose(world, name)[:2]) < (c.WALL_X, c.WALL_Y)).all()


def test_everything_together_stays_on_the_table() -> None:
    rng, world = np.random.default_rng(2), World()
    for _ in range(6):
        world.load(sample_puzzle("sandbox", rng, EVERYTHING))
        for action in rng.integers(1, c.N_ACTIONS, 60).tolist():
            world.step(action)
            state = world.object_state()[world.present]
            assert np.isfinite(state).all()
            assert (np.abs(state[:, :2]) < (c.WALL_X, c.WALL_Y)).all()
            assert 0.005 < state[:, 2].min() < state[:, 2].max() < 0.4
            assert depth(world) < 0.045


@pytest.mark.slow
@pytest.mark.parametrize("options", [WorldOptions(), HALF])
def test_ten_thousand_steps_with_everything(options: WorldOptions) -> None:
    rng, world = np.random.default_rng(3), World(options)
    for layout in range(4):
        world.load(sample_puzzle("sandbox" if layout % 2 else "tool-use", rng, EVERYTHING))
        for action in rng.integers(1, c.N_ACTIONS, 10_000).tolist():
            world.step(action)
            places = world.object_state()[world.present, :3]
            assert np.isfinite(places).all()
            assert (np.abs(places[:, :2]) < (c.WALL_X, c.WALL_Y)).all()
            assert places[:, 2].max() < 0.4
            assert depth(world) < 0.045


def energy(world: World) -> float:
    """Kinetic and potential energy in joules, by MuJoCo's own sum over bodies' centres of mass."""
    mujoco.mj_comPos(world.model, world.data)
    mujoco.mj_crb(world.model, world.data)
    mujoco.mj_energyPos(world.model, world.data)
    mujoco.mj_energyVel(world.model, world.data)
    return float(world.data.energy.sum())


def test_contacts_add_no_energy() -> None:
    """A contact is a spring that returns its energy, so energy is compared from a start without contact."""
    rng, world, checked = np.random.default_rng(4), World(), 0
    for _ in range(6):
        world.load(sample_puzzle("sandbox", rng, EVERYTHING))
        for action in rng.integers(1, c.N_ACTIONS, 25).tolist():
            mujoco.mj_fwdPosition(world.model, world.data)
            free = depth(world) == 0
            agent = velocity(world, "agent")
            agent[:2] += c.MOVE_SPEED * np.array(c.MOVES[action])
            # The constant potential energy of parked objects does not matter: only objects on the table are compared.
            before = energy(world)
            scale = float(sum(world.model.body(world.inventory[i]).mass[0] for i in world.present.nonzero()[0])) * 0.5
            scale += 0.5 * 7 * float(agent[:2] @ agent[:2])
            for _ in range(c.SUBSTEPS):
                mujoco.mj_step(world.model, world.data)
                mujoco.mj_kinematics(world.model, world.data)
                if free:
                    assert energy(world) - before < 0.01 * scale
                    checked += 1
            agent[:] = 0, 0, min(agent[2], 0), 0, 0, 0
    assert checked > 300


@pytest.mark.parametrize("kind", KINDS)
def test_half_the_timestep_gives_the_same_push(kind: str) -> None:
    gone = []
    for options in (WorldOptions(), HALF):
        ways = []
        for phase in np.linspace(0, 1, 6, endpoint=False):
            world = laid(("agent", 14, 4), (kind, 12, 4), options=options)
            pose(world, "agent")[1] += phase * c.MOVE_SPEED * options.timestep_s
            start = pose(world, f"{kind}_0")[:2].copy()
            for _ in range(2):
                world.step(NORTH)
            world.advance(round(0.4 / options.timestep_s))
            ways.append(np.linalg.norm(pose(world, f"{kind}_0")[:2] - start))
        gone.append(np.mean(ways))
    assert gone[1] == pytest.approx(gone[0], rel=0.12)


def test_a_contact_gives_back_as_much_as_a_spring_in_continuous_time() -> None:
    stiffness, brake = 40_000.0, 72.0
    ratio = brake / 2 / stiffness**0.5
    root = np.sqrt(1 - ratio**2)
    phase = np.pi - np.arctan2(2 * ratio * root, 1 - 2 * ratio**2)
    expected = np.exp(-phase * ratio / root)
    assert restitution(stiffness, brake, 1e-5) == pytest.approx(expected, abs=1e-3)


def test_a_stack_stands_until_it_is_hit() -> None:
    world = laid(("agent", 14, 4), ("stack", 8, 4), ("light", 3, 3))
    low, high = pose(world, "light_1"), pose(world, "light_2")  # light_0 is a separate cube
    assert (low[:2] == high[:2]).all()
    assert high[2] - low[2] == pytest.approx(2 * c.RADIUS, abs=1e-3)
    before = high.copy()
    world.step(SOUTH)
    np.testing.assert_array_equal(high, before)  # both sleep
    pose(world, "agent")[1] = c.cell_centre(10, 4)[1]
    world.step(NORTH)
    world.step(NORTH)
    world.advance(10)
    assert low[1] - before[1] > 0.1  # knocked away from under the upper cube
    assert abs(high[1] - before[1]) < 0.05
    world.advance(500)
    assert high[2] < 0.06


def test_the_lid_is_higher_over_a_stack() -> None:
    def top(*objects: tuple) -> float:
        world = laid(("agent", 14, 1), *objects)
        name = "light_1" if ("stack", 8, 4) in objects else "light_0"
        velocity(world, name)[2] = 5.0
        mujoco.mj_forward(world.model, world.data)
        highest = 0.0
        for _ in range(40):
            mujoco.mj_step(world.model, world.data)
            highest = max(highest, pose(world, name)[2] + c.RADIUS)
        return highest

    assert top(("light", 8, 4)) == pytest.approx(c.LID_HEIGHT, abs=0.03)
    assert top(("stack", 8, 4)) == pytest.approx(c.LID_HEIGHT + 2 * c.RADIUS, abs=0.03)


def test_a_rectangle_lies_along_its_row_or_its_column() -> None:
    for turned, action, reach in ((False, EAST, 0.15), (True, EAST, 0.05), (False, NORTH, 0.05), (True, NORTH, 0.15)):
        world = laid(("agent", 13, 1), ("rectangle", 8, 4, turned))
        x, y = np.array(c.MOVES[action])
        pose(world, "agent")[:2] = c.cell_centre(8, 4) - np.array((x, y)) * (reach + c.RADIUS + 0.01)
        velocity(world, "agent")[:2] = 0.5 * x, 0.5 * y
        assert not world.advance(3).contacts
        assert world.advance(4).contacts


@pytest.mark.parametrize("kind", ["push", "rectangle", "cone"])
def test_new_kinds_are_pushed_along_and_come_to_rest(kind: str) -> None:
    world = laid(("agent", 14, 4), (kind, 12, 4))
    start = pose(world, f"{kind}_0").copy()
    for _ in range(2):
        world.step(NORTH)
    assert velocity(world, f"{kind}_0")[1] > 0.3
    world.advance(1500)
    state = world.object_state()[world.inventory.index(f"{kind}_0")]
    assert state[1] > start[1] + 0.2
    assert abs(state[0] - start[0]) < 0.15
    assert not state[7:].any()
    assert world.data.tree_asleep[world.inventory.index(f"{kind}_0")] >= 0


def test_time_passes_without_an_action_only_by_advance() -> None:
    world = laid(("agent", 12, 4), ("yellow", 10, 4))
    world.step(NORTH)
    world.step(NORTH)
    saved, before = world.save_state(), pose(world, "yellow_0")[1]
    world.advance(0)
    np.testing.assert_array_equal(world.save_state(), saved)
    outcome = world.advance(25)
    assert pose(world, "yellow_0")[1] > before + 0.05
    np.testing.assert_allclose(velocity(world, "agent"), 0, atol=1e-4)
    assert not outcome.hits
    assert world.data.time == pytest.approx((2 * c.SUBSTEPS + 25) * c.TIMESTEP_S)
