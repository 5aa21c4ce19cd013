"""The paper's `puzzle_config`: the effect of every key, and refusals of impossible values."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.envs import puzzles
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.puzzle_config import PuzzleConfig, from_puzzle_config
from gym_open.envs.puzzles.sets import published_digests, puzzle_by_id
from gym_open.errors import ConfigError, GymOpenError

KINDS_OF = {
    "main_sphere": ("agent",),
    "touch_sphere": ("yellow",),
    "high_value_target": ("green",),
    "cube": ("heavy", "light"),
    "push_sphere": ("push",),
    "rectangle": ("rectangle",),
    "cone": ("cone",),
    "stack": ("stack",),
}
PAPERS = {"main_sphere": 1, "main_sphere_i_j": [(8, 4)], "touch_sphere": 2, "cube": 2, "high_value_target": 1}


def draw(config: dict, seed: int = 0) -> Puzzle:
    return from_puzzle_config(config, np.random.default_rng(seed))


def count(puzzle: Puzzle, key: str) -> int:
    return sum(item.kind in KINDS_OF[key] for item in puzzle.objects)


def cells(puzzle: Puzzle, kind: str) -> list[tuple[int, int]]:
    return [(item.row, item.column) for item in puzzle.objects if item.kind == kind]


def test_the_papers_example() -> None:
    puzzle = draw(PAPERS)
    assert puzzle.task == "sandbox"
    assert cells(puzzle, "agent") == [(8, 4)]
    assert {key: count(puzzle, key) for key in ("touch_sphere", "cube", "high_value_target")} == {
        "touch_sphere": 2,
        "cube": 2,
        "high_value_target": 1,
    }
    assert len(puzzle.objects) == 6
    assert draw(PAPERS) == puzzle
    assert draw(PAPERS, seed=1) != puzzle


def test_an_empty_request_gives_only_an_agent() -> None:
    assert [item.kind for item in draw({}).objects] == ["agent"]


def test_every_key_of_the_supplement_is_known() -> None:
    supplement = (
        "main_sphere touch_sphere high_value_target cube push_sphere rectangle cone adversarial_patch stack ramp "
        "main_sphere_i_j touch_sphere_i_j radius"
    )
    assert set(supplement.split()) == set(PuzzleConfig.__struct_fields__)


def test_everything_at_once() -> None:
    full = {"main_sphere": 1, "touch_sphere": 3, "high_value_target": 3, "cube": 12, "push_sphere": 2, "rectangle": 2}
    full |= {"cone": 2, "adversarial_patch": 1, "stack": 4, "ramp": 1, "radius": 6}
    puzzle = draw(full)
    assert {key: count(puzzle, key) for key in KINDS_OF} == {key: full[key] for key in KINDS_OF}
    assert puzzle.pen
    assert puzzle.patch
    ((agent),) = cells(puzzle, "agent")
    assert agent in puzzles.block(puzzle.pen.row, puzzle.pen.column, 1)


def test_cubes_are_heavy_or_light_with_probability_a_half_as_far_as_there_are_enough() -> None:
    heavy = [len(cells(draw({"cube": 6}, seed), "heavy")) for seed in range(200)]
    assert np.mean(heavy) == pytest.approx(3, abs=4 * np.sqrt(1.5 / 200))
    assert len(set(heavy)) > 4
    for seed in range(20):
        assert len(cells(draw({"cube": 20}, seed), "heavy")) == 12
        assert len(cells(draw({"cube": 12, "stack": 4}, seed), "light")) == 0


def test_goals_are_on_the_requested_cells() -> None:
    config = {"main_sphere_i_j": [(8, 4)], "touch_sphere": 3, "touch_sphere_i_j": [(1, 1), [8, 5]], "radius": 2}
    for seed in range(20):
        yellow = cells(draw(config, seed), "yellow")
        (drawn,) = set(yellow) - {(1, 1), (8, 5)}
        assert 1 <= abs(drawn[0] - 8) <= 2
        assert 1 <= abs(drawn[1] - 4) <= 2
    assert cells(draw({"touch_sphere_i_j": [(3, 3)]}), "yellow") == [(3, 3)]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"cube": 30}, "key `cube`: expected `int` <= 20, got 30"),
        ({"cube": -1}, "key `cube`: expected `int` >= 0, got -1"),
        ({"cube": 2.5}, "key `cube`: expected `int`, got `float`, got 2.5"),
        ({"cube": 20, "stack": 1}, "cube is 20, but with 1 stacks at most 18 are left"),
        ({"main_sphere": 2}, "key `main_sphere`: expected `int` <= 1, got 2"),
        ({"main_sphere": 0}, "key `main_sphere`: expected `int` >= 1, got 0"),
        ({"main_sphere_i_j": [(8, 4), (9, 4)]}, "key `main_sphere_i_j`: expected `array` of length <= 1"),
        ({"main_sphere_i_j": [(8, 9)]}, "key `main_sphere_i_j.0.1`: expected `int` <= 8, got 9"),
        ({"main_sphere_i_j": [(0, 0)]}, "cut off by the table's corner"),
        ({"main_sphere_i_j": [(8, 4)], "touch_sphere_i_j": [(8, 4)]}, r"two objects on cell \(8, 4\)"),
        ({"main_sphere_i_j": [(1, 1)], "ramp": 1}, "no pen has cell .1, 1. inside; choose a cell of rows 2 to 13"),
        ({"touch_sphere": 1, "touch_sphere_i_j": [(1, 1), (2, 2)]}, "touch_sphere is 1, but there are 2 cells"),
        ({"touch_sphere": 3, "high_value_target": 3, "radius": 1}, "radius is 1, so at most 4 goal spheres fit"),
        ({"touch_sphere": 3, "high_value_target": 1, "radius": 1, "ramp": 1}, "no sandbox layout found"),
        ({"ramp": 2}, "key `ramp`: expected `int` <= 1, got 2"),
        ({"adversarial_patch": 2}, "key `adversarial_patch`: expected `int` <= 1, got 2"),
        ({"radius": 0}, "key `radius`: expected `int` >= 1, got 0"),
        ({"cubes": 3}, "unknown key `cubes`; did you mean `cube`"),
    ],
)
def test_an_impossible_request_is_refused_with_key_and_value(config: dict, message: str) -> None:
    with pytest.raises(GymOpenError, match=message) as refusal:
        draw(config)
    assert "puzzle_config" in str(refusal.value)


cell = st.tuples(st.integers(0, 15), st.integers(0, 8))
full_config = st.fixed_dictionaries(
    {},
    optional={key: st.integers(0, 2) for key in KINDS_OF if key not in ("cube", "main_sphere")}
    | {"main_sphere": st.just(1), "cube": st.integers(0, 21), "stack": st.integers(0, 4)}
    | {"ramp": st.integers(0, 1), "adversarial_patch": st.integers(0, 1)}
    | {"main_sphere_i_j": st.lists(cell, max_size=1), "touch_sphere_i_j": st.lists(cell, max_size=3)}
    | {"radius": st.integers(1, 15)},
)


@settings(max_examples=80)
@given(seed=st.integers(0, 2**32), config=full_config)
def test_any_dictionary_is_met_exactly_or_refused(seed: int, config: dict) -> None:
    try:
        puzzle = draw(config, seed)
    except GymOpenError:
        return
    for key in set(config) & set(KINDS_OF):
        assert count(puzzle, key) == config[key]
    assert (puzzle.pen is not None) == bool(config.get("ramp"))
    assert (puzzle.patch is not None) == bool(config.get("adversarial_patch"))
    if config.get("main_sphere_i_j"):
        assert cells(puzzle, "agent") == [tuple(config["main_sphere_i_j"][0])]
    assert set(config.get("touch_sphere_i_j", [])) <= set(cells(puzzle, "yellow"))


def test_a_dictionary_with_strange_keys_is_refused() -> None:
    with pytest.raises(ConfigError):
        draw({"cube": "two"})


PAGE = (Path(__file__).parents[2] / "docs/puzzles.md").read_text()


def test_the_page_names_every_key() -> None:
    section = PAGE.split("## The paper's `puzzle_config`")[1].split("## ")[0]
    assert set(PuzzleConfig.__struct_fields__) <= set(re.findall(r"`(\w+)`", section))


def test_the_page_shows_the_digests_and_a_record_as_they_are() -> None:
    for name, digest in published_digests().items():
        assert f"`{digest[:16]}…`" in PAGE, name
    (shown,) = re.findall(r"```json\n(.*?)\n```", PAGE, re.DOTALL)
    assert shown.replace("\n", "") == puzzle_by_id("tool-use/017").to_json().decode()


def test_a_refused_request_leaves_the_generator_unchanged() -> None:
    rng, untouched = np.random.default_rng(5), np.random.default_rng(5)
    with pytest.raises(GymOpenError):
        from_puzzle_config({"cube": 3, "ramp": 1, "main_sphere_i_j": [(1, 1)]}, rng)
    assert rng.integers(1 << 60) == untouched.integers(1 << 60)
