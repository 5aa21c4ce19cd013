"""Figures of puzzles: a film strip per agent, or the results of all puzzles of a task."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.envs.world import World
from gym_open.plots import VERMILION, agent_style
from gym_open.viz.puzzles.episodes import PlayedPuzzle, PuzzleEpisode
from gym_open.viz.puzzles.film import returns_plot
from gym_open.viz.puzzles.tables import HARDEST, TaskTable
from gym_open.viz.render import Look, Painter, draw_sheet, painter, pose
from gym_open.viz.strip import Plot, PlotLine, draw_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_IMAGES = 7
_SIZE = 280
"""Edge of an image in pixels."""
Drawing = tuple[float, float, "Callable[[Figure], None]"]
"""Width and height in inches, and a function that draws on a figure."""


def strips(played: PlayedPuzzle, look: Look) -> Drawing:
    """Draw a film strip per agent, with the witness's last, above a plot of the returns."""
    episodes = played.episodes
    judges = [number for number, episode in enumerate(episodes) if episode.policy]
    with painter(World(), look, _SIZE) as paint:
        strips = [_strip(played, episode, paint) for episode in episodes]

    def draw(figure: "Figure") -> None:
        heights = [2.25] * len(episodes) + [2]
        *rows, below = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        for number, (row, strip) in enumerate(zip(rows, strips, strict=True)):
            words = f"{episodes[number].name}: {episodes[number].outcome}"
            words = f"{played.id}   {words}" if number == 0 else words
            row.suptitle(words, fontsize=10, x=0.01, ha="left", color="#191919")
            _draw_strip(row, strip)
        longest = max(episode.steps for episode in episodes)
        plots = [returns_plot(episodes, longest)]
        if judges:
            plots += [_policy_plot(episodes, judges, "value"), _policy_plot(episodes, judges, "entropy")]
        for axes, plot in zip(below.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
            draw_plot(axes, plot, steps=True)
            axes.set_xlabel("actions", fontsize=8)

    return 13.0, 2.25 * len(episodes) + 2.3, draw


def shown_steps(episode: PuzzleEpisode, limit: int = _IMAGES) -> list[int]:
    """Return the steps to show: beginning, end and touches, and between them as many as fit, evenly spaced."""
    wanted = [0, episode.steps, *(step for step, names in enumerate(episode.touched, 1) if names)]
    even = np.linspace(0, episode.steps, limit).round().astype(int).tolist()
    found = set(wanted[:limit])
    for step in even:
        if len(found) < limit:
            found.add(step)
    return sorted(found)


def _strip(played: PlayedPuzzle, episode: PuzzleEpisode, paint: Painter) -> list[tuple[str, np.ndarray]]:
    world = World()
    world.load(played.puzzle, recolour_hits=True)
    found = list[tuple[str, np.ndarray]]()
    for step in shown_steps(episode):
        touched = [name for names in episode.touched[:step] for name in names]
        pose(world, episode.states[step], touched)
        new = episode.touched[step - 1] if step else ()
        words = f"action {step}" if step else "the beginning"
        found.append((f"{words}: touches {', '.join(new)}" if new else words, paint(world)))
    return found


def _draw_strip(figure: "SubFigure", strip: list[tuple[str, np.ndarray]]) -> None:
    for i, axes in enumerate(figure.subplots(1, _IMAGES, squeeze=False)[0]):
        axes.set_axis_off()
        if i < len(strip):
            axes.imshow(strip[i][1])
            axes.set_title(strip[i][0], fontsize=8)


def _policy_plot(episodes: Sequence[PuzzleEpisode], judges: list[int], name: str) -> Plot:
    curves = list[PlotLine]()
    for number in judges:
        policy = episodes[number].policy
        assert policy is not None
        values = policy.values if name == "value" else policy.entropy
        colour, line = agent_style(number)
        x = np.arange(len(values) + 1)
        curves.append(PlotLine(x, np.append(values, values[-1]), colour, episodes[number].name, line))
    return Plot(
        {"value": "value: return that the policy expects", "entropy": "entropy of the policy (nats)"}[name], curves
    )


def overview(tables: Sequence[TaskTable]) -> Drawing:
    """Draw the results of all puzzles of each task, one task below the other."""
    sheets = [
        np.asarray(
            draw_sheet(
                {item: puzzle_by_id(item) for item in table.hardest[:HARDEST]},
                look="observation", size=2 * IMAGE_SIZE, columns=HARDEST // 2,
            )
        )
        for table in tables
    ]  # fmt: skip

    def draw(figure: "Figure") -> None:
        parts = figure.subfigures(len(tables), 1, squeeze=False)[:, 0]
        for part, table, sheet in zip(parts, tables, sheets, strict=True):
            part.suptitle(f"{table.name}: {len(table.hardest)} fixed puzzles", fontsize=12)
            (left, right), (bars, hard) = part.subplots(2, 2, width_ratios=[4, 5])
            _draw_within(left, table)
            _draw_solved(right, table)
            _draw_sorted(bars, table)
            hard.imshow(sheet)
            hard.set_axis_off()
            hard.set_title("the hardest puzzles at the beginning, by mean A-Success", fontsize=9)

    return 13.0, 8.0 * len(tables), draw


def _draw_within(axes: "Axes", table: TaskTable) -> None:
    from matplotlib.ticker import NullFormatter

    actions = np.arange(1, table.budget + 1)
    for number, agent in enumerate(table.agents):
        label = f"{agent.name}  {agent.run.record.a_success:.3f} ± {agent.run.record.a_success_half_width_95:.3f}"
        colour, line = agent_style(number)
        axes.plot(actions, agent.run.record.mean_return_within, line, color=colour, label=label)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="actions i", ylim=(-0.02, 1.05))
    axes.set_title("mean return within i actions", fontsize=9)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="upper left", title="A-Success", title_fontsize=8, alignment="left")


def _draw_solved(axes: "Axes", table: TaskTable) -> None:
    """Draw a row per agent and a column per puzzle, hardest left: the earned share of the return."""
    from matplotlib.colors import ListedColormap

    place = {item: i for i, item in enumerate(table.hardest)}
    shares = np.full((len(table.agents), len(place)), np.nan)
    danger = np.full_like(shares, np.nan)
    for row, agent in enumerate(table.agents):
        at = [place[item] for item in agent.run.puzzles]
        shares[row, at] = agent.run.returns[:, -1] / table.best[agent.numbers]
        danger[row, at] = np.where(agent.in_danger, 1.0, np.nan)
    axes.imshow(shares, cmap="cividis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
    axes.imshow(danger, cmap=ListedColormap([VERMILION]), aspect="auto", interpolation="nearest")
    axes.hlines(np.arange(1, len(table.agents)) - 0.5, -0.5, len(place) - 0.5, color="white", linewidth=3)
    axes.set_yticks(range(len(table.agents)), [agent.name for agent in table.agents], fontsize=8)
    axes.set_xlabel("puzzles, the hardest left")
    also = "; orange: ended in the danger patch" if table.task == "avoidance" else ""
    axes.set_title(f"earned share of the return: dark nothing, yellow all{also}", fontsize=9)


def _draw_sorted(axes: "Axes", table: TaskTable) -> None:
    for number, agent in enumerate(table.agents):
        colour, line = agent_style(number)
        values = np.sort(agent.run.values)[::-1]
        axes.plot(np.arange(1, len(values) + 1), values, line, color=colour, label=agent.name)
    axes.set(xlabel="puzzles, best of each agent left", ylim=(-0.02, 1.05))
    axes.set_title("A-Success of each puzzle", fontsize=9)
    axes.grid(alpha=0.25)
