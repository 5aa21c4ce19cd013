"""Logs and releases whose digests match, although their contents are impossible."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.errors import ArtefactError
from gym_open.formats.logs import LogHead, LogWriter, SegmentStart, StepRecord, Switch
from gym_open.formats.releases import open_release
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.recording import open_view
from gym_open.viz.streams import logs, releases

MakeLog = Callable[..., Path]


def test_a_threshold_is_a_number_that_can_be_drawn(make_log: MakeLog) -> None:
    (stream,) = logs.open_streams(make_log(lengths=((3,),)))
    for told, threshold in ((0.5, 0.5), (1, 1.0), (10**400, None), (float("nan"), None), ("0.5", None)):
        config = {"curriculum": {"rule": "loss", "threshold": told}}
        assert msgspec.structs.replace(stream, config=config).threshold == threshold


def test_a_log_without_an_agent_is_refused(tmp_path: Path) -> None:
    puzzle = sample_puzzle("sandbox", np.random.default_rng(0))
    image, state = np.zeros((84, 84, 3), np.uint8), np.zeros((1, 13))
    with LogWriter(tmp_path, LogHead(0, {}, (puzzle,), {}, "<mujoco/>", (), 10)) as log:
        log.switch(Switch(0, -1, 0, "start", [np.nan]))
        log.segment(SegmentStart(0, 0, 0, puzzle, False, ("heavy_0",), state, np.zeros(5), image))
        log.step(StepRecord(0, 0, 0, 1, state, (), image))
        log.switch(Switch(1, 0, -1, "budget", [np.nan]))
    with pytest.raises(ArtefactError, match="no agent among its objects"):
        logs.open_streams(tmp_path)


def test_a_release_has_a_loss_for_each_world(
    make_log: MakeLog, no_figures: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = open_release(build_release(ReleaseConfig(), [make_log(lengths=((3,),))], tmp_path / "release").path)
    table = release.arrow_table

    class Fewer:
        """A table of switches that lack the last world's loss."""

        def __init__(self, name: Any) -> None:
            self.name = name

        def to_pylist(self) -> list[dict[str, Any]]:
            rows = table(self.name).to_pylist()
            return [{**row, "world_losses": row["world_losses"][:-1]} for row in rows]

    assert len(releases.open_streams(release)) == 1
    monkeypatch.setattr(release, "arrow_table", lambda name: Fewer(name) if name == "switches" else table(name))
    with pytest.raises(ArtefactError, match="a loss for each world"):
        releases.open_streams(release)


def test_a_log_is_shown_even_if_its_lineage_is_damaged(make_log: MakeLog) -> None:
    log = make_log(lengths=((3,),))
    (log / artefacts.LINEAGE).write_text("{damaged")
    assert open_view(VizConfig(), [log], Choice()).title == log.name
