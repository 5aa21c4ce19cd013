"""Draws the figure of the main result from the published scores: `uv run python docs/make_results.py`.

A-Success on the 100 test puzzles of each task against steps of the task: policies from objects, from scratch and from
the simulator state, with random agent, oracle, and the paper's best agent and humans.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gym_open.envs.puzzles import Task
from gym_open.envs.tasks import step_budget
from gym_open.plots import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, draw_png
from gym_open.results.paper import PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
TASKS: tuple[Task, ...] = ("goal-seeking", "preferences", "avoidance", "tool-use")
STYLES = {
    "objects": ("objects from play", BLUE, "-"),
    "state": ("simulator state", GREY, "-."),
    "scratch": ("from scratch", ORANGE, "--"),
}
LAST = 310_000
"""Last step that is drawn."""


def curves() -> dict[tuple[str, str], dict[int, list[float]]]:
    """A-Success of all runs by task and agent, and by steps of training."""
    found: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted((ROOT / "evaluate/published").glob("*/scores/*/scores.json")):
        if path.parts[-4] not in ("studies", "rivals"):
            record = json.loads(path.read_text())
            found[record["task"], record["agent"]][record["trained"]].append(record["a_success"])
    return found


def panel(axes: "Axes", task: Task, found: dict[tuple[str, str], dict[int, list[float]]]) -> None:
    """Draw one task."""
    for agent, (label, colour, line) in STYLES.items():
        scores = {step: values for step, values in sorted(found[task, agent].items()) if step <= LAST}
        steps = np.array([0, *scores]) / 1000
        start = float(np.mean(next(iter(found[task, "random"].values()))))
        means = [start, *(float(np.mean(values)) for values in scores.values())]
        axes.plot(steps, means, line, color=colour, marker="o", markersize=3, label=label)
        lowest, highest = ([start, *map(end, scores.values())] for end in (min, max))
        axes.fill_between(steps, np.array(lowest), np.array(highest), color=colour, alpha=0.15, linewidth=0)
    oracle = float(np.mean(next(iter(found[task, "oracle"].values()))))
    human, best = PAPER["Human"][task].mean, max(row[task].mean for name, row in PAPER.items() if name != "Human")
    for height, label, colour in ((oracle, "oracle", GREEN), (human, "paper: humans", PURPLE),
                                  (best, "paper: best after 1M", VERMILION)):  # fmt: skip
        axes.axhline(height, color=colour, linewidth=1, linestyle=":", label=label)
    axes.set(title=task, xlabel="1,000 steps of the task", xlim=(0, LAST / 1000), ylim=(0, 0.75))
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.text(0.98, 0.02, f"{step_budget(task)} actions a puzzle", transform=axes.transAxes, ha="right", color=BLACK,
              fontsize=7, zorder=0)  # fmt: skip


def main() -> None:
    """Write docs/pictures/results/objects.png."""
    found = curves()

    def paint(figure: "Figure") -> None:
        row = figure.subplots(1, 4, sharey=True)
        for axes, task in zip(row, TASKS, strict=True):
            panel(axes, task, found)
        row[0].set_ylabel("A-Success, 100 test puzzles")
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=9)

    (ROOT / "docs/pictures/results/objects.png").write_bytes(draw_png(13, 3.9, paint, dpi=90))


if __name__ == "__main__":
    main()
