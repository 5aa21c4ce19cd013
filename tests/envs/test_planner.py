"""Compare the planner with closed forms and with a search of all sequences."""

import itertools
import math

import numpy as np
import pytest

from gym_open.envs import planner
from gym_open.envs.planner import least_moves, plan, solves
from gym_open.envs.puzzles import Patch, Placement, Puzzle, PuzzleError, Task, arranged
from gym_open.envs.puzzles.sets import puzzle_by_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witnesses_of
from gym_open.envs.world import World

EAST, NORTH, WEST = 1, 3, 5


def laid(task: Task, *objects: tuple, patch: Patch | None = None) -> Puzzle:
    return Puzzle(task, arranged([Placement(*item) for item in objects]), patch=patch)


@pytest.fixture(scope="module")
def world() -> World:
    return World()


@pytest.mark.parametrize("offset", [(0, 1), (-3, 0), (5, 2), (-6, -3), (4, 4), (1, -2)])
def test_on_a_free_table_the_moves_are_as_many_as_the_longer_side(offset: tuple[int, int], world: World) -> None:
    i, j = offset
    found = plan(laid("goal-seeking", ("agent", 8, 4), ("yellow", 8 + i, 4 + j)), world)
    assert len(found.actions) == max(abs(i), abs(j))
    assert found.robust


def test_least_moves_by_trying_all_displacements() -> None:
    rng = np.random.default_rng(0)
    for goal in rng.uniform(-0.5, 0.5, (25, 2)):
        reached: list[bool] = []
        for moves in range(5):
            steps = np.linspace(-moves, moves, 401) * planner.REACH
            places = np.stack(np.meshgrid(steps, steps), axis=-1)
            reached.append(bool(np.linalg.norm(places - goal, axis=-1).min() <= planner.TOUCH))
        assert least_moves(np.zeros(2), goal) == reached.index(True)


@pytest.mark.parametrize("task", ["goal-seeking", "avoidance"])
def test_no_shorter_sequence_solves_it(task: Task, world: World) -> None:
    """No puzzle with a solution of four actions has one of three: all 512 sequences are tried."""
    pairs = zip(puzzles_of(task, "test"), witnesses_of(task, "test"), strict=True)
    short = [puzzle for puzzle, witness in pairs if len(witness.actions) == 4][:2]
    assert len(short) == 2
    for puzzle in short:
        assert len(plan(puzzle, world).actions) == 4
        assert not any(solves(world, puzzle, actions) for actions in itertools.product(range(1, 9), repeat=3))


def test_preferences_the_best_of_all_short_sequences(world: World) -> None:
    """Yellow is nearer, green is worth more: all sequences of three actions are tried for the best A-Success."""
    puzzle = laid("preferences", ("agent", 8, 4), ("yellow", 8, 3), ("green", 7, 6), ("heavy", 6, 3))
    found = plan(puzzle, world)
    gain = _gain(world, puzzle, found.actions)
    assert solves(world, puzzle, found.actions)
    tried = [_gain(world, puzzle, actions) for actions in itertools.product(range(1, 9), repeat=3)]
    assert gain >= max(tried)


def _gain(world: World, puzzle: Puzzle, actions: tuple[int, ...]) -> float:
    """A-Success of the sequence, by the closed form."""
    world.load(puzzle)
    gain = 0.0
    for k, action in enumerate(actions, 1):
        for name in world.step(action).hits:
            gain += {"yellow_0": 0.2, "green_0": 0.8}[name] * (1 - math.log(k) / math.log(101))
    return gain


def test_the_planner_avoids_the_danger_patch(world: World) -> None:
    puzzle = laid("avoidance", ("agent", 8, 1), ("yellow", 8, 7), patch=Patch(8, 4))
    assert not solves(world, puzzle, (EAST,) * 6)
    found = plan(puzzle, world)
    assert len(found.actions) >= 6
    world.load(puzzle)
    assert not any(world.step(action).in_danger for action in found.actions)


def test_only_the_whole_sequence_solves_it(world: World) -> None:
    puzzle = laid("goal-seeking", ("agent", 8, 4), ("yellow", 8, 6))
    assert solves(world, puzzle, (EAST, EAST))
    assert not solves(world, puzzle, (EAST,))
    assert not solves(world, puzzle, (EAST, EAST, WEST))  # continues after the end
    assert not solves(world, puzzle, ())
    assert not solves(world, puzzle, (0,) * 99 + (EAST, EAST))  # over the budget of 100


def test_a_shift_moves_the_objects(world: World) -> None:
    puzzle = laid("goal-seeking", ("agent", 8, 4), ("yellow", 8, 6))
    shift = np.zeros((len(world.inventory), 3))
    assert solves(world, puzzle, (EAST, EAST), shift)
    shift[world.inventory.index("yellow_0"), 1] = 0.2
    assert not solves(world, puzzle, (EAST, EAST), shift)


def test_the_search_is_finite(monkeypatch: pytest.MonkeyPatch, world: World) -> None:
    monkeypatch.setattr(planner, "SIMULATIONS", 3)
    with pytest.raises(PuzzleError, match=r"no solution .* found in 9 simulated steps"):
        plan(puzzle_by_id("tool-use/000"), world)


def test_the_sandbox_has_nothing_to_plan(world: World) -> None:
    with pytest.raises(PuzzleError, match="'sandbox' has no step budget"):
        plan(laid("sandbox", ("agent", 8, 4), ("yellow", 8, 6)), world)


@pytest.mark.parametrize("name", ["goal-seeking/003", "preferences/validation/004", "tool-use/005"])
def test_a_plan_is_the_same_in_a_used_world(name: str, world: World) -> None:
    assert plan(puzzle_by_id(name)) == plan(puzzle_by_id(name), world)
