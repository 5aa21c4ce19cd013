"""Puzzles, generators and the fixed test sets."""

import itertools

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.config import load
from gym_open.envs import generators, puzzles
from gym_open.envs.generators import SandboxConfig, sample_puzzle
from gym_open.envs.make_puzzle_sets import set_bytes
from gym_open.envs.puzzle_sets import (
    SPLITS,
    actual_digests,
    data_file,
    locate,
    published_digests,
    puzzle_by_id,
    puzzle_id,
    puzzles_of,
    reserved_digests,
    set_name,
)
from gym_open.envs.puzzle_sets import test_puzzles as fixed_puzzles
from gym_open.envs.puzzles import TASKS, Patch, Pen, Placement, Puzzle, PuzzleError, Task, arranged
from gym_open.errors import ConfigError

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
seeds = st.integers(0, 2**32)


def cells_of(puzzle: Puzzle, *kinds: str) -> list[tuple[int, int]]:
    return [(item.row, item.column) for item in puzzle.objects if item.kind in kinds]


def assert_well_laid(puzzle: Puzzle) -> None:
    cells = cells_of(puzzle, *puzzles.KINDS)
    assert len(set(cells)) == len(cells)
    assert all(1 <= i <= 14 and 1 <= j <= 7 for i, j in cells)
    cubes = cells_of(puzzle, "heavy", "light")
    assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) > 1 for a, b in itertools.combinations(cubes, 2))
    if puzzle.patch:
        centre = (puzzle.patch.row, puzzle.patch.column)
        assert 3 <= centre[0] <= 12
        assert 3 <= centre[1] <= 5
        assert all(max(abs(i - centre[0]), abs(j - centre[1])) > 1 for i, j in cells)
    if puzzle.pen:
        centre = (puzzle.pen.row, puzzle.pen.column)
        rings = [max(abs(i - centre[0]), abs(j - centre[1])) for i, j in cells]
        assert 2 not in rings
        assert rings[0] == 1  # the agent comes first, inside and off the ramp's foot


@settings(max_examples=60, deadline=None)
@given(seed=seeds, task=st.sampled_from(ALL_TASKS))
def test_generated_layouts_keep_the_rules(seed: int, task: Task) -> None:
    puzzle = sample_puzzle(task, np.random.default_rng(seed))
    assert puzzle.task == task
    assert_well_laid(puzzle)
    assert Puzzle.from_json(puzzle.to_json()) == puzzle
    assert sample_puzzle(task, np.random.default_rng(seed)) == puzzle


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_recipes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = {"goal-seeking": (5, 8), "avoidance": (3, 6), "tool-use": (3, 6)}
    for task in TASKS:
        puzzle = sample_puzzle(task, rng)
        cubes = cells_of(puzzle, "heavy", "light")
        if task in counts:
            assert counts[task][0] <= len(cubes) <= counts[task][1]
        assert (puzzle.pen is not None) == (task == "tool-use")
        assert (puzzle.patch is not None) == (task == "avoidance")
        if task == "preferences":
            (agent,), (yellow,), (green,) = (cells_of(puzzle, kind) for kind in ("agent", "yellow", "green"))
            there = np.subtract(yellow, agent)
            assert np.array_equal(there, -np.subtract(green, agent))
            assert 0 in there
            assert 2 <= np.abs(there).max() <= 5
        if task == "tool-use":
            assert puzzle.pen
            assert cells_of(puzzle, "yellow")[0] not in puzzles.block(puzzle.pen.row, puzzle.pen.column, 2)


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_sandbox_goals_lie_near_the_agent_off_its_row_and_column(seed: int) -> None:
    config = SandboxConfig(yellow=(1, 3), green=(0, 2), radius=4, patch_probability=0.5, pen_probability=0.5)
    puzzle = sample_puzzle("sandbox", np.random.default_rng(seed), config)
    (agent,) = cells_of(puzzle, "agent")
    for i, j in cells_of(puzzle, "yellow", "green"):
        assert max(abs(i - agent[0]), abs(j - agent[1])) <= 4
        assert i != agent[0]
        assert j != agent[1]


@pytest.mark.parametrize(("task", "original"), [("goal-seeking", 0.783), ("preferences", 0.450), ("avoidance", 0.798)])
def test_mean_distance_to_the_goal_is_the_originals(task: Task, original: float) -> None:
    rng = np.random.default_rng(1)
    distances: list[float] = []
    for _ in range(1000):
        puzzle = sample_puzzle(task, rng)
        offset = np.subtract(cells_of(puzzle, "agent")[0], cells_of(puzzle, "yellow")[0])
        distances.append(float(np.hypot(*offset)) * 0.141)
    assert np.mean(distances) == pytest.approx(original, rel=0.06)


def test_sandbox_pool_is_varied() -> None:
    rng = np.random.default_rng(0)
    pool = [sample_puzzle("sandbox", rng) for _ in range(200)]
    assert len({puzzle.digest for puzzle in pool}) == 200
    assert 25 <= sum(puzzle.pen is not None for puzzle in pool) <= 75
    assert 25 <= sum(puzzle.patch is not None for puzzle in pool) <= 75


def test_fixed_sets_are_reproducible_distinct_and_as_published() -> None:
    made = set_bytes()
    for task, split in itertools.product(TASKS, SPLITS):
        name = set_name(task, split)
        assert data_file(name).read_bytes() == made[name]
        for puzzle in puzzles_of(task, split):
            assert puzzle.task == task
            assert_well_laid(puzzle)
    assert len(reserved_digests()) == 800
    assert published_digests() == actual_digests()
    assert set(made) <= set(published_digests())


def test_test_sets_are_those_of_version_1() -> None:
    first = {
        "avoidance": "f6a41c13cbe05bc7",
        "goal-seeking": "90b2157ee23e417d",
        "preferences": "e9fdaedbba45de14",
        "tool-use": "bf478249216fdab6",
    }
    assert {task: published_digests()[set_name(task, "test")][:16] for task in TASKS} == first


def test_ids_name_the_fixed_puzzles() -> None:
    assert puzzle_by_id("tool-use/017") == fixed_puzzles("tool-use")[17]
    assert puzzle_by_id("avoidance/validation/099") == puzzles_of("avoidance", "validation")[99]
    for task, split, index in itertools.product(TASKS, SPLITS, (0, 42)):
        assert locate(puzzle_id(task, split, index)) == (task, split, index)


@pytest.mark.parametrize(
    "name", ["tool-use", "tool-use/17", "tool-use/100", "sandbox/000", "tool-use/train/000", "tool-use/-01", "/", ""]
)
def test_unknown_ids_are_refused_with_their_form(name: str) -> None:
    with pytest.raises(PuzzleError, match="ids are TASK/000 to TASK/099"):
        puzzle_by_id(name)


def test_training_never_draws_a_test_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    drawn = {sample_puzzle(task, rng).digest for task in ALL_TASKS for _ in range(1500)}
    assert drawn.isdisjoint(reserved_digests())
    # And not by luck alone: a generator that meets a reserved layout draws again.
    first, second = (sample_puzzle("avoidance", np.random.default_rng(s)) for s in (1, 2))
    draws = iter([first, second])
    monkeypatch.setattr(generators, "reserved_digests", lambda: frozenset({first.digest}))
    monkeypatch.setattr(generators, "draw_layout", lambda *_: next(draws))
    assert sample_puzzle("avoidance", rng) == second


def test_no_test_set_for_the_sandbox() -> None:
    with pytest.raises(PuzzleError, match="no test set for 'sandbox'"):
        fixed_puzzles("sandbox")


def test_digest_is_of_the_layout_alone() -> None:
    puzzle = fixed_puzzles("goal-seeking")[0]
    assert msgspec.structs.replace(puzzle, task="sandbox").digest == puzzle.digest
    assert msgspec.structs.replace(puzzle, objects=puzzle.objects[:-1]).digest != puzzle.digest


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (SandboxConfig(heavy=(30, 30)), "at most 12 fit the model, got 30"),
        (SandboxConfig(yellow=(3, 1)), "smallest ≤ largest"),
        (SandboxConfig(yellow=(3, 3), green=(3, 3), radius=1), "no sandbox layout found"),
    ],
)
def test_impossible_requests_are_refused(config: SandboxConfig, message: str) -> None:
    with pytest.raises(PuzzleError, match=message):
        sample_puzzle("sandbox", np.random.default_rng(0), config)


pairs = st.tuples(st.integers(0, 6), st.integers(0, 12)).map(lambda pair: (min(pair), max(pair)))


@settings(max_examples=40, deadline=None)
@given(
    seed=seeds, yellow=pairs, green=pairs, heavy=pairs, light=pairs, radius=st.integers(1, 15), share=st.floats(0, 1)
)
def test_any_request_is_met_or_refused(seed: int, share: float, **request) -> None:
    config = SandboxConfig(**request, pen_probability=share, patch_probability=1 - share)
    try:
        puzzle = sample_puzzle("sandbox", np.random.default_rng(seed), config)
    except PuzzleError:
        return
    assert_well_laid(puzzle)
    for kind in ("yellow", "green", "heavy", "light"):
        assert request[kind][0] <= len(cells_of(puzzle, kind)) <= request[kind][1]


def test_sandbox_config_reads_toml(tmp_path) -> None:
    file = tmp_path / "sandbox.toml"
    file.write_text("yellow = [1, 3]\n")
    assert load(file, SandboxConfig).yellow == (1, 3)
    file.write_text("yellow = [-1, 3]\n")
    with pytest.raises(ConfigError, match="yellow"):
        load(file, SandboxConfig)


AGENT = Placement("agent", 8, 4)


@pytest.mark.parametrize(
    ("objects", "pieces", "message"),
    [
        ([AGENT, Placement("heavy", 8, 4)], {}, "two objects on cell"),
        ([Placement("heavy", 8, 4)], {}, "exactly one object of kind 'agent'"),
        ([AGENT, *(Placement("yellow", 1, j) for j in range(4))], {}, "the model holds 3"),
        ([AGENT], {"patch": Patch(0, 4)}, "sticks out"),
        ([AGENT], {"pen": Pen(8, 4, "north")}, "where the pen's wall or ramp stands"),
        ([AGENT], {"task": "goal-seeking"}, "needs an object of kind 'yellow'"),
        ([AGENT, Placement("yellow", 1, 1)], {"task": "avoidance"}, "needs a patch"),
        ([AGENT, Placement("yellow", 1, 1)], {"task": "tool-use"}, "needs a pen"),
    ],
)
def test_impossible_puzzles_are_refused(objects: list[Placement], pieces: dict, message: str) -> None:
    with pytest.raises(PuzzleError, match=message):
        Puzzle(**{"task": "sandbox", "objects": arranged(objects), **pieces})


def test_unsorted_and_malformed_records_are_refused() -> None:
    with pytest.raises(PuzzleError, match="canonical order"):
        Puzzle(task="sandbox", objects=(Placement("heavy", 1, 1), AGENT))
    good = fixed_puzzles("tool-use")[0].to_json().decode()
    for bad in (good.replace('"row":', '"rwo":', 1), good.replace("tool-use", "tool"), good[:-5], "[]"):
        with pytest.raises(PuzzleError):
            Puzzle.from_json(bad)
    with pytest.raises(PuzzleError, match="row"):
        Puzzle.from_json(good.replace('"row":', '"row":1', 1))
