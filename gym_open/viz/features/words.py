"""What an encoder does with pictures, in numbers: a page, and a figure of the variance."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from gym_open.agents.config import EncoderConfig
from gym_open.markdown import cell, table
from gym_open.plots import BLUE, VERMILION, draw_png, finish
from gym_open.viz.features.analysis import Analysis, agent_apart, components_for, same_world
from gym_open.viz.features.frames import Frames

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEW_LINE = "\n"
_STYLES = ((BLUE, "-"), (VERMILION, "--"))


_HOW = """
- **Neighbours** are the {k} pictures whose features are nearest: Euclidean distance over all units, in units of the
  mean distance of two pictures.
- **Components** (PC) are those of the features less their mean, each with the sign that makes its largest weight
  positive. Clouds are in units of the deviation along PC 1, all axes alike.
- **Effective rank** is e to the entropy of the singular values (Roy and Vetterli 2007): how many directions the
  features use, from 1 to the number of units.
- **On the screen**: move along the timeline `frame`. The large red point is the frame, the purple ones are its
  neighbours. A point under the pointer says which frame it is.
"""


def document(config: EncoderConfig, frames: Frames, looked: Mapping[str, Analysis]) -> str:
    """Markdown: what was shown, what was found, and how to read the clouds."""
    rows: dict[str, Callable[[Analysis], str]] = {
        "units": lambda a: f"{a.width:,}",
        "dead units (one value for all pictures)": lambda a: f"{a.dead:,}",
        "effective rank": lambda a: f"{a.rank:.1f}",
        "components that hold 90% of the variance": lambda a: str(components_for(a.explained, 0.90)),
        "components that hold 99% of the variance": lambda a: str(components_for(a.explained, 0.99)),
        "variance along PC 1, 2, 3": lambda a: ", ".join(f"{share:.1%}" for share in a.explained[:3]),
        "neighbours that are of the same world": lambda a: f"{same_world(frames, a.near):.0%}",
        "agent, from a frame to its neighbours (cells, median)": lambda a: f"{agent_apart(frames, a.near):.2f}",
    }
    body = [[name, *(number(one) for one in looked.values())] for name, number in rows.items()]
    others = _all_others(len(frames))
    k = max((analysis.near.shape[1] for analysis in looked.values()), default=0)
    return f"""# Features

Shown: {cell(frames.origin)}. Network: `{config.architecture}`, {config.features:,} features. `untrained` is the same
network with fresh weights and the same mean picture.

{_NEW_LINE.join(table(["", *looked], body))}

Of two pictures drawn at random, {same_world(frames, others):.0%} are of the same world, and the agent is
{agent_apart(frames, others):.2f} cells away in the median.
{_HOW.format(k=k)}"""


def _all_others(count: int) -> np.ndarray:
    """All other pictures of each, (n, n − 1)."""
    return np.array([np.delete(np.arange(count), i) for i in range(count)]).reshape(count, -1)


def draw_variance(looked: Mapping[str, Analysis]) -> bytes:
    """PNG: the share of the variance that the first components hold together, a line an encoder."""

    def paint(figure: "Figure") -> None:
        axes = figure.subplots()
        for (name, analysis), (colour, dash) in zip(looked.items(), _STYLES, strict=False):
            held = np.cumsum(analysis.explained)
            label = f"{name}: effective rank {analysis.rank:.1f}"
            axes.plot(np.arange(1, len(held) + 1), held, color=colour, linestyle=dash, label=label)
        axes.set(xscale="log", xlabel="principal components", ylabel="share of the variance that they hold")
        axes.set_ylim(0, 1.02)
        axes.xaxis.set_major_formatter("{x:g}")
        finish(axes)

    return draw_png(8, 4.5, paint)
