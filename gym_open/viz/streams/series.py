"""Numbers over time: the series of the steps, the current world, and the losses of all worlds at each switch."""

import numpy as np
import rerun as rr
from rerun.components import MarkerShape

from gym_open.terminal import printable
from gym_open.viz.streams.model import ACTION, CONTACTS, ENTROPY, LOSS, PART, REWARD, VALUE, ShownStream, Span
from gym_open.viz.view import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, YELLOW, tensors, times

LINES = {
    REWARD: ("intrinsic reward", BLUE),
    LOSS: ("loss of the world", BLUE),
    ENTROPY: ("entropy (nats)", BLUE),
    VALUE: ("value", ORANGE),
    CONTACTS: ("contacts", ORANGE),
}
"""Name in the legend and colour of a series; two series of one plot have different colours."""
_PARTS = (ORANGE, GREEN, PURPLE, YELLOW, SKY)
_REASONS = {
    "start": (GREY, MarkerShape.Circle),
    "learned": (GREEN, MarkerShape.Up),
    "exhausted": (BLUE, MarkerShape.Square),
    "interval": (ORANGE, MarkerShape.Diamond),
    "uniform": (PURPLE, MarkerShape.Plus),
    "progress": (SKY, MarkerShape.Asterisk),
    "budget": (VERMILION, MarkerShape.Cross),
    "terminated": (VERMILION, MarkerShape.Down),
    "cut": (VERMILION, MarkerShape.Down),
}
"""Colour and marker of a switch by its reason."""


def series_entity(stream: str, name: str) -> str:
    """Entity of a series; special characters of the name are escaped."""
    return f"{stream}/series/" + "/".join(rr.escape_entity_path_part(part) for part in name.split("/", maxsplit=1))


def log_styles(rec: rr.RecordingStream, stream: ShownStream) -> None:
    """Log the name and colour of every series."""
    name = stream.name
    for series, (label, colour) in LINES.items():
        rec.log(series_entity(name, series), rr.SeriesLines(names=label, colors=colour), static=True)
    for number, part in enumerate(stream.reward_parts):
        style = rr.SeriesLines(names=f"part: {printable(part)}", colors=_PARTS[number % len(_PARTS)])
        rec.log(series_entity(name, PART + part), style, static=True)
    points = rr.SeriesPoints(names="action (0 = stay)", colors=BLUE, marker_sizes=1.5)
    rec.log(series_entity(name, ACTION), points, static=True)


def log_series(rec: rr.RecordingStream, stream: str, span: Span, numbers: np.ndarray) -> None:
    """Log every series of the span at the steps with these numbers (0…T − 1)."""
    at = times(span.first_step + numbers)
    for name, values in span.series.items():
        rec.send_columns(series_entity(stream, name), at, rr.Scalars.columns(scalars=values[numbers]))


def log_curriculum(rec: rr.RecordingStream, stream: ShownStream) -> None:
    """Log the current world, each switch with its reason, and the losses of all worlds at each switch."""
    name, switches = stream.name, stream.shown_switches()
    _log_lane(rec, stream)
    for reason in {item.reason for item in switches}:
        colour, marker = _REASONS[reason]
        to = [item for item in switches if item.reason == reason]
        style = rr.SeriesPoints(names=f"switch: {reason}", colors=colour, marker_sizes=4, markers=marker)
        rec.log(f"{name}/switches/{reason}", style, static=True)
        worlds = [item.to_world if item.to_world >= 0 else item.from_world for item in to]
        at = times([item.step for item in to])
        rec.send_columns(f"{name}/switches/{reason}", at, rr.Scalars.columns(scalars=worlds))
    if stream.threshold is not None:
        line = rr.Scalars.columns(scalars=[stream.threshold] * 2)
        # The line is thick, because only half of it is visible at the edge of a plot.
        style = rr.SeriesLines(names="threshold: learned", colors=VERMILION, widths=3)
        rec.log(f"{name}/threshold", style, static=True)
        rec.send_columns(f"{name}/threshold", times([stream.steps.start, stream.steps.stop]), line)
    _log_world_losses(rec, stream)


def _log_lane(rec: rr.RecordingStream, stream: ShownStream) -> None:
    segments = [segment for segment in stream.shown_segments() if segment.steps]
    style = rr.SeriesLines(names="world", colors=GREY, aggregation_policy="off")  # aggregation would slant the edges
    rec.log(f"{stream.name}/world", style, static=True)
    ends = [step for segment in segments for step in (segment.steps.start, segment.steps.stop - 1)]
    inside = np.clip(ends, stream.steps.start, stream.steps.stop - 1)
    lane = rr.Scalars.columns(scalars=[segment.world for segment in segments for _ in range(2)])
    rec.send_columns(f"{stream.name}/world", times(inside), lane)


def _log_world_losses(rec: rr.RecordingStream, stream: ShownStream) -> None:
    """Log the losses of all worlds at each switch as bars, and as one line per world, with gaps before its first visit.

    The losses of the last switch before the shown steps are logged at the first shown step.
    """
    every = stream.with_losses()
    switches = [
        *[item for item in every if item.step < stream.steps.start][-1:],
        *[item for item in every if item.step >= stream.steps.start],
    ]
    if not switches:
        return
    at = times([max(item.step, stream.steps.start) for item in switches])
    losses = np.array([item.world_losses for item in switches], dtype=np.float64)
    losses[~np.isfinite(losses)] = np.nan
    bars = [rr.BarChart(row) for row in losses]
    rec.send_columns(f"{stream.name}/world_losses", at, tensors(bars))
    worlds = losses.shape[1]
    colours = [(BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, YELLOW)[world % 7] for world in range(worlds)]
    names = [f"world {world}" for world in range(worlds)]
    alone = len(switches) == 1  # a line needs two points
    style = (
        rr.SeriesPoints(names=names, colors=colours, marker_sizes=4)
        if alone
        else rr.SeriesLines(names=names, colors=colours)
    )
    rec.log(f"{stream.name}/world_loss", style, static=True)
    values = rr.Scalars.columns(scalars=losses.ravel()).partition([worlds] * len(switches))
    rec.send_columns(f"{stream.name}/world_loss", at, values)
