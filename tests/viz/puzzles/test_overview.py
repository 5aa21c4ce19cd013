"""Results of all puzzles of a task: numbers are those of the scores, colours follow from them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.results.metrics import a_success, mean_return_within
from gym_open.viz import viewers
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.puzzles import view
from gym_open.viz.puzzles.tables import TaskTable, commands, read_tables

DARK, YELLOW, ORANGE = (0, 34, 78), (254, 232, 56), (213, 94, 0)


@pytest.fixture(scope="module")
def table(scores: Any, others: Any) -> TaskTable:
    (found,) = read_tables([scores.path, others.path])
    return found


@pytest.fixture(scope="module")
def recording(
    scores: Any, others: Any, tmp_path_factory: pytest.TempPathFactory, read_back: Callable[[Path], Any]
) -> Any:
    found = view(VizConfig(), [scores.path, others.path], Choice())
    return read_back(viewers.save(found, tmp_path_factory.mktemp("view") / "overview.rrd"))


def padded(rewards: list[list[float]]) -> np.ndarray:
    return np.array([row + [0.0] * (100 - len(row)) for row in rewards])


def test_tables_hold_what_was_earned_and_how_it_ended(table: TaskTable, scores: Any, others: Any) -> None:
    first, second = table.agents
    np.testing.assert_array_equal(first.run.returns, padded(scores.rewards).cumsum(axis=1))
    assert first.solved.tolist() == [True, False, False]
    assert first.in_danger.tolist() == [False, False, True]
    assert second.solved.tolist() == [False, True]
    values = [[a_success(np.cumsum(row)) for row in padded(each.rewards)] for each in (scores, others)]
    means = {
        "avoidance/000": (values[0][0] + values[1][0]) / 2,
        "avoidance/001": (values[0][1] + values[1][1]) / 2,
        "avoidance/002": values[0][2],
    }
    assert table.hardest == sorted(means, key=lambda item: means[item])
    assert table.hardest[0] == "avoidance/002"
    assert table.difficulty == pytest.approx(sorted(means.values()))


def test_a_part_of_the_return_is_no_solution(half_way: Any) -> None:
    (found,) = read_tables([half_way.path])
    (agent,) = found.agents
    assert agent.solved.tolist() == [True, False]
    assert agent.run.returns[0, -1] == pytest.approx(1.0)
    assert agent.run.returns[1, -1] in (0.2, 0.8)  # what the yellow and the green goal pay
    assert agent.outcomes()[1].startswith("not solved in ")


def test_the_curve_is_the_mean_return_within_i_actions(recording: Any, scores: Any, others: Any) -> None:
    assert "actions" in recording.timelines()
    for number, each in enumerate((scores, others)):
        steps, values = recording.column(f"/avoidance/within/{number}", "Scalars:scalars", "actions")
        assert steps == list(range(1, 101))
        np.testing.assert_allclose(np.ravel(values), mean_return_within(padded(each.rewards)))


def test_dots_show_what_was_earned_within_i_actions(recording: Any, scores: Any) -> None:
    steps, colours = recording.column("/avoidance/puzzles/0", "Points2D:colors", "actions")
    rgb = [[((dot >> 24) & 255, (dot >> 16) & 255, (dot >> 8) & 255) for dot in dots] for dots in colours]
    solved_at, failed_at = len(scores.actions[0]), len(scores.actions[2])
    for step, dots in zip(steps, rgb, strict=True):
        assert dots[0] == (YELLOW if step >= solved_at else DARK)
        assert dots[1] == DARK
        assert dots[2] == (ORANGE if step >= failed_at else DARK)
    labels = recording.static("/avoidance/puzzles/0", "Points2D:labels")
    assert labels[0] == f"avoidance/000: solved in {solved_at}, return 1"


def test_commands_open_the_hardest_puzzles_with_the_best_agents(table: TaskTable, recording: Any) -> None:
    lines = commands(table)
    assert [line.rsplit(" ", 1)[1] for line in lines] == table.hardest
    best = sorted(table.agents, key=lambda agent: -agent.run.record.a_success)
    assert lines[0].startswith(f"gym-open viz {best[0].path} {best[1].path} --puzzle ")
    text = recording.static("/avoidance/about", "TextDocument:text")[0]
    assert lines[0] in text
    assert "| avoidance/002 | 0.000 | 0 of 1 |" in text


def test_agents_of_one_name_are_told_apart(scores: Any, tmp_path: Path) -> None:
    twins = [tmp_path / name for name in ("a", "b")]
    for twin in twins:
        twin.symlink_to(scores.path)
    (found,) = read_tables(twins)
    assert len({agent.name for agent in found.agents}) == 2
    assert artefacts.digest(twins[0]) == artefacts.digest(twins[1])
