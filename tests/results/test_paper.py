"""The paper's numbers: copied correctly, and found by the names of agents."""

from pathlib import Path

import pytest

from gym_open.collect.config import CollectConfig
from gym_open.config import load
from gym_open.envs.puzzles import TASKS
from gym_open.results.paper import PAPER, paper_name

ROOT = Path(__file__).parents[2]


def test_the_printed_bold_row_is_the_best_learner_of_every_task() -> None:
    assert len(PAPER) == 8
    for task in TASKS:
        learners = {name: row[task].mean for name, row in PAPER.items() if name != "Human"}
        assert max(learners.items(), key=lambda item: item[1])[0] == "CURL + RIDE"
        assert all(0 < value < PAPER["Human"][task].mean < 1 for value in learners.values())


def test_sums_of_the_columns_are_those_of_the_printed_digits() -> None:
    sums = {task: round(sum(row[task].mean for row in PAPER.values()), 3) for task in TASKS}
    assert sums == {"goal-seeking": 3.747, "preferences": 2.681, "avoidance": 1.633, "tool-use": 1.106}


def test_every_explorer_of_the_paper_has_its_row() -> None:
    files = sorted((ROOT / "collect").glob("*.toml"))
    names = {load(file, CollectConfig).explorer.name for file in files}
    rows = [row for row in map(paper_name, names) if row]
    assert sorted(rows) == sorted(set(PAPER) - {"PPO (From scratch)", "Human"})


@pytest.mark.parametrize(
    ("agent", "row"),
    [
        ("scratch", "PPO (From scratch)"), ("strong scratch", "PPO (From scratch)"), ("human", "Human"),
        ("curl+ride offline", "CURL + RIDE"), ("CURL + RIDE, greedy", "CURL + RIDE"), ("rnd-frozen", "RND"),
        ("curl", None), ("curl+counted-ride", None), ("state", None), ("oracle", None), ("ride", None), ("", None),
    ],
)  # fmt: skip
def test_words_of_a_name_decide(agent: str, row: str | None) -> None:
    assert paper_name(agent) == row
