"""The figure of a run shows the numbers of the artefacts that exist."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gym_open import artefacts
from gym_open.config import Config
from gym_open.errors import ArtefactError
from gym_open.viz.figures import draw_run_figure


class Curriculum(Config, frozen=True):
    """Keys as in the configuration of `collect`."""

    rule: str = "loss"
    threshold: float = 1.0


class Settings(Config, frozen=True):
    """Keys as in the configuration of `collect`."""

    curriculum: Curriculum = Curriculum()


def make(
    folder: Path,
    kind: str,
    facts: Mapping[str, Any],
    files: Mapping[str, Any],
    parents: Sequence[Path] = (),
    *,
    config: Settings | None = None,
) -> Path:
    def work(partial: Path) -> Mapping[str, Any]:
        for name, content in files.items():
            (partial / name).write_text(json.dumps(content))
        return facts

    return artefacts.build(folder, kind=kind, config=config or Settings(), parents=parents, work=work).path


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    columns = ["step", "world_model_loss", "world_loss", "intrinsic_reward", "policy_entropy"]
    rows = [[256 * i, 3 / i, None if i == 1 else 2 / i, 0.1, 2.0] for i in range(1, 9)]
    stay = {"world": 0, "loss_at_entry": None, "loss_at_exit": 1.0}
    segments = [
        {**stay, "stream": 0, "segment": 0, "steps": 300, "ended": "learned"},
        {**stay, "stream": 0, "segment": 1, "steps": 200, "ended": "budget"},
        {**stay, "stream": 1, "segment": 0, "steps": 500, "ended": "budget"},
    ]
    summary = {"curve": {"columns": columns, "rows": rows}, "segments": segments}
    log = make(tmp_path / "log", "log", {"task": "sandbox"}, {"summary.json": summary})
    made = [log]
    for name, start in (("curl", True), ("scratch", False)):
        curve = {"columns": ["step", "mean_return"], "rows": [[128, None], [256, 0.25], [384, 0.5]]}
        facts = {"task": "goal-seeking", "from_encoder": start}
        policy = make(tmp_path / name, "policy", facts, {"curve.json": curve})
        made += [policy, scores(tmp_path / f"{name}-scores", [0.1, 0.3], [policy])]
    return [*made, *(scores(tmp_path / agent, [0.0, 0.2], [], agent) for agent in ("random", "oracle"))]


def scores(folder: Path, within: list[float], parents: list[Path], agent: str = "PPO") -> Path:
    record = {"mean_return_within": within, "a_success": 0.125, "a_success_half_width_95": 0.01, "puzzles": 100}
    return make(folder, "scores", {"task": "goal-seeking", "agent": agent}, {"scores.json": record}, parents)


def drawn(monkeypatch: pytest.MonkeyPatch, log: Path, others: list[Path], save: Path) -> Figure:
    """The figure at the time when it is written."""
    kept: list[Figure] = []
    original = Figure.subplots

    def subplots(self: Figure, *args: Any, **options: Any) -> Any:
        kept.append(self)
        return original(self, *args, **options)

    monkeypatch.setattr(Figure, "subplots", subplots)
    draw_run_figure(log, others, save)
    return kept[0]


def test_lines_are_the_artefacts_numbers(sources: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, *others = sources
    left, middle, right = drawn(monkeypatch, log, others, tmp_path / "run.png").axes
    lines = {str(line.get_label()): np.array(line.get_data(), dtype=float) for line in left.lines}
    assert np.allclose(lines["world model's loss in training"], [256 * np.arange(1, 9), 3 / np.arange(1, 9)])
    assert lines["switch of world (1)"][0].tolist() == [600]  # 300 steps of one stream of two
    assert [line.get_ydata()[0] for line in left.lines if "threshold" in str(line.get_label())] == [1.0]  # type: ignore
    for line in middle.lines:
        assert np.array_equal(np.array(line.get_data()), [[256, 384], [0.25, 0.5]])
    assert [line.get_label() for line in middle.lines] == ["from play", "from scratch"]
    labels = [str(line.get_label()) for line in right.lines]
    names = ("from play", "from scratch", "random", "oracle")
    assert labels == [f"{name}: A-Success 0.125 ± 0.010" for name in names]
    assert right.lines[2].get_ydata() == pytest.approx([0.0, 0.2])
    assert right.get_xscale() == "log"
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in (left, middle, right))


def test_the_file_is_complete_and_reproducible(sources: list[Path], tmp_path: Path) -> None:
    log, *others = sources
    first, second = (draw_run_figure(log, others, tmp_path / f"{i}.png") for i in range(2))
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as picture:
        assert picture.size == (1800, 552)
    assert not list(tmp_path.glob(".*.tmp"))


def test_missing_data_is_no_error(sources: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, middle, right = drawn(monkeypatch, sources[0], [], tmp_path / "run.png").axes
    assert [axes.texts[0].get_text() for axes in (middle, right)] == ["no data", "no data"]


def test_without_a_world_model_only_switches_are_drawn(
    sources: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = ["step", "world_model_loss", "world_loss", "intrinsic_reward", "policy_entropy"]
    stay = {"stream": 0, "world": 0, "loss_at_entry": None, "loss_at_exit": None}
    segments = [{**stay, "segment": i, "steps": 64, "ended": ended} for i, ended in enumerate(("interval", "budget"))]
    curve = {"columns": columns, "rows": [[64, None, None, 0.0, 2.2], [128, None, None, 0.0, 2.2]]}
    config = Settings(curriculum=Curriculum(rule="interval"))
    files = {"summary.json": {"curve": curve, "segments": segments}}
    log = make(tmp_path / "random", "log", {"task": "sandbox"}, files, config=config)
    left, *_ = drawn(monkeypatch, log, [], tmp_path / "run.png").axes
    assert [str(line.get_label()) for line in left.lines] == ["switch of world (1)"]
    assert left.lines[0].get_xdata()[0] == 64  # type: ignore[index]


def test_a_missing_summary_is_named(sources: list[Path], tmp_path: Path) -> None:
    (sources[0] / "summary.json").unlink()
    with pytest.raises(ArtefactError, match=r"summary\.json"):
        draw_run_figure(sources[0], sources[1:], tmp_path / "run.png")
    assert not (tmp_path / "run.png").exists()
