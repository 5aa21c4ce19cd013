"""The physics (moves, pushes, bounces, friction, ramp, walls) compared with closed forms; exact save and restore."""

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.envs.physics import model as m
from gym_open.envs.puzzles import SIDES, TASKS, Patch, Pen, Placement, Puzzle, PuzzleError, Side, Task, arranged
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.world import GOAL_INDEX, World
from gym_open.errors import ArtefactError

EAST, NORTH, WEST, SOUTH = 1, 3, 5, 7
TOWARDS: dict[Side, int] = {"north": NORTH, "east": EAST, "south": SOUTH, "west": WEST}
ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)


def layout(*objects: tuple, pen: Pen | None = None, patch: Patch | None = None) -> Puzzle:
    return Puzzle(task="sandbox", objects=arranged([Placement(*item) for item in objects]), pen=pen, patch=patch)


def loaded(*objects: tuple, pen: Pen | None = None, patch: Patch | None = None) -> World:
    world = World()
    world.load(layout(*objects, pen=pen, patch=patch))
    return world


def position(world: World, name: str) -> np.ndarray:
    return world.object_state()[m.INVENTORY.index(name), :3].copy()


def speed(world: World, name: str) -> np.ndarray:
    return world.object_state()[m.INVENTORY.index(name), 7:10].copy()


def set_speed(world: World, name: str, velocity: tuple[float, float, float]) -> None:
    index = m.INVENTORY.index(name)
    world.data.qvel[6 * index : 6 * index + 3] = velocity


def run(world: World, seconds: float) -> None:
    for _ in range(round(seconds / c.TIMESTEP_S)):
        mujoco.mj_step(world.model, world.data)


@pytest.mark.parametrize("action", range(1, 9))
def test_a_move_is_one_cell_and_then_the_agent_stands(action: int) -> None:
    world = loaded(("agent", 8, 4))
    before = position(world, "agent")
    world.step(action)
    moved = position(world, "agent") - before
    np.testing.assert_allclose(moved[:2], np.array(c.MOVES[action]) * c.PITCH, atol=0.05 * c.PITCH)
    assert abs(moved[2]) < 1e-6
    assert not speed(world, "agent")[:2].any()


def test_action_directions() -> None:
    assert c.MOVES == ((0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


def test_a_no_op_lets_no_time_pass() -> None:
    world = loaded(("agent", 12, 4), ("light", 10, 4))
    for _ in range(2):
        world.step(NORTH)
    state = world.save_state()
    assert np.linalg.norm(speed(world, "light_0")) > 1  # an object is moving
    world.step(0)
    np.testing.assert_array_equal(world.save_state(), state)


@pytest.mark.parametrize("action", [-1, 9])
def test_unknown_actions_are_refused(action: int) -> None:
    with pytest.raises(ValueError, match="expected 0 to 8"):
        loaded(("agent", 8, 4)).step(action)


def test_an_empty_world_says_so() -> None:
    with pytest.raises(PuzzleError, match="load a puzzle first"):
        World().step(1)


def test_a_light_cube_goes_further_than_a_heavy_one_under_the_same_push() -> None:
    gone: dict[str, float] = {}
    for kind in ("light", "heavy"):
        world = loaded(("agent", 14, 4), (kind, 12, 4))
        start = position(world, f"{kind}_0")
        for _ in range(2):
            world.step(NORTH)
        run(world, 2)
        gone[kind] = float((position(world, f"{kind}_0") - start)[1])
    assert gone["light"] > 1.0
    assert 0.01 < gone["heavy"] < 0.08


@pytest.mark.parametrize(("kind", "start"), [("light", 2.0), ("heavy", 2.0), ("light", 1.0)])
def test_a_sliding_cube_brakes_by_coulombs_law(kind: str, start: float) -> None:
    world = loaded(("agent", 1, 1), (kind, 14, 4))
    before = position(world, f"{kind}_0")
    set_speed(world, f"{kind}_0", (0, start, 0))
    run(world, 2)
    # v²/2µg, and the last distance, from the speed µg/b on, where the brake is b·speed instead of sliding friction.
    friction, brake = 0.35 * 9.81, 10.0
    slow = friction / brake
    expected = (start**2 - slow**2) / (2 * friction) + slow / brake
    gone = position(world, f"{kind}_0") - before
    assert gone[1] == pytest.approx(expected, rel=0.1)
    assert abs(gone[0]) < 0.002
    assert abs(gone[2]) < 0.002
    assert not speed(world, f"{kind}_0").any()


def test_a_fast_cube_stays_on_the_table() -> None:
    world = loaded(("agent", 1, 1), ("light", 14, 4))
    set_speed(world, "light_0", (0, 4, 0))
    highest = 0.0
    for _ in range(100):
        run(world, c.TIMESTEP_S)
        highest = max(highest, position(world, "light_0")[2])
    assert highest < c.RADIUS + 0.006


def test_a_goal_rolls_without_slipping_and_comes_to_rest() -> None:
    world = loaded(("agent", 1, 1), ("yellow", 14, 4))
    set_speed(world, "yellow_0", (0, 1, 0))
    run(world, 0.8)
    state = world.object_state()[m.INVENTORY.index("yellow_0")]
    # From sliding to rolling, a ball keeps 5/7 of its speed, and rolling costs a little more.
    assert 0.3 < state[8] < 5 / 7
    assert state[10] == pytest.approx(-state[8] / c.RADIUS, rel=0.04)  # turning forward about −x
    run(world, 6)
    assert not speed(world, "yellow_0").any()


def bounce(world: World, name: str, start: float) -> float:
    """Ratio of the speeds away from the wall and towards it, for a body that moves east."""
    set_speed(world, name, (start, 0, 0))
    wall = world.model.geom("wall_east").id
    before, touched = start, False
    for _ in range(300):
        now = speed(world, name)[0]
        run(world, c.TIMESTEP_S)
        touching = bool((world.data.contact.geom == wall).any())
        if touching and not touched:
            before, touched = now, True
        elif touched and not touching:
            return -speed(world, name)[0] / before
    raise AssertionError("it never came back")


@pytest.mark.parametrize("kind", ["light", "yellow", "heavy"])
def test_walls_give_back_some_speed_and_never_more(kind: str) -> None:
    ratios = []
    for phase in np.linspace(0, 1, 6):
        world = loaded(("agent", 1, 1), (kind, 8, 7))
        index = m.INVENTORY.index(f"{kind}_0")
        world.data.qpos[7 * index] += phase * 3 * c.TIMESTEP_S
        ratios.append(bounce(world, f"{kind}_0", 3.0))
    assert np.mean(ratios) == pytest.approx(0.3, abs=0.06)
    assert 0 < min(ratios) <= max(ratios) < 0.7


@pytest.mark.parametrize("kind", ["light", "heavy", "yellow"])
def test_a_hit_keeps_momentum_and_never_makes_energy(kind: str) -> None:
    world = loaded(("agent", 8, 3), (kind, 8, 5))
    set_speed(world, "agent", (3.5, 0, 0))
    masses = {"agent": 7.0, f"{kind}_0": c.MASS[kind]}
    for _ in range(16):  # until after the contact; friction with the table removes a little
        run(world, c.TIMESTEP_S)
    speeds = {name: speed(world, name)[0] for name in masses}
    assert speeds[f"{kind}_0"] > 0.1
    assert sum(masses[name] * v for name, v in speeds.items()) == pytest.approx(7 * 3.5, rel=0.15)
    assert sum(masses[name] * v**2 for name, v in speeds.items()) < 7 * 3.5**2


def test_hits_are_reported_once_and_detected_between_steps() -> None:
    world = loaded(("agent", 8, 3), ("yellow", 8, 4), ("green", 8, 2))
    first = world.step(EAST)
    assert first.hits == ("yellow_0",)
    assert world.step(EAST).hits == ()
    # At the end of the step, the ball is already away: the touch was only within the substeps.
    assert position(world, "yellow_0")[0] - position(world, "agent")[0] > 2 * c.RADIUS
    (contact,) = first.contacts
    assert {contact.a, contact.b} == {"agent", "yellow_0"}
    sign = 1 if contact.a == "agent" else -1
    assert sign * contact.normal[0] == pytest.approx(1, abs=1e-3)
    assert position(loaded(("agent", 8, 3)), "agent")[0] < contact.position[0] < position(world, "yellow_0")[0]
    # The impulse is the change of the ball's momentum, apart from the table's friction within 0.04 s.
    world = loaded(("agent", 8, 3), ("yellow", 8, 4))
    impulse = sum(item.impulse for item in world.step(EAST).contacts)
    assert impulse == pytest.approx(c.MASS["yellow"] * speed(world, "yellow_0")[0], rel=0.06)


def test_contacts_name_walls_and_leave_out_the_table() -> None:
    world = loaded(("agent", 14, 1), ("heavy", 1, 1))
    world.step(WEST)
    outcome = world.step(WEST)
    assert {name for contact in outcome.contacts for name in (contact.a, contact.b)} == {"agent", "wall_west"}


def test_danger_is_within_the_patch_and_is_detected_in_passing() -> None:
    world = loaded(("agent", 12, 4), patch=Patch(9, 4))
    assert not world.step(0).in_danger
    assert not world.step(NORTH).in_danger  # 2 cells from the centre: 0.28 m
    assert world.step(NORTH).in_danger
    # A move that cuts the patch's corner begins and ends outside.
    world.load(world.puzzle)
    x, y = c.cell_centre(9, 4)
    world.data.qpos[:2] = x - c.DANGER_HALF - 0.05, y + c.DANGER_HALF - 0.09
    assert not world.step(0).in_danger
    assert world.step(2).in_danger
    assert not world.step(0).in_danger


@pytest.mark.parametrize("side", list(SIDES))
def test_the_ramp_leads_out_of_the_pen(side: Side) -> None:
    i, j = SIDES[side]
    world = loaded(("agent", 8 - i, 4 - j), pen=Pen(8, 4, side))
    for _ in range(5):
        world.step(TOWARDS[side])
    for action in (EAST, WEST) * 3 if i else (NORTH, SOUTH) * 3:  # back and forth, until it has fallen to the table
        world.step(action)
    away = position(world, "agent")[:2] - c.cell_centre(8, 4)
    assert away @ (j, -i) > c.PEN_HALF
    assert position(world, "agent")[2] == pytest.approx(c.RADIUS, abs=0.005)


def test_the_pen_cannot_be_left_without_the_ramp() -> None:
    rng = np.random.default_rng(0)
    for side in SIDES:
        world = loaded(("agent", 8 - SIDES[side][0], 4 - SIDES[side][1]), pen=Pen(8, 4, side))
        world.data.mocap_pos[world.model.body("ramp").mocapid[0]] = (0, -60, 0)
        for action in rng.integers(1, 9, 250):
            world.step(int(action))
            assert np.abs(position(world, "agent")[:2] - c.cell_centre(8, 4)).max() < c.PEN_HALF


def test_nothing_leaves_the_table_or_sinks_into_anything() -> None:
    rng = np.random.default_rng(3)
    world = World()
    deepest = 0.0
    for number in range(25):
        world.load(sample_puzzle(ALL_TASKS[number % 5], rng))
        for action in rng.integers(1, 9, 40):
            world.step(int(action))
            state = world.object_state()[world.present]
            assert np.isfinite(state).all()
            assert (np.abs(state[:, 0]) < c.WALL_X).all()
            assert (np.abs(state[:, 1]) < c.WALL_Y).all()
            assert state[:, 2].min() > 0.6 * c.RADIUS
            assert state[:, 2].max() < 0.4
            deepest = max(deepest, -float(world.data.contact.dist.min(initial=0)))
    assert deepest < 0.03


def test_parked_objects_stay_asleep_and_out_of_the_way() -> None:
    world = loaded(("agent", 8, 4), ("light", 3, 3))
    parked = world.object_state()[~world.present]
    rng = np.random.default_rng(0)
    for action in rng.integers(1, 9, 40):
        world.step(int(action))
    np.testing.assert_array_equal(world.object_state()[~world.present], parked)
    assert parked[:, 1].max() < -20
    assert world.present.sum() == 2


@pytest.mark.parametrize("task", ALL_TASKS)
def test_a_saved_state_goes_on_bit_for_bit(task: Task) -> None:
    rng = np.random.default_rng(5)
    puzzle = sample_puzzle(task, rng)
    world = World()
    for elsewhere in (True, False):
        world.load(puzzle, recolour_hits=True)
        for action in rng.integers(0, 9, 25):
            world.step(int(action))
        saved, actions = world.save_state(), rng.integers(0, 9, 30).tolist()
        first = [(world.step(a), world.save_state(), world.observe()) for a in actions]
        again = World() if elsewhere else world
        again.load(puzzle, recolour_hits=True)
        again.restore_state(saved)
        np.testing.assert_array_equal(again.save_state(), saved)
        for action, (outcome, state, image) in zip(actions, first, strict=True):
            assert again.step(action) == outcome
            np.testing.assert_array_equal(again.save_state(), state)
            np.testing.assert_array_equal(again.observe(), image)


def test_a_state_of_another_size_is_refused() -> None:
    world = loaded(("agent", 8, 4))
    with pytest.raises(ArtefactError, match="got shape"):
        world.restore_state(np.zeros(3))


def test_loading_forgets_what_came_before() -> None:
    used, fresh = World(), World()
    used.load(fixed_puzzles("tool-use")[0])
    for _ in range(5):
        used.step(NORTH)
    puzzle = fixed_puzzles("preferences")[1]
    for world in (used, fresh):
        world.load(puzzle)
        for action in (1, 3, 5, 7, 2):
            world.step(action)
    np.testing.assert_array_equal(used.save_state(), fresh.save_state())
    np.testing.assert_array_equal(used.observe(), fresh.observe())


def test_worlds_in_threads_give_the_same_as_one_after_the_other() -> None:
    def played(number: int) -> tuple[np.ndarray, np.ndarray]:
        rng, world = np.random.default_rng(number), World()
        world.load(fixed_puzzles("preferences")[number])
        images = []
        for action in rng.integers(1, 9, 60).tolist():
            world.step(action)
            images.append(world.observe())
        return world.save_state(), np.array(images)

    alone = [played(number) for number in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(played, range(4)), strict=True):
            np.testing.assert_array_equal(one[0], other[0])
            np.testing.assert_array_equal(one[1], other[1])


def test_angular_velocity_is_in_the_worlds_frame() -> None:
    world = loaded(("agent", 1, 1), ("light", 8, 4))
    index = m.INVENTORY.index("light_0")
    world.data.qpos[7 * index + 3 : 7 * index + 7] = np.sqrt(0.5), np.sqrt(0.5), 0, 0  # a quarter turn about x
    world.data.qvel[6 * index + 3 : 6 * index + 6] = 0, 1, 0  # about its own y, which now points up
    np.testing.assert_allclose(world.object_state()[index, 10:], (0, 0, 1), atol=1e-12)


def test_the_model_is_the_text() -> None:
    model = mujoco.MjModel.from_xml_string(m.model_xml())
    names = [model.body(i).name for i in range(model.nbody)]
    assert tuple(name for name in names if name in m.INVENTORY) == m.INVENTORY
    for name in m.INVENTORY:
        assert model.body(name).mass[0] == c.MASS[m.kind_of(name)]


@pytest.mark.parametrize("again", [copy.deepcopy, lambda world: pickle.loads(pickle.dumps(world))])
def test_a_copy_is_a_world_of_its_own(again: Callable[[World], World]) -> None:
    world = World()
    assert again(world).object_state().shape == world.object_state().shape
    world.load(fixed_puzzles("preferences")[3], recolour_hits=True)
    for action in (1, 2, 3, 4):
        world.step(action)
    twin, before = again(world), world.object_state()
    np.testing.assert_array_equal(twin.object_state(), before)
    moved = [twin.step(action) for action in (5, 6, 7)]
    np.testing.assert_array_equal(world.object_state(), before)
    assert [world.step(action) for action in (5, 6, 7)] == moved
    np.testing.assert_array_equal(twin.observe(), world.observe())
    np.testing.assert_array_equal(twin.save_state(), world.save_state())


def test_a_damaged_state_is_refused() -> None:
    world = World()
    world.load(fixed_puzzles("avoidance")[0])
    state = world.save_state()
    state[-len(world.inventory) :] = 1e8
    with pytest.raises(ArtefactError, match="damaged"):
        world.restore_state(state)


def test_sleepers_that_do_not_point_in_rings_are_refused() -> None:
    """MuJoCo ends the process when it wakes a body whose ring is not closed."""
    world = loaded(("agent", 2, 2), ("heavy", 4, 4), ("light", 8, 8))
    saved = world.save_state()
    n = len(world.inventory)
    first = len(saved) - n - len(GOAL_INDEX)
    asleep = saved[first : first + n]
    assert (asleep >= 0).sum() > 2
    tails = {
        "all point to one": np.zeros(n),
        "one points to another's ring": np.where(np.arange(n) == np.flatnonzero(asleep >= 0)[-1], 2.0, asleep),
        "one points to who is awake": np.where(np.arange(n) == np.flatnonzero(asleep >= 0)[-1], 0.0, asleep),
    }
    for tail in tails.values():
        damaged = saved.copy()
        damaged[first : first + n] = tail
        with pytest.raises(ArtefactError, match="rings"):
            world.restore_state(damaged)
    two = saved.copy()
    two[first + 1 : first + 3] = 2, 1  # two bodies in contact point to each other
    world.restore_state(two)
