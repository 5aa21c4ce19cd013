"""What Rerun's plots cannot show: the training curve of one encoder as a figure, and probes with their intervals."""

import math
from typing import TYPE_CHECKING

import numpy as np

from gym_open.viz.charts import finish, png
from gym_open.viz.curves.sources import Curve, Probed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HELD_OUT = "held_out_"
_FEATURES = {"trained": ("#0072B2", "o"), "untrained": ("#D55E00", "s"), "pixels": ("#777777", "^")}
"""Colour and marker of what a probe looks at."""
_FEW = 8
"""Points of a curve up to which each is marked."""


def draw_curve(curve: Curve) -> bytes:
    """PNG: each column over the first in a panel of its own, the same on held-out data dashed in the same panel."""
    first, *names = curve.columns
    own = [name for name in names if not name.startswith(_HELD_OUT)]
    across = min(3, max(len(own), 1))
    down = math.ceil(len(own) / across) or 1

    def paint(figure: "Figure") -> None:
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for axes, name in zip(panels, own, strict=False):
            _line(axes, curve, name, {"color": "#0072B2", "label": "in training"})
            if _HELD_OUT + name in names:
                _line(axes, curve, _HELD_OUT + name, {"color": "#D55E00", "linestyle": "--", "label": "held out"})
            axes.set(title=name.replace("_", " "), xlabel=first.replace("_", " "))
            finish(axes)
        for axes in panels[len(own) :]:
            axes.set_axis_off()

    return png(4.4 * across, 2.9 * down, paint)


def _line(axes: "Axes", curve: Curve, name: str, style: dict[str, str]) -> None:
    x, y = curve.known(name)
    if x.size:
        axes.plot(x, y, **style, marker="o" if x.size <= _FEW else "", markersize=4)  # pyright: ignore[reportArgumentType]


def draw_probe(probe: Probed) -> bytes:
    """PNG: the score of each target from each kind of features, with intervals, and the guess without a picture."""
    targets = list(probe.targets.values())
    kinds = [kind for kind in _FEATURES if any(kind in target.scores for target in targets)]
    wide = 0.8 / max(len(kinds), 1)

    def paint(figure: "Figure") -> None:
        axes = figure.subplots()
        for i, kind in enumerate(kinds):
            there = [(place, target.scores[kind]) for place, target in enumerate(targets) if kind in target.scores]
            x = np.array([place for place, _ in there]) + (i - (len(kinds) - 1) / 2) * wide
            heights = [score.value for _, score in there]
            reach = [
                [0.0 if score.low is None else max(score.value - score.low, 0.0) for _, score in there],
                [0.0 if score.high is None else max(score.high - score.value, 0.0) for _, score in there],
            ]
            colour, marker = _FEATURES[kind]
            axes.bar(x, heights, wide * 0.92, color=colour, alpha=0.55, label=kind)
            axes.errorbar(x, heights, yerr=reach, fmt=marker, color=colour, markersize=4, capsize=3, linewidth=1.2)
        for place, target in enumerate(targets):
            label = "guess without a picture" if place == 0 else None
            axes.plot([place - 0.45, place + 0.45], [target.guess] * 2, color="black", linestyle=":", label=label)
        axes.set(ylabel="score on worlds never seen", title=f"probe {probe.name}: 95% intervals over worlds")
        axes.set_xticks(range(len(targets)), [f"{name}\n{target.measure}" for name, target in probe.targets.items()])
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), max(1.0, axes.get_ylim()[1]))
        finish(axes)
        axes.legend(frameon=False, fontsize=9, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.14))

    return png(1.6 + 1.25 * max(len(targets), 3), 4.6, paint)
