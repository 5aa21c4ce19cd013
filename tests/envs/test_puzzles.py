"""Puzzles, generators and the fixed test sets."""

import hashlib
import itertools

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open import seeding
from gym_open.config import load
from gym_open.envs import puzzles
from gym_open.envs.puzzles import TASKS, Patch, Pen, Placement, Puzzle, PuzzleError, Task, arranged, generators
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzles.make_sets import SEED, set_bytes
from gym_open.envs.puzzles.sets import (
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
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.errors import ConfigError

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
seeds = st.integers(0, 2**32)


def cells_of(puzzle: Puzzle, *kinds: str) -> list[tuple[int, int]]:
    return [(item.row, item.column) for item in puzzle.objects if item.kind in kinds]


def assert_well_laid(puzzle: Puzzle) -> None:
    """Check the rules from the drawn record, with an independent computation of rectangles' cells."""
    cells: list[tuple[int, int]] = []
    for item in puzzle.objects:
        reach = (-1, 0, 1) if item.kind == "rectangle" else (0,)
        cells += [(item.row + k, item.column) if item.turned else (item.row, item.column + k) for k in reach]
    assert len(set(cells)) == len(cells)
    assert all(1 <= i <= 14 and 1 <= j <= 7 for i, j in cells)
    cubes = cells_of(puzzle, "heavy", "light", "stack")
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
        assert rings[0] == 1  # the agent is first in the list, and is inside, not on the ramp's foot


@settings(max_examples=60)
@given(seed=seeds, task=st.sampled_from(ALL_TASKS))
def test_generated_layouts_keep_the_rules(seed: int, task: Task) -> None:
    puzzle = sample_puzzle(task, np.random.default_rng(seed))
    assert puzzle.task == task
    assert_well_laid(puzzle)
    assert Puzzle.from_json(puzzle.to_json()) == puzzle
    assert sample_puzzle(task, np.random.default_rng(seed)) == puzzle


@settings(max_examples=40)
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


@settings(max_examples=40)
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


@pytest.mark.parametrize("draws", [1000, pytest.param(20_000, marks=pytest.mark.slow)])
def test_training_never_draws_a_fixed_layout(draws: int) -> None:
    rng = np.random.default_rng(7)
    for task in ALL_TASKS:
        drawn = {sample_puzzle(task, rng).digest for _ in range(draws)}
        assert len(drawn) > 0.99 * draws
        assert drawn.isdisjoint(reserved_digests())


def test_a_generator_that_meets_a_fixed_layout_draws_again(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (sample_puzzle("avoidance", np.random.default_rng(s)) for s in (1, 2))
    draws = iter([first, second])
    monkeypatch.setattr(generators, "reserved_digests", lambda: frozenset({first.digest}))
    monkeypatch.setattr(generators, "draw_layout", lambda *_: next(draws))
    assert sample_puzzle("avoidance", np.random.default_rng(0)) == second


def test_fixed_layouts_are_drawn_again_as_they_were() -> None:
    """With the seeds that made the sets, a training draw finds a layout of the sets, and excludes it."""
    rng = seeding.generator(SEED, "validation-puzzles", "tool-use")
    assert generators.draw_layout("tool-use", rng) == puzzle_by_id("tool-use/validation/000")
    rng = seeding.generator(SEED, "validation-puzzles", "tool-use")
    assert sample_puzzle("tool-use", rng).digest not in reserved_digests()


def test_no_test_set_for_the_sandbox() -> None:
    with pytest.raises(PuzzleError, match="no test set for 'sandbox'"):
        fixed_puzzles("sandbox")


def test_the_digest_covers_only_the_layout() -> None:
    puzzle = fixed_puzzles("goal-seeking")[0]
    assert msgspec.structs.replace(puzzle, task="sandbox").digest == puzzle.digest
    assert msgspec.structs.replace(puzzle, objects=puzzle.objects[:-1]).digest != puzzle.digest


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (SandboxConfig(heavy=(30, 30)), "at most 12 fit the model, got 30"),
        (SandboxConfig(yellow=(3, 1)), "smallest ≤ largest"),
        (SandboxConfig(stack=(4, 4), light=(1, 1)), "sandbox.stack: 4 stacks of 2 and 1 more light cubes"),
        (SandboxConfig(push=(3, 3)), "sandbox.push: at most 2"),
        (
            SandboxConfig(yellow_cells=((8, 4), (8, 5))),
            "yellow_cells: 2 cells, but the least number",
        ),
        (SandboxConfig(agent_cell=(8, 4), yellow_cells=((8, 4),)), r"two objects on cell \(8, 4\)"),
        (SandboxConfig(agent_cell=(0, 8)), "cut off by the table's corner"),
        (SandboxConfig(agent_cell=(1, 4), pen_probability=1), "no pen has cell .1, 4. inside"),
        (SandboxConfig(agent_cell=(16, 4), pen_probability=0), "Expected `int` <= 15 - at .*row"),
        (SandboxConfig(meshes=("no name",)), "no kind 'mesh:no name'"),
        (SandboxConfig(yellow=(3, 3), green=(3, 3), radius=1), "no sandbox layout found"),
    ],
)
def test_impossible_requests_are_refused(config: SandboxConfig, message: str) -> None:
    with pytest.raises(PuzzleError, match=message):
        sample_puzzle("sandbox", np.random.default_rng(0), config)


pairs = st.tuples(st.integers(0, 6), st.integers(0, 12)).map(lambda pair: (min(pair), max(pair)))
few = st.tuples(st.integers(0, 3), st.integers(0, 2)).map(lambda pair: (min(pair), max(pair)))
requests = st.fixed_dictionaries(
    {"yellow": pairs, "green": pairs, "heavy": pairs, "light": pairs}
    | {"push": few, "rectangle": few, "cone": few, "stack": few, "radius": st.integers(1, 15)}
)
cells = st.tuples(st.integers(0, 15), st.integers(0, 8))


@settings(max_examples=60)
@given(seed=seeds, share=st.floats(0, 1), request=requests, meshes=st.lists(st.sampled_from(["duck", "bunny-2"])))
def test_any_request_is_met_or_refused(seed: int, share: float, request: dict, meshes: list[str]) -> None:
    config = SandboxConfig(**request, meshes=tuple(meshes), pen_probability=share, patch_probability=1 - share)
    try:
        puzzle = sample_puzzle("sandbox", np.random.default_rng(seed), config)
    except PuzzleError:
        return
    assert_well_laid(puzzle)
    assert Puzzle.from_json(puzzle.to_json()) == puzzle
    for kind in set(request) - {"radius"}:
        assert request[kind][0] <= len(cells_of(puzzle, kind)) <= request[kind][1]
    for name in meshes:
        assert len(cells_of(puzzle, f"mesh:{name}")) == meshes.count(name)


@settings(max_examples=60)
@given(seed=seeds, agent=cells, yellow=st.lists(cells, max_size=3), pen=st.booleans(), patch=st.booleans())
def test_fixed_cells_are_kept(
    seed: int, agent: tuple[int, int], yellow: list[tuple[int, int]], pen: bool, patch: bool
) -> None:
    config = SandboxConfig(
        yellow=(len(yellow), 3),
        agent_cell=agent,
        yellow_cells=tuple(yellow),
        pen_probability=float(pen),
        patch_probability=float(patch),
    )
    try:
        puzzle = sample_puzzle("sandbox", np.random.default_rng(seed), config)
    except PuzzleError:
        return
    assert cells_of(puzzle, "agent") == [agent]
    assert set(yellow) <= set(cells_of(puzzle, "yellow"))
    assert (puzzle.pen is not None, puzzle.patch is not None) == (pen, patch)
    if puzzle.pen:
        inside = puzzles.block(puzzle.pen.row, puzzle.pen.column, 1) - puzzles.ramp_cells(puzzle.pen)
        assert agent in inside


def test_draws_of_version_1_have_not_changed() -> None:
    """SHA-256 over the digests of 200 draws each: the default pipeline's pool, and training puzzles."""
    first = {"sandbox": "3bc7fa341bf6c795", "tool-use": "3fa8a9967b85b648", "avoidance": "fb5fa193bb71c971"}
    for task, expected in first.items():
        rng = np.random.default_rng(3)
        drawn = "".join(sample_puzzle(task, rng).digest for _ in range(200))  # pyright: ignore[reportArgumentType]
        assert hashlib.sha256(drawn.encode()).hexdigest()[:16] == expected


def test_rectangles_lie_along_both_axes() -> None:
    rng = np.random.default_rng(0)
    config = SandboxConfig(rectangle=(2, 2))
    turned = [
        item.turned
        for _ in range(50)
        for item in sample_puzzle("sandbox", rng, config).objects
        if item.kind == "rectangle"
    ]
    assert 25 < sum(turned) < 75


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
        ([AGENT], {"patch": Patch(0, 4)}, "partly off the table"),
        ([AGENT], {"pen": Pen(8, 4, "north")}, "where the pen's wall or ramp is"),
        ([AGENT], {"task": "goal-seeking"}, "needs an object of kind 'yellow'"),
        ([AGENT, Placement("rectangle", 8, 5)], {}, r"two objects on cell \(8, 4\)"),
        ([AGENT, Placement("rectangle", 8, 8)], {}, "'rectangle' at .8, 8. is partly off the table"),
        ([AGENT, Placement("rectangle", 0, 4, turned=True)], {}, "is partly off the table, at cell .-1, 4."),
        ([AGENT, Placement("cone", 15, 0)], {}, "is partly off the table"),
        ([AGENT, *(Placement("stack", 1, j) for j in range(1, 6))], {}, "10 objects of kind 'light' .a stack takes 2."),
        (
            [AGENT, *(Placement("push", 1, j) for j in range(1, 4))],
            {},
            "3 objects of kind 'push', but the model",
        ),
        ([AGENT, Placement("yellow", 1, 1)], {"task": "avoidance"}, "needs a patch"),
        ([AGENT, Placement("yellow", 1, 1)], {"task": "tool-use"}, "needs a pen"),
    ],
)
def test_impossible_puzzles_are_refused(objects: list[Placement], pieces: dict, message: str) -> None:
    with pytest.raises(PuzzleError, match=message):
        Puzzle(**{"task": "sandbox", "objects": arranged(objects), **pieces})


def test_a_rectangle_takes_three_cells_either_way() -> None:
    assert puzzles.footprint(Placement("rectangle", 5, 4)) == {(5, 3), (5, 4), (5, 5)}
    assert puzzles.footprint(Placement("rectangle", 5, 4, turned=True)) == {(4, 4), (5, 4), (6, 4)}
    pen = Pen(8, 4, "north")
    with pytest.raises(PuzzleError, match="where the pen's wall"):
        Puzzle("sandbox", arranged([Placement("agent", 9, 4), Placement("rectangle", 8, 7)]), pen=pen)


def test_turned_is_written_only_if_true() -> None:
    straight = Puzzle("sandbox", arranged([AGENT, Placement("rectangle", 5, 4)]))
    turned = Puzzle("sandbox", arranged([AGENT, Placement("rectangle", 5, 4, turned=True)]))
    assert b"turned" not in straight.to_json()
    assert Puzzle.from_json(turned.to_json()) == turned
    assert straight.digest != turned.digest


@pytest.mark.parametrize(("kind", "turned"), [("cube", False), ("mesh:", False), ("mesh:a b", False), ("heavy", True)])
def test_no_such_kinds(kind: str, turned: bool) -> None:
    with pytest.raises(PuzzleError, match=kind):
        Placement(kind, 1, 1, turned=turned)


def test_meshes_come_last_in_order_of_name() -> None:
    mixed = [Placement("mesh:b", 1, 1), Placement("mesh:a", 9, 1), Placement("stack", 3, 3), AGENT]
    assert [item.kind for item in arranged(mixed)] == ["agent", "stack", "mesh:a", "mesh:b"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"task": "nosuch"}, "nosuch"),
        ({"objects": (Placement("agent", 5.5, 5),)}, r"Expected `int`, got `float` - at `\$\[1\]\[0\].row`"),  # type: ignore[arg-type]
        ({"objects": (Placement("agent", 16, 5),)}, "Expected `int` <= 15"),
        ({"pen": Pen(9, 4, "up")}, "up"),  # type: ignore[arg-type]
        ({"patch": Patch(5, "4")}, "Expected `int`, got `str`"),  # type: ignore[arg-type]
    ],
)
def test_a_puzzle_built_in_python_is_checked_too(fields: dict, message: str) -> None:
    whole = {"task": "sandbox", "objects": (Placement("agent", 5, 5),)}
    with pytest.raises(PuzzleError, match=message):
        Puzzle(**(whole | fields))


def test_unsorted_and_malformed_records_are_refused() -> None:
    with pytest.raises(PuzzleError, match="canonical order"):
        Puzzle(task="sandbox", objects=(Placement("heavy", 1, 1), AGENT))
    good = fixed_puzzles("tool-use")[0].to_json().decode()
    for bad in (good.replace('"row":', '"rwo":', 1), good.replace("tool-use", "tool"), good[:-5], "[]"):
        with pytest.raises(PuzzleError):
            Puzzle.from_json(bad)
    with pytest.raises(PuzzleError, match="row"):
        Puzzle.from_json(good.replace('"row":', '"row":1', 1))
