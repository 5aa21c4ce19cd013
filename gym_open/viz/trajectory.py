"""A stream of play as Rerun entities, written by columns.

Timelines `step` (steps the stream has taken) and `sim_time` (the same in simulated seconds). At the step of a switch
the new world's first observation is shown; the old world's last one would be at the same step and is left out, but for
the stream's very last.

    <stream>/observation                         pictures, PNG
    <stream>/table/{top, walls, pen, patch}      scenery, of the world that the stream is in
    <stream>/table/{agent, yellow, green, …}     the objects that are there
    <stream>/table/{trail, move}                 where the agent was; the push that it gives itself
    <stream>/series/…, <stream>/threshold        numbers a step; the loss under which a world is learned
    <stream>/world, <stream>/events              which world of the pool; switches in words
"""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open import progress
from gym_open.envs import constants as c
from gym_open.formats.logs import Switch
from gym_open.viz.config import VizConfig
from gym_open.viz.scenery import log_scenery, log_table
from gym_open.viz.spans import Span, Stream

SPHERES = ("agent", "yellow", "green", "push")
HALF_SIZES: dict[str, tuple[float, float, float]] = {
    **dict.fromkeys(c.CAPACITY, (c.RADIUS, c.RADIUS, c.RADIUS)),
    "rectangle": (c.RECTANGLE_LENGTH / 2, c.RADIUS, c.RADIUS),
}
"""Of each kind's box or ball; a cone is shown as the box around it."""
PARKED_Y = -15.0
"""An object beyond this y is not on the table: the model parks unused ones 30 m behind the camera."""
ARROW = 0.12
"""Length in metres of the arrow of a move along one axis."""
BLUE, _ORANGE, _GREY = (86, 180, 233), (230, 159, 0), (150, 150, 150)
"""Told apart by colour-blind readers (Okabe and Ito)."""


def times(steps: Sequence[int] | np.ndarray) -> list[rr.TimeColumn]:
    """Both timelines at these steps."""
    row = np.asarray(steps, dtype=np.int64)
    return [rr.TimeColumn("step", sequence=row), rr.TimeColumn("sim_time", duration=row * c.CONTROL_DT_S)]


def log_stream(rec: rr.RecordingStream, stream: Stream, config: VizConfig) -> None:
    """Write everything of one stream into the recording."""
    log_table(rec, f"{stream.name}/table")
    _log_styles(rec, stream)
    _log_switches(rec, stream)
    with progress.bar(f"viz {stream.name}", stream.steps) as bar:
        for span in stream.spans():
            last = span.first_step + span.steps == stream.steps
            _log_pictures(rec, stream, span, thinned(span, stream.steps, config.max_images, last=last))
            _log_objects(rec, stream, span, thinned(span, stream.steps, config.max_poses, last=last))
            log_scenery(rec, f"{stream.name}/table", span.puzzle, times([span.first_step]))
            _log_series(rec, stream, span)
            bar.advance(span.steps)


def thinned(span: Span, total: int, limit: int, *, last: bool) -> np.ndarray:
    """Numbers, within the span, of the observations to show: every k-th step of the stream and the span's first.

    Args:
        span: the steps to choose from.
        total: steps of the stream.
        limit: k = ceil(total / limit).
        last: whether the stream ends here, so that the final observation is shown too.
    """
    every = math.ceil(max(total, 1) / limit)
    number = np.arange(span.steps)
    keep = number[((span.first_step + number) % every == 0) | (number == 0)]
    return np.append(keep, span.steps) if last else keep


def _log_pictures(rec: rr.RecordingStream, stream: Stream, span: Span, numbers: np.ndarray) -> None:
    if numbers.size:
        columns = rr.EncodedImage.columns(blob=span.pngs(numbers), media_type=["image/png"] * len(numbers))
        rec.send_columns(f"{stream.name}/observation", times(span.first_step + numbers), columns)


def _log_objects(rec: rr.RecordingStream, stream: Stream, span: Span, numbers: np.ndarray) -> None:
    if not numbers.size:
        return
    at, count = times(span.first_step + numbers), len(numbers)
    states = span.states[numbers].astype(np.float32)
    for kind, half_size in HALF_SIZES.items():
        names = [
            (i, name)
            for i, name in enumerate(span.names)
            if name.split("_")[0] == kind and span.states[0, i, 1] > PARKED_Y
        ]
        there = [i for i, _ in names]
        centres = states[:, there, :3].reshape(-1, 3)
        quaternions = states[:, there, 3:7][..., [1, 2, 3, 0]].reshape(-1, 4)  # Rerun wants x, y, z, w
        archetype = rr.Ellipsoids3D if kind in SPHERES else rr.Boxes3D
        entity = f"{stream.name}/table/{kind}"
        moving = archetype.columns(centers=centres, quaternions=quaternions)
        rec.send_columns(entity, at, moving.partition([len(there)] * count))
        fixed = archetype.columns(
            half_sizes=np.tile(np.array(half_size, np.float32), (len(there), 1)),
            colors=[c.COLOUR[kind]] * len(there),
            labels=[name for _, name in names],
            fill_mode=[rr.components.FillMode.Solid] * len(there),
            show_labels=[False] * len(there),
        )
        rec.send_columns(entity, times([span.first_step]), fixed.partition([len(there)]))
    agent = states[:, span.names.index("agent"), :3]
    rec.send_columns(f"{stream.name}/table/trail", at, rr.Points3D.columns(positions=agent))
    acting = numbers[numbers < span.steps]
    moves = np.array(c.MOVES)[span.series["action"][acting]]
    arrows = rr.Arrows3D.columns(origins=agent[: len(acting)], vectors=ARROW * np.pad(moves, ((0, 0), (0, 1))))
    rec.send_columns(f"{stream.name}/table/move", times(span.first_step + acting), arrows)


def _log_series(rec: rr.RecordingStream, stream: Stream, span: Span) -> None:
    if not span.steps:
        return
    at = times(span.first_step + np.arange(span.steps))
    for name, values in span.series.items():
        rec.send_columns(f"{stream.name}/series/{name}", at, rr.Scalars.columns(scalars=values))
    ends = times([span.first_step, span.first_step + span.steps - 1])
    rec.send_columns(f"{stream.name}/world", ends, rr.Scalars.columns(scalars=[span.world] * 2))


def _log_switches(rec: rr.RecordingStream, stream: Stream) -> None:
    at = times([item.step for item in stream.switches])
    if stream.threshold is not None:
        line = rr.Scalars.columns(scalars=[stream.threshold] * 2)
        rec.send_columns(f"{stream.name}/threshold", times([0, stream.steps]), line)
    worlds = rr.Scalars.columns(scalars=[item.to_world for item in stream.switches])
    rec.send_columns(f"{stream.name}/switches", at, worlds)
    text = rr.TextLog.columns(text=[describe(item) for item in stream.switches])
    rec.send_columns(f"{stream.name}/events", at, text)


def describe(switch: Switch) -> str:
    """A switch in words, with the losses that it was decided by, if there were any."""
    known = [(loss, world) for world, loss in enumerate(switch.world_losses) if math.isfinite(loss)]
    losses = ", ".join(f"{world}: {loss:.2g}" for loss, world in sorted(known, reverse=True))
    start = "begin" if switch.from_world < 0 else f"world {switch.from_world}"
    goal = "end" if switch.to_world < 0 else f"world {switch.to_world}"
    unseen = sum(map(math.isinf, switch.world_losses))
    if not known and not unseen:
        return f"{start} → {goal} ({switch.reason}); no world model"
    return f"{start} → {goal} ({switch.reason}); losses {losses or 'none yet'}; {unseen} worlds never visited"


def _log_styles(rec: rr.RecordingStream, stream: Stream) -> None:
    name = stream.name
    for series in ("intrinsic_reward", "world_model_loss", "entropy", "value", "contacts"):
        colour = _ORANGE if series in {"value", "contacts"} else BLUE  # the second of a pair in one plot
        rec.log(f"{name}/series/{series}", rr.SeriesLines(names=series.replace("_", " "), colors=colour), static=True)
    rec.log(f"{name}/series/action", rr.SeriesPoints(names="action", colors=BLUE, marker_sizes=1.5), static=True)
    rec.log(f"{name}/threshold", rr.SeriesLines(names="threshold", colors=_ORANGE), static=True)
    lane = rr.SeriesLines(names="world of the pool", colors=_GREY, aggregation_policy="off")  # else edges turn slanted
    rec.log(f"{name}/world", lane, static=True)
    rec.log(
        f"{name}/switches", rr.SeriesPoints(names="switched to", colors=_ORANGE, marker_sizes=4, markers="diamond"),
        static=True,
    )  # fmt: skip
    rec.log(f"{name}/table/trail", rr.Points3D.from_fields(radii=0.012, colors=c.COLOUR["agent"]), static=True)
    rec.log(f"{name}/table/move", rr.Arrows3D.from_fields(radii=0.008, colors=(255, 255, 255)), static=True)
