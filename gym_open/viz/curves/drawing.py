"""Curves as Rerun series.

Rerun draws all plots over one timeline, called `step`. The name of each plot says what a step is there: an agent step
of fine-tuning, an action of an episode, or a gradient update of an encoder.

    score/<task>/<agent>/{mean, low, high}                                      A-Success
    return/<task>/<agent>/{mean, low, high}                                     mean return within a number of actions
    training/<task>/<agent>/{mean, runs/<run>}                                  mean return of training episodes
    encoder/<world model>/<column>/<encoder>                                    figures of world models
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
from rerun.components import MarkerShapeLike

from gym_open.results.names import is_trained, row_order, standing
from gym_open.results.records import IntervalCurve
from gym_open.results.rows import RowSummary
from gym_open.terminal import printable
from gym_open.viz.curves.sources import TrainedModel
from gym_open.viz.view import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

TIMELINE = "step"
RETURN = "mean_return"
"""The column of a policy's curve that is drawn."""
_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""Okabe and Ito's palette without black and yellow: each is invisible on one of Rerun's two backgrounds."""
_GREYS = ((165, 165, 165), (90, 90, 90), (130, 130, 130))
"""Colours of agents that were not trained."""
_MARKERS: tuple[MarkerShapeLike, ...] = ("circle", "square", "up", "diamond", "cross", "down", "plus")
_THICK, _THIN, _EDGE = 2.5, 0.8, 0.6
_LEVEL_POINTS = 9
_FAINT = 110
"""Opacity (0–255) of single runs and of intervals."""

Numbers = Sequence[int] | Sequence[float] | np.ndarray


class AgentStyle(NamedTuple):
    """How an agent is drawn in all plots."""

    name: str
    colour: tuple[int, int, int]
    marker: MarkerShapeLike


def styles(agents: Iterable[str]) -> dict[str, AgentStyle]:
    """Give each agent a colour and a marker; after the last colour the first follows again, with another marker."""
    ordered = sorted(set(agents), key=row_order)
    trained = [name for name in ordered if is_trained(name)]
    made: dict[str, AgentStyle] = {}
    for i, name in enumerate(trained):
        again, place = divmod(i, len(_COLOURS))
        made[name] = AgentStyle(name, _COLOURS[place], _MARKERS[(place + again) % len(_MARKERS)])
    for name in ordered[len(trained) :]:
        place = standing(name) - 2
        made[name] = AgentStyle(name, _GREYS[place], _MARKERS[place])
    return made


def path(*parts: str) -> str:
    """Return an entity path of names that may hold any character."""
    return rr.new_entity_path([printable(part) for part in parts])


def log_scores(
    rec: rr.RecordingStream, rows: Sequence[RowSummary], agent_styles: Mapping[str, AgentStyle], last: int
) -> None:
    """Log A-Success and return of every row; an untrained agent is a horizontal line from step 0 to `last`."""
    for row in rows:
        style, learning = agent_styles[row.agent], row.learning
        if not is_trained(row.agent):
            x = np.linspace(0, last, _LEVEL_POINTS).astype(int).tolist()
            level = (values[-1:] * len(x) for values in (learning.value, learning.low, learning.high))
            learning = IntervalCurve(x, *level)
        _band(rec, path("score", row.task, row.agent), style, learning, marked=True)
        _band(rec, path("return", row.task, row.agent), style, row.returns, marked=False)


def log_policies(
    rec: rr.RecordingStream, policies: Sequence[TrainedModel], agent_styles: Mapping[str, AgentStyle]
) -> None:
    """Log the return of training episodes: a thin line per seed, a thick line for the mean where all have a value."""
    groups: dict[tuple[str, str], list[TrainedModel]] = {}
    for model in policies:
        groups.setdefault((model.group, model.name), []).append(model)
    for (task, agent), runs in groups.items():
        curves = [run.curve.known(RETURN) for run in runs]
        if len(runs) > 1:
            for i, (run, (x, y)) in enumerate(zip(runs, curves, strict=True)):
                name = f"{i}-seed-{run.seed}"
                _curve(rec, path("training", task, agent, "runs", name), agent_styles[agent], x, y, width=_THIN)
        common = sorted(set.intersection(*(set(x.tolist()) for x, _ in curves)))
        mean = np.mean([y[np.isin(x, common)] for x, y in curves], axis=0)
        _curve(rec, path("training", task, agent, "mean"), agent_styles[agent], common, mean)


def log_encoders(
    rec: rr.RecordingStream, encoders: Sequence[TrainedModel], agent_styles: Mapping[str, AgentStyle]
) -> None:
    """Log every column of the training curve of every encoder."""
    for model in encoders:
        for column in model.curve.columns[1:]:
            x, y = model.curve.known(column)
            _curve(rec, path("encoder", model.group, column, model.name), agent_styles[model.name], x, y)


def _band(rec: rr.RecordingStream, entity: str, style: AgentStyle, band: IntervalCurve, *, marked: bool) -> None:
    sizes = {"mean": (band.value, _THICK, 5.0), "low": (band.low, _EDGE, 1.5), "high": (band.high, _EDGE, 1.5)}
    for part, (values, width, size) in sizes.items():
        _curve(rec, f"{entity}/{part}", style, band.x, values, width=width)
        if marked:  # without a marker, a curve of one point would be invisible
            points = rr.SeriesPoints(
                names=printable(style.name), colors=style.colour, markers=style.marker, marker_sizes=size
            )
            rec.log(f"{entity}/{part}", points, static=True)


def _curve(
    rec: rr.RecordingStream, entity: str, style: AgentStyle, x: Numbers, y: Numbers, *, width: float = _THICK
) -> None:  # fmt: skip
    opacity = 255 if width == _THICK else _FAINT
    lines = rr.SeriesLines(names=printable(style.name), colors=(*style.colour, opacity), widths=width)
    rec.log(entity, lines, static=True)
    at = [rr.TimeColumn(TIMELINE, sequence=np.asarray(x, dtype=np.int64))]
    rec.send_columns(entity, at, rr.Scalars.columns(scalars=np.asarray(y, dtype=np.float64)))
