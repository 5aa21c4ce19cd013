"""A document with the results of the analysis, and a figure of the explained variance."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from gym_open.agents.config import EncoderConfig
from gym_open.markdown import cell, table
from gym_open.plots import BLUE, VERMILION, draw_png, finish
from gym_open.viz.features.analysis import FeatureAnalysis, agent_apart, components_for, same_world
from gym_open.viz.features.frames import Frames

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEW_LINE = "\n"
_STYLES = ((BLUE, "-"), (VERMILION, "--"))
_HOW = """
- **Neighbours** are the {k} images with the nearest features. Distances are Euclidean over all units, in units of the
  mean distance of two images.
- **Components** (PC) are the principal components of the features minus their mean. The sign makes the largest weight
  positive. All axes of a cloud are in units of the standard deviation along PC 1.
- **Effective rank** is exp of the entropy of the singular values (Roy and Vetterli 2007). It says how many directions
  the features use, from 1 to the number of units.
- **On the screen**: move along the timeline `frame`. The large red point is the current frame, the purple points are
  its neighbours. Move the mouse over a point to see its frame.
"""


def document(config: EncoderConfig, frames: Frames, analyses: Mapping[str, FeatureAnalysis]) -> str:
    """Markdown: the images, the results, and how to read the clouds."""
    rows: dict[str, Callable[[FeatureAnalysis], str]] = {
        "units": lambda a: f"{a.width:,}",
        "dead units (the same value for all images)": lambda a: f"{a.dead:,}",
        "effective rank": lambda a: f"{a.rank:.1f}",
        "components with 90% of the variance": lambda a: str(components_for(a.explained, 0.90)),
        "components with 99% of the variance": lambda a: str(components_for(a.explained, 0.99)),
        "variance along PC 1, 2, 3": lambda a: ", ".join(f"{share:.1%}" for share in a.explained[:3]),
        "neighbours of the same world": lambda a: f"{same_world(frames, a.near):.0%}",
        "agent's distance in the neighbours (cells, median)": lambda a: f"{agent_apart(frames, a.near):.2f}",
    }
    body = [[name, *(number(item) for item in analyses.values())] for name, number in rows.items()]
    others = _all_others(len(frames))
    k = max((analysis.near.shape[1] for analysis in analyses.values()), default=0)
    return f"""# Features

Images: {cell(frames.origin)}. Network: `{config.architecture}`, {config.features:,} features. `untrained` is the same
network with new random weights and the same mean image.

{_NEW_LINE.join(table(["", *analyses], body))}

For comparison, of two random images {same_world(frames, others):.0%} show the same world, and the median distance
of the agent is {agent_apart(frames, others):.2f} cells.
{_HOW.format(k=k)}"""


def _all_others(count: int) -> np.ndarray:
    """The indices of all other images for each image, (n, n − 1)."""
    return np.array([np.delete(np.arange(count), i) for i in range(count)]).reshape(count, -1)


def draw_variance(analyses: Mapping[str, FeatureAnalysis]) -> bytes:
    """PNG: the cumulative share of the variance over the components, one line per encoder."""

    def paint(figure: "Figure") -> None:
        axes = figure.subplots()
        for (name, analysis), (colour, dash) in zip(analyses.items(), _STYLES, strict=False):
            held = np.cumsum(analysis.explained)
            label = f"{name}: effective rank {analysis.rank:.1f}"
            axes.plot(np.arange(1, len(held) + 1), held, color=colour, linestyle=dash, label=label)
        axes.set(xscale="log", xlabel="principal components", ylabel="cumulative share of the variance")
        axes.set_ylim(0, 1.02)
        axes.xaxis.set_major_formatter("{x:g}")
        finish(axes)

    return draw_png(8, 4.5, paint)
