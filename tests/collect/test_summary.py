"""The summary of a run, from hand-made counts: its JSON, its tables, its figure."""

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from rich.console import Console

from gym_open.agents.config import ExplorerConfig
from gym_open.collect.config import CollectConfig, CurriculumConfig
from gym_open.collect.figure import draw_summary
from gym_open.collect.pool import sample_pool
from gym_open.collect.report import MOST_SEGMENTS, summary_table
from gym_open.collect.summary import RunRecord, SegmentRecord, StuckCount, WorldCounts, summarise
from gym_open.envs.puzzles.generators import SandboxConfig
from gym_open.errors import ArtefactError

RANDOM = CollectConfig(
    explorer=ExplorerConfig(world_model="none", reward="none"), curriculum=CurriculumConfig(rule="interval")
)


def summed_up(config: CollectConfig, losses: list[float], more: int = 0) -> dict[str, Any]:
    """Stream 0 goes from world 0 to 1, stream 1 stays in 2; 3 is not visited; `more` segments follow in 0."""
    segments = [
        SegmentRecord(0, 0, 0, 30, math.inf, losses[0], "learned"),
        SegmentRecord(0, 1, 1, 20, math.inf, losses[1], "budget"),
        SegmentRecord(1, 0, 2, 50, math.inf, losses[2], "budget"),
        *(SegmentRecord(0, 2 + i, 0, 1, losses[0], losses[0] / 2, "learned") for i in range(more)),
    ]
    curve = [(50, 2 * losses[0], losses[0], 0.1, 2.0), (100, losses[0], losses[2], 0.1, 2.0)]
    record = RunRecord(2, 100, 1, [], segments, curve, losses, "budget")
    counts = [
        WorldCounts(visits=1, steps=30),
        WorldCounts(visits=1, steps=20),
        WorldCounts(visits=1, steps=50),
        WorldCounts(),
    ]
    for cell, count in ((0, 0), (0, 1), (7, 1), (143, 2)):
        counts[count].cells[cell] = 10 + cell
    counts[0].touches["heavy"], counts[2].touches["heavy"], counts[2].touches["wall"] = 3, 4, 5
    counts[2].stuck["corner"] = StuckCount(2, 40)
    return summarise(config, record, sample_pool(4, SandboxConfig(), seed=0), counts)


def test_counts_are_added_up_and_nan_becomes_null() -> None:
    found = summed_up(CollectConfig(), [0.5, 0.25, 0.125, math.inf])
    assert (found["explorer"], found["rule"], found["steps"], found["switches"]) == ("curl+ride", "loss", 100, 1)
    assert found["reasons"] == {"budget": 2, "learned": 1}
    assert [row["final_loss"] for row in found["worlds"]] == [0.5, 0.25, 0.125, None]
    assert [row["coverage"] for row in found["worlds"]] == [1 / 144, 2 / 144, 1 / 144, 0]
    assert found["coverage"]["share"] == 3 / 144
    assert found["coverage"]["share_of_visited_worlds"] == pytest.approx(4 / (3 * 144))
    assert (found["coverage"]["cells"][0][0], found["coverage"]["cells"][0][7], found["coverage"]["cells"][15][8]) == (
        20, 17, 153,
    )  # fmt: skip
    assert {kind: count for kind, count in found["touches"].items() if count} == {"heavy": 7, "wall": 5}
    assert found["stuck"] == {"agent": {"times": 0, "steps": 0}, "corner": {"times": 2, "steps": 40}}
    assert found["segments"][0]["loss_at_entry"] is None
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def shown(folder: Path, summary: dict[str, Any]) -> str:
    (folder / "summary.json").write_text(json.dumps(summary))
    out = io.StringIO()
    Console(width=100, file=out).print(summary_table(folder))
    return out.getvalue()


def test_the_tables_tell_fresh_worlds_from_losses_that_are_none(tmp_path: Path) -> None:
    text = shown(tmp_path, summed_up(CollectConfig(), [0.5, 0.25, 0.125, math.inf]))
    assert text.count("fresh") == 4  # three segments that began so, and the world never visited
    assert "heavy 7, wall 5" in text
    assert "2 times, 40 steps" in text
    text = shown(tmp_path, summed_up(RANDOM, [math.nan] * 4))
    assert text.count("fresh") == 1
    assert "random" in text


def test_the_last_segments_of_a_long_run_are_listed(tmp_path: Path) -> None:
    text = shown(tmp_path, summed_up(CollectConfig(), [0.5, 0.25, 0.125, 1.0], more=97))
    assert f"the last {MOST_SEGMENTS} of 100 segments" in text
    assert text.count("learned") == MOST_SEGMENTS + 1  # and once in the sum of all reasons


def test_a_log_without_a_summary_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"summary\.json: not readable"):
        summary_table(tmp_path)


def test_the_figure_shows_a_run_with_losses_and_one_without() -> None:
    """That equal summaries give equal bytes is part of a whole run's being made twice."""
    images = [
        draw_summary(summed_up(config, losses), config.curriculum)
        for config, losses in ((CollectConfig(), [0.5, 0.25, 0.125, math.inf]), (RANDOM, [math.nan] * 4))
    ]
    for data in images:
        with Image.open(io.BytesIO(data)) as figure:
            assert figure.size == (1500, 900)
            assert figure.info.keys() <= {"dpi"}
    assert images[0] != images[1]
