"""Published scores are whole, follow from their episodes, and agree with docs/results.md."""

import json
import re
from collections import defaultdict
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.envs.puzzles.sets import puzzles_of
from gym_open.evaluate.play import replay
from gym_open.evaluate.scores import summarise
from gym_open.evaluate.verify import verify_scores
from gym_open.workspace import template

PUBLISHED = template() / "evaluate/published"
SCORES = sorted(path.parent for path in PUBLISHED.glob("*/scores/*/manifest.json"))
BUDGET = {"goal-seeking": 100, "preferences": 100, "avoidance": 100, "tool-use": 200}
each = pytest.mark.parametrize("scores", SCORES, ids=lambda path: path.relative_to(PUBLISHED).as_posix())


def record_of(scores: Path) -> dict[str, Any]:
    return json.loads((scores / "scores.json").read_text())


def shown(values: list[float]) -> str:
    """Format a score as in the document: mean over seeds, and their deviation if there are several."""
    deviation = f" ± {stdev(values):.3f}" if len(values) > 1 else ""
    return f"{mean(values):.3f}{deviation}".replace("0.", ".")


def test_the_grid_is_there() -> None:
    found = {(one["task"], one["agent"]) for one in map(record_of, SCORES)}
    assert {task for task, _ in found} == set(BUDGET)
    assert {agent for task, agent in found if task == "goal-seeking"} >= {"scratch", "paper", "state", "icm-online"}


@each
def test_they_are_whole_and_follow_from_their_episodes(scores: Path) -> None:
    artefacts.verify(scores, "scores")
    record = record_of(scores)
    episodes = pd.read_parquet(scores / "episodes.parquet")
    budget = BUDGET[record["task"]]
    assert len(episodes) == record["puzzles"] == 100
    within = np.array([np.cumsum(np.pad(rewards, (0, budget - len(rewards)))) for rewards in episodes["rewards"]])
    weights = np.log((np.arange(budget) + 2) / (np.arange(budget) + 1))
    assert record["a_success"] == pytest.approx((within.mean(axis=0) * weights).sum() / weights.sum(), abs=1e-9)


@pytest.mark.slow
@each
def test_they_come_out_again_when_played_again(scores: Path) -> None:
    assert verify_scores(scores)


@pytest.mark.parametrize("path", sorted(PUBLISHED.glob("zero-shot/*.json")), ids=lambda path: path.stem)
def test_plans_without_task_steps_come_out_again(path: Path) -> None:
    """Their recorded actions, played again on the test puzzles, earn the recorded score."""
    record = json.loads(path.read_text())
    played = replay(record["task"], puzzles_of(record["task"], record["split"]), record["actions"])
    assert played.steps.tolist() == [len(actions) for actions in record["actions"]]
    assert summarise(played)["a_success"] == pytest.approx(record["a_success"], abs=1e-12)


def test_what_the_document_says_of_plans_is_what_they_hold() -> None:
    document = (template() / "docs/results.md").read_text()
    for task in ("goal-seeking", "avoidance"):
        scores = [json.loads(path.read_text())["a_success"] for path in sorted(PUBLISHED.glob(f"zero-shot/{task}-*"))]
        assert len(scores) == 6
        assert f"| {task} | `zero-shot` | {shown(scores)} |" in document


def test_what_the_document_says_is_what_they_hold() -> None:
    by_agent: dict[tuple[str, str], dict[int, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    for record in (record_of(path) for path in SCORES if "studies" not in path.parts):
        by_agent[record["task"], record["agent"]][record["trained"]][record.get("seed", 0)] = record["a_success"]
    document = (template() / "docs/results.md").read_text()
    checked = 0
    for task, agent, cells in re.findall(r"^\| (?:(\S+) \| )?[^|]*`([a-z+-]+)`[^|]*\|(.*)\|$", document, re.MULTILINE):
        lengths = by_agent.get((task or "goal-seeking", agent), {})
        values = [shown([found[seed] for seed in sorted(found)]) for _, found in sorted(lengths.items())]
        told = [cell.strip().strip("*") for cell in cells.split("|")]
        if told[-1] in {"", "–"} or not lengths:
            continue
        assert [cell for cell in told if cell][: len(values)] == values, agent
        checked += 1
    assert checked > 12
