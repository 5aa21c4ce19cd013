"""A stream as Rerun entities, written column by column.

The timelines are `step` (steps that the stream has taken) and `sim_time` (the same in nominal seconds). A step's
action, reward and contacts have the number of the step, like the observation before the action. At the step of a
switch, the first observation of the new world is shown. The last observation of the old world would have the same step
and is left out, except at the end of the stream.

    <stream>/observation/{image, depth, segmentation}   PNG; metres; geom ids with their names
    <stream>/table/{ground, top, walls, pen, patch, ramp}  scenery of the current world
    <stream>/table/{agent, yellow, green, …}            objects on the table
    <stream>/table/{trail, move, contacts}              the agent's path; its push; contacts
    <stream>/series/…, <stream>/threshold               numbers per step; the loss below which a world is learned
    <stream>/world, <stream>/switches/REASON            current world of the pool; when and why it switched
    <stream>/world_losses, <stream>/world_loss          loss of every world at each switch, as bars and as lines
    <stream>/coverage                                   number of steps so far after which the agent was in each cell
    <stream>/events                                     switches, what got stuck, and damage, as text
    <stream>/segments, <stream>/segments/segment_NNNN   list of segments; facts about each segment
"""

import math

import numpy as np
import rerun as rr

from gym_open import progress
from gym_open.viz.config import VizConfig
from gym_open.viz.streams import events, images, series, table
from gym_open.viz.streams.images import CoverageMap
from gym_open.viz.streams.model import ACTION, ShownStream, Span
from gym_open.viz.view import times


def log_stream(rec: rr.RecordingStream, stream: ShownStream, config: VizConfig) -> None:
    """Write one stream into the recording, first what is known before its steps are read."""
    name, counter, coverage = stream.name, events.SegmentCounter(rec, stream), CoverageMap()
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
                images.log_images(rec, name, span, shown)
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
            counter.add(span, places)
            bar.advance(len(span.steps))
    counter.finish()


def thinned(span: Span, total: int, limit: int, *, last: bool) -> np.ndarray:
    """Numbers, within the span, of the steps to show: every k-th of the stream, and the first of a segment.

    Args:
        span: the steps to choose from.
        total: number of selected steps of the stream.
        limit: decides k = ceil(total / limit).
        last: whether the selected steps end with this span, so that the final observation is shown too.
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
