"""The figure at the end of `gym-open run`: exploration, fine-tuning and scores."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.errors import ArtefactError
from gym_open.plots import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, draw_png, finish
from gym_open.viz.film import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLAY, SCRATCH, RANDOM, ORACLE, HUMAN = "from play", "from scratch", "random", "oracle", "human"
STYLES: dict[str, dict[str, Any]] = {
    PLAY: {"color": BLUE, "marker": "o", "linestyle": "-"},
    SCRATCH: {"color": ORANGE, "marker": "s", "linestyle": "--"},
    RANDOM: {"color": GREY, "marker": "^", "linestyle": ":"},
    ORACLE: {"color": GREEN, "marker": "D", "linestyle": "-."},
    HUMAN: {"color": PURPLE, "marker": "v", "linestyle": "-"},
}
"""Colour, marker and dash of each agent; dash and marker are for print."""


def draw_run_figure(log: Path, others: Sequence[Path], save: Path) -> Path:
    """Draw exploration, fine-tuning and score side by side as one PNG.

    Args:
        log: a log artefact.
        others: policy and scores artefacts of one task, in any order; any of them may be missing.
        save: the PNG file, written completely or not at all.

    Raises:
        ArtefactError: if an artefact's summary, curve or scores are missing or unreadable.
    """
    policies = [path for path in others if artefacts.lineage(path).kind == "policy"]
    scores = [path for path in others if artefacts.lineage(path).kind == "scores"]
    task = next((artefacts.lineage(path).facts["task"] for path in [*policies, *scores]), "no task")

    def paint(figure: "Figure") -> None:
        left, middle, right = figure.subplots(1, 3)
        _exploration(left, log)
        _fine_tuning(middle, policies, task)
        _score(right, scores, task)
        for axes in (left, middle):
            finish(axes)
        finish(right, legend="upper left")

    png = draw_png(15, 4.6, paint, dpi=120)
    return write_whole(save, lambda partial: partial.write_bytes(png))


def _exploration(axes: "Axes", log: Path) -> None:
    from matplotlib.ticker import LogFormatter

    summary, curriculum = _read(log / "summary.json"), artefacts.config_of(log)["curriculum"]
    curve = _columns(summary["curve"])
    axes.set(title="Exploration in the sandbox, no reward", xlabel="steps of all streams", ylabel="loss, scaled")
    for name, style in {
        "world_model_loss": {"color": SKY, "label": "world model's loss in training"},
        "world_loss": {"color": BLUE, "linewidth": 1.8, "label": "loss of the current worlds"},
    }.items():
        if np.isfinite(curve[name]).any():  # without a world model there is no loss
            axes.plot(curve["step"], curve[name], **style, marker="o" if len(curve["step"]) == 1 else "")
    if curriculum["rule"] == "loss" and curriculum["threshold"] > 0:
        axes.axhline(curriculum["threshold"], color=VERMILION, linestyle="--", label="threshold: world learned")
    if at := _switch_steps(summary["segments"]):
        label = f"switch of world ({len(at)})"
        floor = axes.get_xaxis_transform()
        axes.plot(at, np.full(len(at), 0.02), "|", color=BLACK, markersize=10, transform=floor, label=label)
    axes.set_yscale("log")  # the loss falls by a factor of 20, and small values decide about switches
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))


def _switch_steps(segments: list[dict[str, Any]]) -> list[int]:
    """When streams switched worlds, in steps of all streams; streams take their steps together."""
    streams = {item["stream"] for item in segments}
    found = []
    for stream in streams:
        step = 0
        for item in sorted((item for item in segments if item["stream"] == stream), key=lambda item: item["segment"]):
            step += item["steps"]
            if item["ended"] not in {"budget", "exhausted"}:
                found.append(step * len(streams))
    return sorted(found)


def _fine_tuning(axes: "Axes", policies: Sequence[Path], task: str) -> None:
    axes.set(title=f"PPO on {task}", xlabel="environment steps", ylabel="mean return of a training episode")
    for path in policies:
        curve = _columns(_read(path / "curve.json"))
        name = PLAY if artefacts.lineage(path).facts["from_encoder"] else SCRATCH
        known = np.isfinite(curve["mean_return"])
        axes.plot(curve["step"][known], curve["mean_return"][known], **STYLES[name], markersize=3, label=name)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))  # so that a small difference looks small


def _score(axes: "Axes", scores: Sequence[Path], task: str) -> None:
    axes.set(title=f"{task}, 100 fixed puzzles", xlabel="actions i", ylabel="mean return within i actions")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    for path in scores:
        record, name = _read(path / "scores.json"), _scored(artefacts.lineage(path))
        within = np.asarray(record["mean_return_within"])
        half = record.get("a_success_half_width_95")
        label = f"{name}: A-Success {record['a_success']:.3f}" + (f" ± {half:.3f}" if half is not None else "")
        style = {**STYLES[name], "marker": None if len(within) > 1 else STYLES[name]["marker"]}
        axes.plot(np.arange(1, len(within) + 1), within, **style, linewidth=1.8, label=label)
        axes.set_ylim(0, 1.35)  # returns are at most 1; the legend is above them
        if "puzzles" in record:
            axes.set_title(f"{task}, {record['puzzles']} fixed puzzles")


def _scored(lineage: artefacts.Lineage) -> str:
    if not lineage.parents:
        return lineage.facts["agent"]
    return PLAY if lineage.parents[0].lineage.facts["from_encoder"] else SCRATCH


def _read(path: Path) -> dict[str, Any]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the artefact again") from None


def _columns(curve: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a curve by name; null becomes NaN."""
    rows = np.array(curve["rows"], dtype=np.float64).reshape(-1, len(curve["columns"]))
    return {name: rows[:, i] for i, name in enumerate(curve["columns"])}
