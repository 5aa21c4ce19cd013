"""Events as text: switches, what got stuck, damage; and the list of segments with facts about each segment."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open.formats.logs import Stuck, Switch
from gym_open.markdown import cell, table
from gym_open.terminal import printable
from gym_open.viz.streams.images import CoverageMap
from gym_open.viz.streams.model import CONTACTS, REWARD, ShownSegment, ShownStream, Span
from gym_open.viz.view import log_document, times

_MOST = 6
"""Number of losses in the text of a switch, from the highest."""
_HOW = """\
A segment consists of uninterrupted steps in one world. Each number links to an entity with facts about the segment. To
see them, follow the link, or select the entity under `stream_{stream}/segments` in the list of streams (bottom panel),
and look at the selection panel (right edge). To open a single segment, use `--stream {stream} --segment NUMBER`.
*Loss in* and *out* are the losses of the world at the start and at the end of the segment: *new* means that the world
was never visited before, *–* that the loss is unknown."""
MOST_LISTED = 300
"""Limit of segments in the document: Rerun draws a whole document in every frame."""


def log_switches(rec: rr.RecordingStream, stream: ShownStream) -> None:
    """Log every switch in the shown steps, and the damage after the last step."""
    switches = stream.shown_switches()
    _log(rec, stream.name, [item.step for item in switches], [describe(item) for item in switches], "INFO")
    if stream.damage is not None:
        words = f"the log is damaged after step {stream.steps.stop - 1}: {printable(stream.damage)}"
        _log(rec, stream.name, [stream.steps.stop], [words], "ERROR")


def log_stuck(rec: rr.RecordingStream, stream: str, stuck: Sequence[Stuck]) -> None:
    """Log the objects that got stuck or free again."""
    for began, level in ((True, "WARN"), (False, "INFO")):
        some = [item for item in stuck if item.began == began]
        _log(rec, stream, [item.step for item in some], [describe_stuck(item) for item in some], level)


def _log(rec: rr.RecordingStream, stream: str, steps: Sequence[int], texts: Sequence[str], level: str) -> None:
    if texts:
        columns = rr.TextLog.columns(text=texts, level=[level] * len(texts))
        rec.send_columns(f"{stream}/events", times(steps), columns)


def describe(switch: Switch) -> str:
    """Describe a switch, with the highest losses at that step if there are any."""
    known = sorted(
        ((loss, world) for world, loss in enumerate(switch.world_losses) if math.isfinite(loss)), reverse=True
    )
    start = "begin" if switch.from_world < 0 else f"world {switch.from_world}"
    goal = "end" if switch.to_world < 0 else f"world {switch.to_world}"
    unseen = sum(map(math.isinf, switch.world_losses))
    if not known and not unseen:
        return f"{start} → {goal} ({switch.reason}); no world model"
    losses = ", ".join(f"{world}: {loss:.2g}" for loss, world in known[:_MOST])
    rest = f", {len(known) - _MOST} lower" if len(known) > _MOST else ""
    return f"{start} → {goal} ({switch.reason}); losses {losses or 'none yet'}{rest}; {unseen} worlds never visited"


def describe_stuck(stuck: Stuck) -> str:
    """Describe what is stuck or free again, and where."""
    how = ("stuck in a corner" if stuck.kind == "corner" else "stuck") if stuck.began else "free again"
    return printable(f"{stuck.name} {how} at ({stuck.position[0]:.2f}, {stuck.position[1]:.2f}) m")


def segment_entity(stream: str, number: int) -> str:
    """Entity with the facts about a segment."""
    return f"{stream}/segments/segment_{number:04d}"


def log_list(rec: rr.RecordingStream, stream: ShownStream) -> None:
    """Log the list of segments."""
    log_document(rec, f"{stream.name}/segments", list_of(stream))


def list_of(stream: ShownStream) -> str:
    """A Markdown table with one row per segment and a link to the segment's entity."""
    segments = stream.shown_segments()
    losses = bool(stream.with_losses())
    head = ["", "world", "from", "steps", *(["loss in", "out"] if losses else []), "ended"]
    rows = [
        [
            f"[{item.number}](recording://{segment_entity(stream.name, item.number)})",
            str(item.world),
            f"{item.steps.start:,}",
            f"{len(item.steps):,}",
            *([loss_text(item.loss_at_entry), loss_text(item.loss_at_exit)] if losses else []),
            cell(item.ended or "goes on"),
        ]
        for item in segments[:MOST_LISTED]
    ]
    lines = [
        f"# Segments of stream {stream.number}: {len(segments)}",
        _HOW.format(stream=stream.number),
        "",
        *table(head, rows),
    ]
    if len(segments) > MOST_LISTED:
        lines.append(
            f"\n{len(segments) - MOST_LISTED} more segments are in the events and under `{stream.name}/segments`."
        )
    return "\n".join(lines)


def loss_text(loss: float) -> str:
    """A short text for the loss of a world."""
    if math.isnan(loss):
        return "–"
    return "new" if math.isinf(loss) else f"{loss:.2g}"


class SegmentCounter:
    """Count facts about segments, span by span, and log them at the end of each segment."""

    def __init__(self, rec: rr.RecordingStream, stream: ShownStream) -> None:
        self._rec, self._stream = rec, stream
        self._segments = {segment.number: segment for segment in stream.segments}
        self._spans: list[Span] = []
        self._facts: dict[str, float] = {}
        self._coverage = CoverageMap()

    def add(self, span: Span, places: np.ndarray) -> None:
        """Count a span; `places` are the agent's positions after each step, (T, 2 or more)."""
        if self._spans and self._spans[-1].segment != span.segment:
            self.finish()
        if not self._spans:
            self._coverage, self._facts = CoverageMap(), {"steps": 0.0, "reward": 0.0, "contacts": 0.0, "stuck": 0.0}
        self._spans = [span]
        self._coverage.add(places)
        self._facts["steps"] += len(span.steps)
        self._facts["reward"] += float(np.nansum(span.series[REWARD]))
        self._facts["contacts"] += float(np.nansum(span.series[CONTACTS]))
        self._facts["stuck"] += sum(item.began for item in span.stuck)

    def finish(self) -> None:
        """Log the current segment, if there is one."""
        if not self._spans:
            return
        span, facts = self._spans.pop(), self._facts
        segment = self._segments.get(span.segment)
        components: dict[str, object] = {
            "world": span.world,
            "continued": "yes: from the world's last state" if span.continued else "no: from the puzzle's layout",
            "steps_shown": int(facts["steps"]),
            "mean_intrinsic_reward": facts["reward"] / max(facts["steps"], 1),
            "contacts": int(facts["contacts"]),
            "times_stuck": int(facts["stuck"]),
            "cells_visited": int((self._coverage.counts > 0).sum()),
            **(_segment_facts(segment) if segment else {}),
        }
        archetype = rr.DynamicArchetype("Segment", components=components)
        self._rec.log(segment_entity(self._stream.name, span.segment), archetype, static=True)


def _segment_facts(segment: ShownSegment) -> dict[str, object]:
    return {
        "first_step": segment.steps.start,
        "steps": len(segment.steps),
        "ended": segment.ended or "goes on",
        "loss_at_entry": segment.loss_at_entry,
        "loss_at_exit": segment.loss_at_exit,
    }
