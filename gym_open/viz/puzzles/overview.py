"""Results of all puzzles of a task: returns within i actions, who solved which puzzle, which puzzles are hard.

Timeline `actions`: at i, the dots show the return within i actions.

    <task>/within/<n>       mean return of agent n within i actions
    <task>/puzzles/<n>      a dot per puzzle: the tens of its number downwards, its units to the right
    <task>/returns/<n>, <task>/a_success/<n>     per puzzle, best first
    <task>/hardest          the hardest puzzles at the beginning
    <task>/about            the table of agents, and the commands that open the hardest puzzles
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.errors import UsageError
from gym_open.markdown import cell, table
from gym_open.plots import agent_style, rgb
from gym_open.viz.puzzles.tables import HARDEST, TaskTable, commands, read_tables
from gym_open.viz.render import draw_sheet
from gym_open.viz.view import View

TIMELINE = "actions"
_EARNED = np.array([(0, 34, 78), (124, 123, 120), (254, 232, 56)])
"""Colours of nothing, half and all of a puzzle's return, from cividis, which suits colour-blind readers."""
_DANGER = (213, 94, 0)
_PAPER = (250, 250, 248)
_ROW = 10
"""Puzzles per row."""
_LEGEND = (
    "± is half of the 95% interval over puzzles. A puzzle is solved if the agent earned all of its return. In the plot "
    "of who solved what, a dark dot means no return, a yellow dot all of it{danger}. The tens of a puzzle's number go "
    "down, its units to the right; hover over a dot to read it. Move the time cursor to i: the dots then show the "
    "return within i actions. Everything else is for the whole budget."
)
_WIDTH, _HEIGHT = _ROW + 1.5, _ROW + 4.5
"""Distance from one agent's puzzles to the next agent's."""


def overview(sources: Sequence[Path]) -> View:
    """Show all puzzles of each task and set that the sources were scored on, in a tab per task and set.

    Raises:
        ArtefactError: if a source is damaged or holds no scores.
        UsageError: if there is no source.
    """
    if not sources:
        raise UsageError("no scores to show; give at least one folder with scores")
    tables = read_tables(sources)

    def fill(rec: rr.RecordingStream) -> None:
        for each in tables:
            _fill(rec, each)

    tabs = [_layout(each) for each in tables]
    return View(
        " and ".join(each.name for each in tables),
        fill,
        rrb.Blueprint(
            tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs),
            rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=10.0),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            auto_views=False,
        ),
    )


def _fill(rec: rr.RecordingStream, group: TaskTable) -> None:
    root = group.name
    rec.log(f"{root}/about", rr.TextDocument(_about(group), media_type="text/markdown"), static=True)
    rec.log(f"{root}/hardest", rr.Image(np.asarray(_beginnings(group))), static=True)
    at = [rr.TimeColumn(TIMELINE, sequence=np.arange(1, group.budget + 1))]
    for n, agent in enumerate(group.agents):
        line = rr.SeriesLines(
            names=f"{agent.name}: A-Success {agent.run.record.a_success:.3f}", colors=rgb(agent_style(n)[0]), widths=2
        )
        rec.log(f"{root}/within/{n}", line, static=True)
        rec.send_columns(f"{root}/within/{n}", at, rr.Scalars.columns(scalars=agent.run.record.mean_return_within))
        for name, values in (("returns", agent.run.returns[:, -1]), ("a_success", agent.run.values)):
            rec.log(f"{root}/{name}/{n}", rr.BarChart(np.sort(values)[::-1], color=rgb(agent_style(n)[0])), static=True)
        _log_dots(rec, group, n, at)


def _log_dots(rec: rr.RecordingStream, group: TaskTable, n: int, at: list[rr.TimeColumn]) -> None:
    agent, entity = group.agents[n], f"{group.name}/puzzles/{n}"
    tens, units = np.divmod(agent.numbers, _ROW)
    corner = np.array([_WIDTH * (n % _across(group)), _HEIGHT * (n // _across(group))])
    words = f"{agent.name}\n{int(agent.solved.sum())} of {len(agent.run.puzzles)} solved"
    head = rr.Points2D(
        corner + np.array([_ROW / 2 - 0.5, -4.4]),
        radii=0.001,
        colors=rgb(agent_style(n)[0]),
        labels=words,
        show_labels=True,
    )
    rec.log(f"{entity}/name", head, static=True)
    dots = rr.Points2D(
        np.stack([units, tens], axis=1) + corner,
        radii=0.42,
        labels=[f"{item}: {words}" for item, words in zip(agent.run.puzzles, agent.outcomes(), strict=True)],
        show_labels=False,
    )
    rec.log(entity, dots, static=True)
    share = np.clip(agent.run.returns / group.best[agent.numbers][:, None], 0, 1).T  # (N, puzzles)
    colours = np.stack([np.interp(share, [0, 0.5, 1], _EARNED[:, i]) for i in range(3)], axis=-1).astype(np.uint8)
    lost = agent.in_danger[None] & (np.arange(1, group.budget + 1)[:, None] >= agent.run.steps[None])
    colours[lost] = _DANGER
    columns = rr.Points2D.columns(colors=colours.reshape(-1, 3)).partition([len(tens)] * group.budget)
    rec.send_columns(entity, at, columns)


def _across(group: TaskTable) -> int:
    """Return the number of agents side by side in the plot of who solved what."""
    return math.ceil(math.sqrt(len(group.agents) / 2))


def _beginnings(group: TaskTable) -> Image.Image:
    """Draw the hardest puzzles at the beginning."""
    hardest = {item: puzzle_by_id(item) for item in group.hardest[:HARDEST]}
    return draw_sheet(hardest, look="observation", size=2 * IMAGE_SIZE, columns=_ROW // 2)


def _about(group: TaskTable) -> str:
    rows = [
        [
            cell(agent.name), f"{agent.run.record.a_success:.3f} ± {agent.run.record.a_success_half_width_95:.3f}",
            f"{agent.run.record.mean_return:.3f}", f"{int(agent.solved.sum())} of {len(agent.run.puzzles)}",
        ]
        for agent in group.agents
    ]  # fmt: skip
    hard = []
    for item, mean in zip(group.hardest[:HARDEST], group.difficulty, strict=False):
        played = [agent for agent in group.agents if item in agent.run.puzzles]
        solved = sum(bool(agent.solved[agent.run.puzzles.index(item)]) for agent in played)
        hard.append([item, f"{mean:.3f}", f"{solved} of {len(played)}"])
    return "\n".join(
        [
            f"# {cell(group.name)}",
            "",
            *table(["agent", "A-Success", "mean return", "solved"], rows),
            "",
            _LEGEND.format(danger=", an orange dot the danger patch" if group.task == "avoidance" else ""),
            "",
            "## Hardest for these agents",
            "",
            *table(["puzzle", "mean A-Success", "solved by"], hard),
            "",
            "To open a puzzle:",
            "",
            *(f"```\n{line}\n```" for line in commands(group)),
        ]
    )


def _layout(group: TaskTable) -> rrb.Horizontal:
    root = f"/{group.name}"
    across = _across(group)
    down = math.ceil(len(group.agents) / across)
    bounds = rrb.VisualBounds2D(x_range=(-1, across * _WIDTH - 1), y_range=(-3.8, down * _HEIGHT - 3.8))
    legend = rrb.PlotLegend(rrb.Corner2D.RightBottom)
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.TimeSeriesView(
                origin=f"{root}/within", name="mean return within i actions", plot_legend=legend,
                axis_y=rrb.ScalarAxis(range=(0, 1.05)),
            ),
            rrb.Tabs(
                rrb.Spatial2DView(origin=f"{root}/hardest", name="the hardest puzzles at the beginning"),
                rrb.BarChartView(origin=f"{root}/returns", name="return of each puzzle, best first"),
                rrb.BarChartView(origin=f"{root}/a_success", name="A-Success of each puzzle, best first"),
            ),
        ),
        rrb.Spatial2DView(
            origin=f"{root}/puzzles", name="who solved what within i actions", visual_bounds=bounds, background=_PAPER
        ),
        rrb.TextDocumentView(origin=f"{root}/about", name="agents, and how to open a puzzle"),
        column_shares=[4, 5, 4],
        name=group.name,
    )  # fmt: skip
