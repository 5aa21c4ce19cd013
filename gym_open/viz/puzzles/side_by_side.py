"""One puzzle by several agents on one timeline of steps: a column per agent, and the witness in the last.

<n>/observation                     observations, PNG
<n>/table/…                         the table and the objects on it, as in the view of a log
<n>/table/policy                    arrows whose lengths are the probabilities of the moves
<n>/return, <n>/action              return so far, and actions
<n>/policy/{value, entropy}         only for a policy whose weights were given
<n>/policy/probabilities            probabilities of the nine actions
events                              touches and ends, in words
about/puzzle                        the table of agents, and the puzzle's record
"""

import rerun as rr
import rerun.blueprint as rrb

from gym_open.envs.tasks import step_budget
from gym_open.markdown import cell, table
from gym_open.viz.config import VizConfig
from gym_open.viz.puzzles.agent import log_agent
from gym_open.viz.puzzles.episodes import PlayedPuzzle, PuzzleEpisode
from gym_open.viz.render import DIRECTIONS
from gym_open.viz.view import View, times

_ABREAST = 4
"""Agents side by side; more than these get another tab."""


def side_by_side(config: VizConfig, played: PlayedPuzzle) -> View:
    """Return the view of one puzzle, played by several agents; `config` sets the length of their trails."""

    def fill(rec: rr.RecordingStream) -> None:
        rec.log("about/puzzle", rr.TextDocument(_about(played), media_type="text/markdown"), static=True)
        longest = max(episode.steps for episode in played.episodes)
        for number, episode in enumerate(played.episodes):
            log_agent(rec, played.puzzle, episode, number, longest=longest, trail_steps=config.trail_steps)
            _log_events(rec, number, episode)

    return View(played.id, fill, _layout(played))


def _log_events(rec: rr.RecordingStream, number: int, episode: PuzzleEpisode) -> None:
    """Log touches and the end of the episode in words."""
    found = {
        step: f"{episode.name}: touches {', '.join(names)}, return {episode.returns[step]:g}"
        for step, names in enumerate(episode.touched, 1)
        if names
    }
    levels = dict.fromkeys(found, rr.TextLogLevel.INFO)
    at_end, solved = found.get(episode.steps), episode.terminated and not episode.in_danger
    found[episode.steps] = f"{at_end}: {episode.outcome}" if at_end else f"{episode.name}: {episode.outcome}"
    levels[episode.steps] = rr.TextLogLevel.INFO if solved else rr.TextLogLevel.WARN
    columns = rr.TextLog.columns(text=list(found.values()), level=list(levels.values()))
    rec.send_columns(f"events/{number}", times(list(found)), columns)


def _about(played: PlayedPuzzle) -> str:
    rows = [[cell(episode.name), cell(episode.outcome), f"{episode.returns[-1]:g}"] for episode in played.episodes]
    budget = step_budget(played.puzzle.task)
    actions = [f"- {cell(episode.name)}: {' '.join(map(str, episode.actions))}" for episode in played.episodes]
    return "\n".join(
        [
            f"# {played.id}",
            "",
            *table(["agent", "outcome", "return"], rows),
            "",
            f"At most {budget} actions. Layout `{played.puzzle.digest[:16]}…`.",
            "",
            "Actions: " + ", ".join(f"{number} {name}" for number, name in enumerate(DIRECTIONS)) + ".",
            "",
            "## Actions of each agent",
            "",
            *actions,
            "",
            "## The puzzle",
            "",
            f"```json\n{played.puzzle.to_json().decode()}\n```",
        ]
    )


def _layout(played: PlayedPuzzle) -> rrb.Blueprint:
    columns = [_agent(number, episode) for number, episode in enumerate(played.episodes)]
    groups = [columns[i : i + _ABREAST] for i in range(0, len(columns), _ABREAST)]
    abreast = [
        rrb.Horizontal(*group, name=f"agents {_ABREAST * i + 1} to {_ABREAST * i + len(group)}")
        for i, group in enumerate(groups)
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            abreast[0] if len(abreast) == 1 else rrb.Tabs(*abreast), _below(played.episodes), row_shares=[7, 3]
        ),
        rrb.TimePanel(state="collapsed", timeline="step", fps=10.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _agent(number: int, episode: PuzzleEpisode) -> rrb.Vertical:
    """Lay out the table above the observation and, for a policy, the bars of its action probabilities."""
    seen: rrb.View | rrb.Horizontal = rrb.Spatial2DView(origin=f"/{number}/observation", name="observation")
    if episode.policy:
        hidden = rrb.PlotLegend(visible=False)
        bars = rrb.BarChartView(origin=f"/{number}/policy/probabilities", name="p(action)", plot_legend=hidden)
        seen = rrb.Horizontal(seen, bars)
    return rrb.Vertical(
        rrb.Spatial3DView(
            origin=f"/{number}/table",
            name=f"{episode.name}: {episode.outcome}",
        ),
        seen,
        row_shares=[3, 2],
    )


def _below(episodes: list[PuzzleEpisode]) -> rrb.Horizontal:
    def plot(title: str, entity: str, who: list[int], top: float | None = None) -> rrb.TimeSeriesView:
        axis = rrb.ScalarAxis(range=(-0.05, top)) if top else None
        contents = [f"/{number}/{entity}" for number in who]
        return rrb.TimeSeriesView(contents=contents, name=title, axis_y=axis, plot_legend=rrb.Corner2D.RightBottom)

    everyone = list(range(len(episodes)))
    judges = [number for number in everyone if episodes[number].policy]
    actions = plot("action (0 = stay)", "action", everyone, 8.5)
    second: rrb.TimeSeriesView | rrb.Tabs = actions
    if judges:
        value = plot("value: return that the policy expects", "policy/value", judges)
        entropy = plot("entropy of the policy (nats)", "policy/entropy", judges)
        second = rrb.Tabs(value, entropy, actions)
    return rrb.Horizontal(
        plot("return so far", "return", everyone, 1.05),
        second,
        rrb.TextLogView(origin="/events", name="events"),
        rrb.TextDocumentView(origin="/about/puzzle", name="puzzle"),
        column_shares=[3, 3, 4, 4],
    )
