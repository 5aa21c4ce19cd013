"""Curves as Rerun series, and what is said about them as documents and figures.

Rerun draws all plots over one timeline. It is called `step`, and each plot's name says what is counted on it: agent
steps of fine-tuning, actions of an episode, gradient updates of an encoder.

    score/<task>/<agent>/{mean, low, high}                                      A-Success
    return/<task>/<agent>/{mean, low, high}                                     mean return within so many actions
    training/<task>/<agent>/{mean, runs/<run>}                                  mean return of training episodes
    encoder/<world model>/<column>/<encoder>                                    figures of world models
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
from rerun.components import MarkerShapeLike

from gym_open.terminal import printable
from gym_open.viz.curves.rows import Band, Row, standing
from gym_open.viz.curves.sources import Learned

TIMELINE = "step"
RETURN = "mean_return"
"""Column of a policy's curve that is drawn."""
_COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233))
"""Okabe and Ito's, without black and yellow, which vanish on one of Rerun's two grounds."""
_GREYS = ((165, 165, 165), (90, 90, 90), (130, 130, 130))
"""Of `FIXED`."""
_MARKERS: tuple[MarkerShapeLike, ...] = ("circle", "square", "up", "diamond", "cross", "down", "plus")
_THICK, _THIN, _EDGE = 2.5, 0.8, 0.6
_LEVEL_POINTS = 9
_FAINT = 110
"""Opacity of single runs and of intervals, of 255."""

Numbers = Sequence[int] | Sequence[float] | np.ndarray


class Style(NamedTuple):
    """How an agent is drawn everywhere."""

    name: str
    colour: tuple[int, int, int]
    marker: MarkerShapeLike


def styles(agents: Iterable[str]) -> dict[str, Style]:
    """A colour and a marker each; after the last colour they come again, with other markers."""
    ordered = sorted(set(agents), key=lambda name: (standing(name), name))
    trained = [name for name in ordered if not standing(name)]
    made: dict[str, Style] = {}
    for i, name in enumerate(trained):
        again, place = divmod(i, len(_COLOURS))
        made[name] = Style(name, _COLOURS[place], _MARKERS[(place + again) % len(_MARKERS)])
    for name in ordered[len(trained) :]:
        place = standing(name) - 1
        made[name] = Style(name, _GREYS[place], _MARKERS[place])
    return made


def path(*parts: str) -> str:
    """An entity path of names that may hold anything."""
    return rr.new_entity_path([printable(part) for part in parts])


def log_scores(rec: rr.RecordingStream, rows: Sequence[Row], looks: Mapping[str, Style], last: int) -> None:
    """A-Success and return of every row; what no training made is a level from 0 to `last`, in steps."""
    for row in rows:
        style, learning = looks[row.agent], row.learning
        if standing(row.agent):
            x = np.linspace(0, last, _LEVEL_POINTS).astype(int).tolist()
            level = (values[-1:] * len(x) for values in (learning.value, learning.low, learning.high))
            learning = Band(x, *level)
        _band(rec, path("score", row.task, row.agent), style, learning, marked=True)
        _band(rec, path("return", row.task, row.agent), style, row.returns, marked=False)


def log_policies(rec: rr.RecordingStream, policies: Sequence[Learned], looks: Mapping[str, Style]) -> None:
    """The return of training episodes: thin a seed, thick their mean where all have a value."""
    groups: dict[tuple[str, str], list[Learned]] = {}
    for one in policies:
        groups.setdefault((one.group, one.name), []).append(one)
    for (task, agent), runs in groups.items():
        curves = [run.curve.known(RETURN) for run in runs]
        if len(runs) > 1:
            for i, (run, (x, y)) in enumerate(zip(runs, curves, strict=True)):
                name = f"{i}-seed-{run.seed}"
                _curve(rec, path("training", task, agent, "runs", name), looks[agent], x, y, width=_THIN)
        common = sorted(set.intersection(*(set(x.tolist()) for x, _ in curves)))
        mean = np.mean([y[np.isin(x, common)] for x, y in curves], axis=0)
        _curve(rec, path("training", task, agent, "mean"), looks[agent], common, mean)


def log_encoders(rec: rr.RecordingStream, encoders: Sequence[Learned], looks: Mapping[str, Style]) -> None:
    """Every figure of every encoder's training."""
    for one in encoders:
        for column in one.curve.columns[1:]:
            x, y = one.curve.known(column)
            _curve(rec, path("encoder", one.group, column, one.name), looks[one.name], x, y)


def _band(rec: rr.RecordingStream, entity: str, style: Style, band: Band, *, marked: bool) -> None:
    sizes = {"mean": (band.value, _THICK, 5.0), "low": (band.low, _EDGE, 1.5), "high": (band.high, _EDGE, 1.5)}
    for part, (values, width, size) in sizes.items():
        _curve(rec, f"{entity}/{part}", style, band.x, values, width=width)
        if marked:  # a curve of one point would not be seen otherwise
            points = rr.SeriesPoints(
                names=printable(style.name), colors=style.colour, markers=style.marker, marker_sizes=size
            )
            rec.log(f"{entity}/{part}", points, static=True)


def _curve(
    rec: rr.RecordingStream, entity: str, style: Style, x: Numbers, y: Numbers, *, width: float = _THICK
) -> None:  # fmt: skip
    opacity = 255 if width == _THICK else _FAINT
    lines = rr.SeriesLines(names=printable(style.name), colors=(*style.colour, opacity), widths=width)
    rec.log(entity, lines, static=True)
    at = [rr.TimeColumn(TIMELINE, sequence=np.asarray(x, dtype=np.int64))]
    rec.send_columns(entity, at, rr.Scalars.columns(scalars=np.asarray(y, dtype=np.float64)))
