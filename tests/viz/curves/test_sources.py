"""Scores, probes and reports that cannot be true are refused by name, not drawn."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.errors import ArtefactError
from gym_open.evaluate.scores import Episodes, summarise
from gym_open.formats.scores import episodes_schema, read_episodes
from gym_open.viz.curves.sources import ReportTable, find, summaries, summaries_of_report


class Made(Config, frozen=True):
    """Stands for any stage's configuration."""

    name: str


Spoil = Callable[[dict[str, Any], list[dict[str, Any]]], None]


def spoilt(scores: Path, out: Path, spoil: Spoil) -> Path:
    """Make a whole scores artefact with a changed record and changed rows."""
    record, rows = json.loads((scores / "scores.json").read_bytes()), read_episodes(scores)
    spoil(record, rows)

    def work(partial: Path) -> dict[str, Any]:
        (partial / "scores.json").write_text(json.dumps(record))
        pq.write_table(pa.Table.from_pylist(rows, schema=episodes_schema()), partial / "episodes.parquet")
        return {}

    return artefacts.build(out, kind="scores", config=Made(name=out.name), parents=[], work=work).path


def probe(out: Path, targets: dict[str, Any]) -> Path:
    def work(partial: Path) -> dict[str, Any]:
        (partial / "probe.json").write_text(json.dumps({"targets": targets}))
        return {}

    return artefacts.build(out, kind="probe", config=Made(name=out.name), parents=[], work=work).path


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _, rows: rows.clear(), "at least one"),
        (lambda _, rows: rows.append(rows[0]), "101 episodes, but a set has 100"),
        (lambda _, rows: rows.__setitem__(1, rows[0]), "each once and in order"),
        (lambda _, rows: rows[3].update(puzzle="<b>\x1b[2J"), "not the test puzzles"),
        (lambda _, rows: rows[3].update(puzzle="goal-seeking/validation/003"), "not the test puzzles"),
        (lambda _, rows: rows[3].update(a_success=math.nan), "`a_success` is nan"),
        (lambda record, _: record["mean_return_within"].append(0.0), "100 numbers expected, got 101"),
        (lambda record, _: record.update(trained=2**80), "scores.json|steps from 0"),
        (lambda record, _: record.update(trained=2**60), "steps from 0"),
    ],
)
def test_scores_that_cannot_be_true_are_refused(benchmark: Path, tmp_path: Path, spoil: Spoil, message: str) -> None:
    scores = spoilt(benchmark / "evaluate/scores/random-goal-seeking", tmp_path / "scores", spoil)
    with pytest.raises(ArtefactError, match=message):
        find([scores])


def test_scores_of_other_puzzles_are_another_row(benchmark: Path, tmp_path: Path) -> None:
    def only(first: int, last: int) -> Spoil:
        def change(record: dict[str, Any], rows: list[dict[str, Any]]) -> None:
            rows[:] = rows[first:last]
            rewards = np.array([row["rewards"] + [0.0] * (100 - row["steps"]) for row in rows])
            steps, ended = (np.array([row[name] for row in rows]) for name in ("steps", "terminated"))
            record.update(summarise(Episodes(np.zeros(rewards.shape, np.int8), rewards, steps, ended)))

        return change

    whole = benchmark / "evaluate/scores/random-goal-seeking"
    for i, spoil in enumerate((only(0, 3), only(1, 3), only(3, 5))):
        spoilt(whole, tmp_path / "scores" / f"s{i}", spoil)
    rows, _ = summaries(find([tmp_path]).runs)
    assert [row.agent for row in rows] == [f"random, puzzles {own}" for own in ("000–002", "001–002", "003–004")]


@pytest.mark.parametrize("order", [(2, 1, 0), (0, 2)])
def test_puzzles_out_of_order_or_with_a_gap_are_refused(
    benchmark: Path, tmp_path: Path, order: tuple[int, ...]
) -> None:
    def only(_: Any, rows: list[dict[str, Any]]) -> None:
        rows[:] = [rows[i] for i in order]

    scores = spoilt(benchmark / "evaluate/scores/random-goal-seeking", tmp_path / "scores", only)
    with pytest.raises(ArtefactError, match="each once and in order"):
        find([scores])


def test_a_report_whose_steps_are_none_is_refused() -> None:
    band = {"x": [1], "value": [0.5], "low": [0.5], "high": [0.5]}
    cell = {
        "agent": "a", "task": "b", "seeds": [0], "trained": 8, "deviation": None, "score": {"value": 0.5},
        "learning": band, "returns": band,
    }  # fmt: skip
    assert summaries_of_report(ReportTable("r", {"results": {"cells": [cell]}}))
    for strange in ({"trained": 2**80}, {"learning": {**band, "x": [2**70]}}, {"learning": {**band, "high": [1e300]}}):
        with pytest.raises(ArtefactError, match="not a report's table"):
            summaries_of_report(ReportTable("r", {"results": {"cells": [{**cell, **strange}]}}))


def test_probes_are_drawn_up_to_some_number_of_targets(tmp_path: Path) -> None:
    target = {"measure": "r2", "guess": 0.0, "scores": {}, "gain": {"value": 0.3}}
    probe(tmp_path / "many", {str(i): target for i in range(30)})
    found = find([tmp_path])
    assert [len(probe.targets) for probe in found.probes] == [24]
    assert found.left_out == ["`many`: 6 of its targets, since only 24 are drawn"]
    with pytest.raises(ArtefactError, match=r"probe\.json: not readable"):
        find([probe(tmp_path / "huge", {"agent": {**target, "guess": 1e308}})])
