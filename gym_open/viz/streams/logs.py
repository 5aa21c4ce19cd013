"""Read streams from a log: a folder (also an unfinished one) or a single file; a damaged log up to the damage."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.contacts import thing_names
from gym_open.envs.physics.model import build_model, model_xml
from gym_open.formats.logs import Log, LogError, Segment, found_files, open_whole_part
from gym_open.formats.pngs import encode_pngs
from gym_open.viz.streams.model import (
    ACTION,
    CONTACTS,
    ENTROPY,
    LOSS,
    PART,
    PREVIEW_STEPS,
    REWARD,
    SPAN_STEPS,
    VALUE,
    ShownSegment,
    ShownStream,
    Span,
    known_of,
    overlap,
    segments_of,
)


def open_streams(source: Path, only: int | None = None) -> list[ShownStream]:
    """Open the streams of the log at `source`; this checks all bytes, but decodes only a few.

    Args:
        source: folder or file.
        only: number of the only stream to open; if there is no such stream, all are opened.

    Raises:
        ArtefactError: if there is no log, or the log has no complete step.
    """
    if source.is_file():
        return [_stream(open_whole_part([source]))]
    found = found_files(source)
    wanted = [only] if only in found else [*found]
    return [_stream(open_whole_part(list(found[stream].values()))) for stream in wanted]


def _stream(log: Log) -> ShownStream:
    first = next(log.segments(PREVIEW_STEPS), None)
    if first is None or not len(first.actions):
        raise LogError(f"{log.path}: no complete step, so nothing can be shown ({log.damage or 'it has no steps'})")
    _check_agent(log, first)
    steps = range(first.first_step, first.first_step + log.n_steps)
    begun = ShownSegment(first.index, first.world, steps, None, math.nan, math.nan)
    series = _series(first)
    return ShownStream(
        number=log.stream,
        steps=steps,
        config=log.config,
        worlds=len(log.puzzles),
        reward_parts=log.reward_parts,
        switches=log.switches,
        segments=segments_of(begun, log.switches, steps.stop),
        known=known_of(series),
        spans=lambda wanted: _spans(log, wanted, steps),
        depth=first.depth is not None,
        segmentation=first.segmentation is not None,
        geoms=geom_names() if log.model_xml == model_xml() else (),
        damage=log.damage,
    )


def _check_agent(log: Log, item: Segment) -> None:
    if "agent" not in item.object_names:
        raise LogError(f"{log.path}: segment {item.index}: no agent among its objects; give a log that gym-open wrote")


def geom_names() -> list[str]:
    """Names of the objects that the default world's geoms belong to, such as `agent`, `heavy_3`, `seen_wall_east`."""
    return thing_names(build_model(WorldOptions()))


def _spans(log: Log, wanted: range, all_steps: range) -> Iterator[Span]:
    for item in log.segments(SPAN_STEPS, None if wanted == all_steps else wanted):
        steps = overlap(wanted, range(item.first_step, item.first_step + len(item.actions)))
        if not steps:
            continue
        _check_agent(log, item)
        start, stop = steps.start - item.first_step, steps.stop - item.first_step
        yield Span(
            segment=item.index,
            world=item.world,
            puzzle=item.puzzle,
            continued=item.continued,
            first_step=steps.start,
            names=item.object_names,
            states=item.object_state[start : stop + 1],
            series={name: values[start:stop] for name, values in _series(item).items()},
            pngs=_encoder(item.images[start : stop + 1]),
            stuck=[change for change in log.stuck if steps.start < change.step <= steps.stop],
            begins=steps.start in (wanted.start, item.first_step - item.segment_step),
            contacts=item.contacts[start:stop],
            depth=None if item.depth is None else item.depth[start : stop + 1],
            segmentation=None if item.segmentation is None else item.segmentation[start : stop + 1],
        )


def _series(item: Segment) -> dict[str, np.ndarray]:
    return {
        REWARD: item.intrinsic_reward,
        **{PART + name: values for name, values in item.reward_parts.items()},
        LOSS: item.world_model_loss,
        ENTROPY: item.policy_entropy,
        VALUE: item.value,
        CONTACTS: np.array([len(step) for step in item.contacts], dtype=np.float64),
        ACTION: item.actions.astype(np.float64),
    }


def _encoder(images: np.ndarray) -> Callable[[np.ndarray], list[bytes]]:
    return lambda numbers: encode_pngs(images[numbers])
