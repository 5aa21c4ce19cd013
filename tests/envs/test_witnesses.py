"""Every fixed puzzle can be solved, by a replay of its witness; and the report for people."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console, RenderableType

from gym_open.envs import make_witnesses, puzzle_report
from gym_open.envs.constants import PEN_HALF, cell_centre
from gym_open.envs.env import OpenEnv
from gym_open.envs.planner import is_robust
from gym_open.envs.puzzle_report import show, verify
from gym_open.envs.puzzles import TASKS, Placement, Puzzle, PuzzleError, Task, arranged
from gym_open.envs.puzzles.sets import SPLITS, data_file, published_digests, puzzle_by_id, puzzles_of
from gym_open.envs.puzzles.witnesses import Witness, witness_name, witness_of, witnesses_of
from gym_open.envs.world import World

SETS = list(itertools.product(TASKS, SPLITS))


def printed(what: RenderableType) -> str:
    console = Console(width=80, color_system=None)
    with console.capture() as capture:
        console.print(what)
    return capture.get()


@pytest.mark.parametrize("task", TASKS)
def test_every_witness_earns_the_whole_return(task: Task) -> None:
    """In the environment that policies use."""
    env = OpenEnv(task)
    for split in SPLITS:
        for puzzle, witness in zip(puzzles_of(task, split), witnesses_of(task, split), strict=True):
            env.reset(options={"puzzle": puzzle})
            earned, terminated = 0.0, False
            for action in witness.actions:
                assert not terminated, witness.puzzle
                _, reward, terminated, truncated, _ = env.step(action)
                earned += reward
                assert not truncated
            assert terminated, witness.puzzle
            assert earned == pytest.approx(1.0), witness.puzzle


def test_witnesses_name_their_puzzles() -> None:
    for task, split in SETS:
        for witness in witnesses_of(task, split):
            assert witness.digest == puzzle_by_id(witness.puzzle).digest
            assert witness_of(witness.puzzle) is witness
    assert {witness_name(task, split) for task, split in SETS} <= set(published_digests())


@pytest.mark.slow
def test_witnesses_survive_small_shifts() -> None:
    world = World()
    for task, split in SETS:
        for puzzle, witness in zip(puzzles_of(task, split), witnesses_of(task, split), strict=True):
            assert is_robust(world, puzzle, witness.actions), witness.puzzle


@pytest.mark.slow
def test_the_planner_finds_the_same_witnesses_again(tmp_path: Path) -> None:
    make_witnesses.main(tmp_path)
    for task, split in SETS:
        name = witness_name(task, split)
        assert (tmp_path / name).read_bytes() == data_file(name).read_bytes()


def test_the_check_lists_every_set() -> None:
    lines = printed(verify()).splitlines()
    for task, split in SETS:
        (line,) = (line for line in lines if f" {task} {split} " in line)
        assert "100/100" in line
        assert published_digests()[witness_name(task, split)][:12] in line


def test_a_changed_file_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = published_digests() | {"tool-use-test.jsonl": "0" * 64}
    monkeypatch.setattr(puzzle_report, "published_digests", lambda: changed)
    with pytest.raises(PuzzleError, match=r"puzzles/data/tool-use-test.jsonl: missing, or not as in digests.json"):
        verify()


def test_a_witness_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def worse(task: Task, split: str) -> tuple[Witness, ...]:
        first, *others = witnesses_of(task, split)  # pyright: ignore[reportArgumentType]
        return Witness(first.puzzle, first.digest, first.actions[:-1]), *others

    monkeypatch.setattr(puzzle_report, "witnesses_of", worse)
    with pytest.raises(PuzzleError, match="1 witnesses fail, the first is goal-seeking/000"):
        verify()


def test_show_prints_map_digest_and_witness() -> None:
    name = "tool-use/validation/003"
    text = printed(show(name))
    puzzle = puzzle_by_id(name)
    assert puzzle.digest in text
    assert str(witness_of(name).actions).replace(",", "")[1:-1] in text
    with pytest.raises(PuzzleError, match="ids are"):
        show("tool-use/xyz")


def test_the_map_shows_every_object_on_its_cell() -> None:
    objects = [("agent", 1, 1), ("yellow", 2, 2), ("cone", 14, 7), ("stack", 9, 4), ("mesh:duck", 10, 1)]
    layout = arranged([*(Placement(*item) for item in objects), Placement("rectangle", 5, 4, turned=True)])
    rows = printed(puzzle_report.cell_map(Puzzle("sandbox", layout))).splitlines()[1:17]
    shown = {(i, j): sign for i, row in enumerate(rows) for j, sign in enumerate(row[4:].split()) if sign != "·"}
    assert shown == {(1, 1): "A", (2, 2): "Y", (14, 7): "C", (9, 4): "S", (10, 1): "M"} | {
        (i, 4): "R" for i in (4, 5, 6)
    }


def test_no_pen_is_left_without_its_ramp() -> None:
    """Even a planner that may try all actions leaves a pen only over the ramp."""
    world = World()
    for split in SPLITS:
        for puzzle, witness in zip(puzzles_of("tool-use", split), witnesses_of("tool-use", split), strict=True):
            world.load(puzzle)
            assert puzzle.pen
            centre = np.array(cell_centre(puzzle.pen.row, puzzle.pen.column))
            climbed = False
            for action in witness.actions:
                touched = {name for contact in world.step(action).contacts for name in (contact.a, contact.b)}
                climbed = climbed or not touched.isdisjoint({"ramp_slope", "ramp_platform"})
                if np.abs(world.data.qpos[:2] - centre).max() > PEN_HALF:
                    break
            assert climbed, witness.puzzle
