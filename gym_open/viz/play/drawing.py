"""A stream of play as Rerun entities, written by columns.

Timelines `step` (steps the stream has taken) and `sim_time` (the same in nominal seconds). What is known of a step,
its action, reward and contacts, stands at the number of the step, with the observation before the action. At the step
of a switch the new world's first observation is shown; the old world's last one would be at the same step and is left
out, but for the stream's very last.

    <stream>/observation/{image, depth, segmentation}   PNG; metres; geom ids with their names
    <stream>/table/{ground, top, walls, pen, patch, ramp}  scenery, of the world that the stream is in
    <stream>/table/{agent, yellow, green, …}            the objects that are there
    <stream>/table/{trail, move, contacts}              where the agent was; the push that it gives itself; touches
    <stream>/series/…, <stream>/threshold               numbers a step; the loss under which a world is learned
    <stream>/world, <stream>/switches/REASON            which world of the pool, and when and why it switched
    <stream>/world_losses, <stream>/world_loss          loss of every world at each switch: as bars, as lines
    <stream>/coverage                                   after how many steps the agent was in each cell so far
    <stream>/events                                     switches, what got stuck, damage, in words
    <stream>/segments, <stream>/segments/segment_NNNN   the list of segments; facts of each
"""

import math

import numpy as np
import rerun as rr

from gym_open import progress
from gym_open.viz.config import VizConfig
from gym_open.viz.play import events, images, series, table
from gym_open.viz.play.images import Coverage
from gym_open.viz.play.streams import ACTION, Span, Stream
from gym_open.viz.view import times


def log_stream(rec: rr.RecordingStream, stream: Stream, config: VizConfig) -> None:
    """Write everything of one stream into the recording, what is known before its steps are read first."""
    name, tally, coverage = stream.name, events.Tally(rec, stream), Coverage()
    trail = table.Trail(config.trail_steps)
    table.log_table(rec, f"{name}/table")
    table.log_styles(rec, f"{name}/table")
    if stream.segmentation:
        images.log_classes(rec, name, stream.geoms)
    series.log_styles(rec, stream)
    series.log_curriculum(rec, stream)
    events.log_switches(rec, stream)
    events.log_list(rec, stream)
    total = len(stream.steps)
    with progress.bar(f"viz {name.replace('_', ' ')}", total) as bar:
        for span in stream.spans(stream.steps):
            last = span.steps.stop == stream.steps.stop
            shown = thinned(span, total, config.max_images, last=last)
            if shown.size:
                images.log_pictures(rec, name, span, shown)
            poses = thinned(span, total, config.max_poses, last=last)
            _log_table(rec, f"{name}/table", span, poses)
            agent = span.states[:, span.names.index("agent"), :3]
            trail.log(rec, f"{name}/table", agent, span.first_step, poses, begins=span.begins)
            points = thinned(span, total, config.max_points, last=False)
            if points.size:
                series.log_series(rec, name, span, points)
            places = agent[1:, :2]
            coverage.log(rec, name, span.first_step, places, shown)
            events.log_stuck(rec, name, span.stuck)
            tally.add(span, places)
            bar.advance(len(span.steps))
    tally.finish()


def thinned(span: Span, total: int, limit: int, *, last: bool) -> np.ndarray:
    """Numbers, within the span, of the steps to show: every k-th of the stream, and the first of a segment.

    Args:
        span: the steps to choose from.
        total: steps of the stream that are to be shown.
        limit: k = ceil(total / limit).
        last: whether what is shown ends here, so that the final observation is shown too.
    """
    every = math.ceil(max(total, 1) / limit)
    number = np.arange(len(span.steps))
    keep = number[((span.first_step + number) % every == 0) | ((number == 0) & span.begins)]
    return np.append(keep, len(span.steps)) if last else keep


def _log_table(rec: rr.RecordingStream, entity: str, span: Span, numbers: np.ndarray) -> None:
    if span.begins:
        table.log_scenery(rec, entity, span.puzzle, times([span.first_step]))
    if not numbers.size:
        return
    states = span.states[numbers]
    table.log_objects(rec, entity, span.names, states, span.first_step + numbers, begins=span.begins)
    acting = numbers[numbers < len(span.steps)]
    if acting.size:
        steps = span.first_step + acting
        agent = states[: len(acting), span.names.index("agent"), :3]
        table.log_moves(rec, entity, agent, span.series[ACTION][acting].astype(np.int64), steps)
        if span.contacts is not None:
            table.log_contacts(rec, entity, [span.contacts[number] for number in acting], steps)
