"""Figures that Rerun's plots cannot show: the training curve of one encoder, and probes with their intervals."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gym_open.plots import BLUE, GREY, VERMILION, draw_png, finish
from gym_open.results.records import ProbeRecord, TrainingCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HELD_OUT = "held_out_"
_FEATURES = {"trained": (BLUE, "o"), "untrained": (VERMILION, "s"), "pixels": (GREY, "^")}
"""Colour and marker of each kind of features."""
_FEW = 8
"""A curve of at most so many points has a marker at each."""


def draw_curve(curve: TrainingCurve) -> bytes:
    """Return a PNG with a panel per column over the first column; held-out data are dashed in the same panel."""
    first, *names = curve.columns
    own = [name for name in names if not name.startswith(_HELD_OUT)]
    across = min(3, math.ceil(math.sqrt(max(len(own), 1))))
    down = math.ceil(len(own) / across) or 1

    def paint(figure: "Figure") -> None:
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for axes, name in zip(panels, own, strict=False):
            _line(axes, curve, name, {"color": BLUE, "label": "in training"})
            if _HELD_OUT + name in names:
                _line(axes, curve, _HELD_OUT + name, {"color": VERMILION, "linestyle": "--", "label": "held out"})
            axes.set(title=name.replace("_", " "), xlabel=first.replace("_", " "))
            finish(axes)
        for axes in panels[len(own) :]:
            axes.set_axis_off()

    return draw_png(4.4 * across, 2.9 * down, paint)


def _line(axes: "Axes", curve: TrainingCurve, name: str, style: dict[str, str]) -> None:
    x, y = curve.known(name)
    if x.size:
        axes.plot(x, y, **style, marker="o" if x.size <= _FEW else "", markersize=4)  # pyright: ignore[reportArgumentType]


def draw_probes(probes: Sequence[ProbeRecord]) -> bytes:
    """Return a PNG with a panel per target and a line per encoder: scores of trained and untrained features and pixels.

    Bars are 95% intervals; the dotted line is a guess without the image.
    """
    targets = {name: target.measure for probe in probes for name, target in probe.targets.items()}
    across = min(3, max(len(targets), 1))
    down = math.ceil(len(targets) / across) or 1

    def paint(figure: "Figure") -> None:
        panels = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
        for axes, (name, measure) in zip(panels, targets.items(), strict=False):
            for kind, offset in zip(_FEATURES, (-0.2, 0.0, 0.2), strict=True):
                _intervals(axes, name, kind, offset, probes)
            for place, probe in enumerate(probes):
                if name in probe.targets:
                    axes.plot([probe.targets[name].guess] * 2, [place - 0.4, place + 0.4], color="black", linestyle=":")
            axes.set(title=f"{name} ({measure})", ylim=(len(probes) - 0.5, -0.5))
            axes.set_yticks(range(len(probes)), [probe.folder.name for probe in probes])
            axes.grid(axis="x", alpha=0.3, linewidth=0.6)
        for axes in panels[len(targets) :]:
            axes.set_axis_off()
        axes = panels[0]
        axes.plot([], [], color="black", linestyle=":", label="guess without the image")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)

    return draw_png(3.8 * across + 1.5, (0.9 + 0.42 * len(probes)) * down + 0.4, paint)


def _intervals(axes: "Axes", target: str, kind: str, offset: float, probes: Sequence[ProbeRecord]) -> None:
    there = [
        (place + offset, probe.targets[target].scores[kind])
        for place, probe in enumerate(probes)
        if target in probe.targets and kind in probe.targets[target].scores
    ]
    values = [score.value for _, score in there]
    reach = [
        [0.0 if score.low is None else max(score.value - score.low, 0.0) for _, score in there],
        [0.0 if score.high is None else max(score.high - score.value, 0.0) for _, score in there],
    ]
    colour, marker = _FEATURES[kind]
    axes.errorbar(
        values, [y for y, _ in there], xerr=reach, fmt=marker, color=colour, markersize=5, capsize=3, label=kind
    )
