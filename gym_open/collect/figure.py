"""The summary of an exploration run as one figure."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gym_open.collect.config import CurriculumConfig
from gym_open.plots import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    draw_coverage,
    draw_png,
    finish,
    write_in_middle,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_NUMBERED = 40
"""Worlds whose visits are written over their bars; of more, the numbers would run into one another."""
STREAMS = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (PURPLE, ":"))
"""Colour and dash of a stream; after the fourth they come again."""


class SegmentSpan(NamedTuple):
    """A segment on the axis of steps of all streams; all streams advance at the same rate."""

    stream: int
    world: int
    first: int
    last: int
    loss_at_entry: float
    """Not a number for a fresh world, or without a world model."""
    loss_at_exit: float
    ended: str


def draw_summary(summary: Mapping[str, Any], curriculum: CurriculumConfig) -> bytes:
    """PNG file of a run's summary (the contents of summary.json); equal summaries give equal bytes."""
    formulas = {"text.parse_math": True}  # logarithmic axes write powers of ten as formulas
    return draw_png(15, 9, lambda figure: _draw(figure, summary, curriculum), dpi=100, settings=formulas)


def _draw(figure: "Figure", summary: Mapping[str, Any], curriculum: CurriculumConfig) -> None:
    top, bottom = figure.subplots(2, 3)
    spans = list(_spans(summary["segments"]))
    _losses(top[0], summary["curve"], spans, curriculum)
    _worlds_of_streams(top[1], spans, len(summary["worlds"]))
    _entry_and_exit(top[2], spans, curriculum)
    _worlds(bottom[0], summary["worlds"])
    _coverage(figure, bottom[1], summary["coverage"])
    _touches(bottom[2], summary)
    for axes in top:
        axes.set_xlim(0, summary["steps"])
    for axes in (*top, bottom[0], bottom[2]):
        finish(axes, fontsize=8, empty="")
    reasons = ", ".join(f"{count} {reason}" for reason, count in summary["reasons"].items())
    stuck = ", ".join(f"{kind} {counts['times']} times" for kind, counts in summary["stuck"].items())
    figure.suptitle(
        f"{summary['explorer']}, curriculum “{summary['rule']}”: {summary['steps']:,} steps, "
        f"{summary['switches']} switches\nsegments ended by: {reasons}; stuck: {stuck}"
    )


def _spans(segments: list[dict[str, Any]]) -> Iterator[SegmentSpan]:
    streams = len({item["stream"] for item in segments})
    steps = [0] * streams
    for item in sorted(segments, key=lambda item: (item["stream"], item["segment"])):
        stream = item["stream"]
        first, steps[stream] = steps[stream], steps[stream] + item["steps"]
        entry, left = (np.nan if item[key] is None else item[key] for key in ("loss_at_entry", "loss_at_exit"))
        yield SegmentSpan(stream, item["world"], first * streams, steps[stream] * streams, entry, left, item["ended"])


def _losses(axes: "Axes", curve: Mapping[str, Any], spans: list[SegmentSpan], curriculum: CurriculumConfig) -> None:
    columns = np.array(curve["rows"], dtype=np.float64).reshape(-1, len(curve["columns"])).T
    named = dict(zip(curve["columns"], columns, strict=True))
    axes.set(title="World model's loss", xlabel="steps of all streams", ylabel="loss, scaled")
    _log_scale(axes, named["world_loss"], curriculum)
    if np.isfinite(named["world_loss"]).any():
        lone = {"marker": "o", "markersize": 4, "clip_on": False} if len(named["step"]) == 1 else {}  # no line to see
        axes.plot(named["step"], named["world_model_loss"], color=SKY, linewidth=0.8, label="in training", **lone)
        axes.plot(named["step"], named["world_loss"], color=BLUE, label="of the current worlds", **lone)
    left = sorted({span.last for span in spans if span.last < named["step"][-1]})
    if left:
        floor = axes.get_xaxis_transform()
        axes.plot(left, np.full(len(left), 0.02), "|", color="black", markersize=9, transform=floor, label="switch")


def _log_scale(axes: "Axes", losses: np.ndarray, curriculum: CurriculumConfig) -> None:
    """Losses fall by orders of magnitude; the threshold is drawn where it decides."""
    if not (np.isfinite(losses) & (losses > 0)).any():
        write_in_middle(axes, "no world model")
        axes.set_yticks([])
        return
    axes.set_yscale("log")
    if curriculum.rule == "loss" and curriculum.threshold > 0:
        axes.axhline(curriculum.threshold, color=VERMILION, linestyle="--", label="threshold: world learned")


def _worlds_of_streams(axes: "Axes", spans: list[SegmentSpan], worlds: int) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set(title="Which world each stream is in", xlabel="steps of all streams", ylabel="world")
    for stream in sorted({span.stream for span in spans}):
        colour, dash = STREAMS[stream % len(STREAMS)]
        own = [span for span in spans if span.stream == stream]
        steps = [step for span in own for step in (span.first, span.last)]
        rows = [span.world for span in own for _ in range(2)]
        axes.plot(steps, rows, color=colour, linestyle=dash, linewidth=1.6, label=f"stream {stream}")
    axes.set_ylim(-0.7, worlds - 0.3)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _entry_and_exit(axes: "Axes", spans: list[SegmentSpan], curriculum: CurriculumConfig) -> None:
    axes.set(title="Loss of a world, entered and left", xlabel="steps of all streams", ylabel="loss, scaled")
    _log_scale(axes, np.array([span.loss_at_exit for span in spans]), curriculum)
    spans = [span for span in spans if np.isfinite(span.loss_at_exit)]
    again = [span for span in spans if np.isfinite(span.loss_at_entry)]
    fresh = [span.first for span in spans if not np.isfinite(span.loss_at_entry)]
    if fresh:
        floor = axes.get_xaxis_transform()
        axes.plot(
            fresh, np.full(len(fresh), 0.02), "^", color=ORANGE, transform=floor, label="entered fresh", clip_on=False
        )
    if again:
        first, last, entry, left = np.array([(s.first, s.last, s.loss_at_entry, s.loss_at_exit) for s in again]).T
        axes.plot([first, last], [entry, left], color=GREY, linewidth=0.8, zorder=1)
        axes.plot(first, entry, "o", markerfacecolor="none", color=BLUE, markersize=5, label="entered again")
    if spans:
        last, left = np.array([(span.last, span.loss_at_exit) for span in spans]).T
        axes.plot(last, left, "o", color=BLUE, markersize=4, label="left", clip_on=False)


def _worlds(axes: "Axes", worlds: list[dict[str, Any]]) -> None:
    from matplotlib.ticker import MaxNLocator

    legible = len(worlds) <= MOST_NUMBERED
    axes.set(title="Steps in each world" + ", and visits" * legible, xlabel="world", ylabel="steps")
    bars = axes.bar([row["world"] for row in worlds], [row["steps"] for row in worlds], color=BLUE)
    if legible:
        axes.bar_label(bars, [str(row["visits"]) for row in worlds], fontsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _coverage(figure: "Figure", axes: "Axes", coverage: Mapping[str, Any]) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import LogFormatter

    cells = np.array(coverage["cells"], dtype=np.float64)
    axes.set(title=f"Where the agent was: {coverage['share']:.0%} of the table", xlabel="x (m)", ylabel="y (m)")
    axes.spines[:].set_visible(True)
    image = draw_coverage(axes, cells, LogNorm(1, max(cells.max(), 2)))
    bar = figure.colorbar(image, ax=axes, label="steps (hatched: never)", shrink=0.9)
    bar.ax.yaxis.set_major_formatter(LogFormatter())  # 10, not a power of it
    bar.ax.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1, 0.4)))


def _touches(axes: "Axes", summary: Mapping[str, Any]) -> None:
    counts = {kind: count for kind, count in summary["touches"].items() if count}
    axes.set(title="What the agent touched", xlabel="contacts per 1000 steps")
    rates = [1000 * count / max(summary["steps"], 1) for count in counts.values()]
    axes.barh(list(counts), rates, color=BLUE)
    axes.invert_yaxis()
