"""Stuck agents and wedged objects, compared with the words of the definition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.envs.constants import WALL_X, WALL_Y
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles import Placement, Puzzle
from gym_open.envs.stuck import AGENT_PUSHES, CORNER_PUSHES, REACH_M, Watch, in_corner
from gym_open.envs.world import World

RECTANGLE = INVENTORY.index("rectangle_0")


def states(**where: tuple[float, float]) -> np.ndarray:
    """States with all objects parked except the named ones, which are upright at (x, y)."""
    made = np.zeros((len(INVENTORY), 13))
    made[:, 1], made[:, 3] = -30, 1
    for name, place in where.items():
        made[INVENTORY.index(name), :2] = place
    return made


def watch() -> Watch:
    return Watch(segment=4, place=(0.0, 0.0, 0.0))


def test_an_agent_that_does_not_move_is_stuck_until_it_gets_away() -> None:
    one = watch()
    turns = [one.push(states(agent=(0.0, 0.019)), step) for step in range(1, AGENT_PUSHES + 10)]
    found = [turn for now in turns for turn in now]
    assert [(turn.step, turn.kind, turn.name, turn.began, turn.segment) for turn in found] == [
        (AGENT_PUSHES, "agent", "agent", True, 4)
    ]
    assert found[0].position == (0.0, 0.019, 0.0)
    assert one.agent
    freed = one.push(states(agent=(0.0, 0.021)), 99)
    assert [(turn.step, turn.began, turn.position) for turn in freed] == [(99, False, (0.0, 0.021, 0.0))]
    assert not one.agent


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.001, 0.003, 0.005, 0.02]))
def test_stuck_means_32_pushes_close_together(seed: int, pace: float) -> None:
    """Sound: a stuck agent was within 4 cm for 32 pushes. Complete: an agent within 1 cm for 64 pushes is stuck."""
    path = np.cumsum(np.random.default_rng(seed).normal(0, pace, (200, 2)), axis=0)
    one, held = watch(), []
    for step, (x, y) in enumerate(path):
        one.push(states(agent=(x, y)), step)
        held.append(one.agent)
    for step in range(64, 200):
        if held[step]:
            recent = path[step - AGENT_PUSHES : step + 1]
            assert np.linalg.norm(recent[:, None] - recent, axis=-1).max() <= 2 * REACH_M
        recent = path[step - 64 : step + 1]
        if np.linalg.norm(recent[:, None] - recent, axis=-1).max() <= REACH_M / 2:
            assert any(held[step - 63 : step + 1])


def test_an_agent_that_pushes_into_a_wall_is_not_stuck_since_it_bounces_off_it() -> None:
    world = World()
    world.load(Puzzle(task="sandbox", objects=(Placement("agent", 8, 7), Placement("yellow", 3, 3))))
    one = Watch(0, tuple(world.object_state()[0, :3].tolist()))
    for step in range(100):
        world.step(1)  # east, where the wall is one cell away
        assert one.push(world.object_state(), step) == []
    assert world.object_state()[0, 0] > 0.5


@given(st.floats(0, WALL_X - 0.05), st.floats(0, WALL_Y - 0.05), st.sampled_from([1, -1]), st.sampled_from([1, -1]))
def test_a_corner_is_where_the_agent_does_not_fit_behind(x: float, y: float, sx: int, sy: int) -> None:
    """The agent is 0.1 wide, like all objects except rectangles; it fits into neither gap in a corner."""
    there = WALL_X - x - 0.05 < 0.1 and WALL_Y - y - 0.05 < 0.1
    assert in_corner(states(light_0=(sx * x, sy * y), agent=(0.6, 1.0))) == (["light_0"] if there else [])


@pytest.mark.parametrize(("angle", "reach"), [(0.0, (0.15, 0.05)), (np.pi / 2, (0.05, 0.15)), (np.pi, (0.15, 0.05))])
@pytest.mark.parametrize(("gap", "there"), [(0.09, True), (0.11, False)])
def test_a_rectangle_reaches_as_far_as_it_lies(
    angle: float, reach: tuple[float, float], gap: float, *, there: bool
) -> None:
    for free in (0, 1):  # which of the two gaps it is
        gaps = [0.01, 0.01]
        gaps[free] = gap
        made = states(rectangle_0=(WALL_X - reach[0] - gaps[0], WALL_Y - reach[1] - gaps[1]))
        made[RECTANGLE, 3:7] = np.cos(angle / 2), 0, 0, np.sin(angle / 2)
        assert bool(in_corner(made)) == there


def test_an_object_is_wedged_after_256_pushes_in_a_corner_until_it_leaves_it() -> None:
    one, corner = watch(), (0.58, 1.0)
    found = []
    for step in range(1, CORNER_PUSHES):
        found += one.push(states(agent=(0.0, 0.1 * step), light_0=corner), step)
    assert found == []
    found = one.push(states(agent=(0.0, 0.0), light_0=corner, heavy_3=corner), 256)
    assert [(turn.kind, turn.name, turn.began, turn.position) for turn in found] == [
        ("corner", "light_0", True, (*corner, 0.0))
    ]
    assert one.wedged == ["light_0"]
    assert [turn.name for turn in one.leave(states(light_0=corner), 300)] == ["light_0"]
    found = one.push(states(agent=(0.1, 0.0), light_0=(0.4, 1.0), heavy_3=corner), 257)
    assert [(turn.name, turn.began, turn.position) for turn in found] == [("light_0", False, (0.4, 1.0, 0.0))]
    assert one.cornered == {"heavy_3": 2}
    assert one.leave(states(light_0=corner), 300) == []
