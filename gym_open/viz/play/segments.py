"""Segments that can be picked: a document that lists them, and an entity of each with what came of it."""

import math

import numpy as np
import rerun as rr

from gym_open.viz.play.coverage import Coverage
from gym_open.viz.play.streams import CONTACTS, REWARD, Span, Stay, Stream
from gym_open.viz.words import cell, table

_HOW = """\
A segment is play in one world without interruption. What came of it stands in the entity of its name, which the link
is to: select it there, or under `stream_{stream}/segments` in the list of streams (the panel at the bottom), and look
at the selection panel (at the right edge). One segment alone is opened with `--stream {stream} --segment NUMBER`.
*Loss in* and *out* are the losses of its world when it was entered and left: *new* if it was never visited before, *–*
if it is not known."""
MOST_LISTED = 300
"""Segments of a document: Rerun draws all of it in every frame."""


def segment_entity(stream: str, number: int) -> str:
    """Entity with the facts of a segment."""
    return f"{stream}/segments/segment_{number:04d}"


def log_list(rec: rr.RecordingStream, stream: Stream) -> None:
    """Log the document: a row a segment, each with a link to its entity."""
    rec.log(f"{stream.name}/segments", rr.TextDocument(list_of(stream), media_type="text/markdown"), static=True)


def list_of(stream: Stream) -> str:
    """The document, in Markdown."""
    stays = stream.shown_stays()
    losses = bool(stream.with_losses())
    head = ["", "world", "from", "steps", *(["loss in", "out"] if losses else []), "ended"]
    rows = [
        [
            f"[{stay.number}](recording://{segment_entity(stream.name, stay.number)})",
            str(stay.world),
            f"{stay.steps.start:,}",
            f"{len(stay.steps):,}",
            *([loss_text(stay.loss_at_entry), loss_text(stay.loss_at_exit)] if losses else []),
            cell(stay.ended or "goes on"),
        ]
        for stay in stays[:MOST_LISTED]
    ]
    lines = [
        f"# Segments of stream {stream.number}: {len(stays)}",
        _HOW.format(stream=stream.number),
        "",
        *table(head, rows),
    ]
    if len(stays) > MOST_LISTED:
        lines.append(f"\n{len(stays) - MOST_LISTED} more are in the events and under `{stream.name}/segments`.")
    return "\n".join(lines)


def loss_text(loss: float) -> str:
    """A loss of a world in a few characters."""
    if math.isnan(loss):
        return "–"
    return "new" if math.isinf(loss) else f"{loss:.2g}"


class Tally:
    """Counts what comes of segments, span by span, and logs each when it is over."""

    def __init__(self, rec: rr.RecordingStream, stream: Stream) -> None:
        self._rec, self._stream = rec, stream
        self._stays = {stay.number: stay for stay in stream.stays}
        self._spans: list[Span] = []
        self._facts: dict[str, float] = {}
        self._coverage = Coverage()

    def add(self, span: Span, places: np.ndarray) -> None:
        """Count a span; `places` (T, 2 or more) is where the agent was after each step."""
        if self._spans and self._spans[-1].segment != span.segment:
            self.finish()
        if not self._spans:
            self._coverage, self._facts = Coverage(), {"steps": 0.0, "reward": 0.0, "contacts": 0.0, "stuck": 0.0}
        self._spans = [span]
        self._coverage.add(places)
        self._facts["steps"] += len(span.steps)
        self._facts["reward"] += float(np.nansum(span.series[REWARD]))
        self._facts["contacts"] += float(np.nansum(span.series[CONTACTS]))
        self._facts["stuck"] += sum(one.began for one in span.stuck)

    def finish(self) -> None:
        """Log the segment that is counted, if there is one."""
        if not self._spans:
            return
        span, facts = self._spans.pop(), self._facts
        stay = self._stays.get(span.segment)
        components: dict[str, object] = {
            "world": span.world,
            "continued": "yes: from where it was left" if span.continued else "no: from its puzzle's layout",
            "steps_shown": int(facts["steps"]),
            "mean_intrinsic_reward": facts["reward"] / max(facts["steps"], 1),
            "contacts": int(facts["contacts"]),
            "times_stuck": int(facts["stuck"]),
            "cells_visited": int((self._coverage.counts > 0).sum()),
            **(_of_stay(stay) if stay else {}),
        }
        facts_of = rr.DynamicArchetype("Segment", components=components)
        self._rec.log(segment_entity(self._stream.name, span.segment), facts_of, static=True)


def _of_stay(stay: Stay) -> dict[str, object]:
    return {
        "first_step": stay.steps.start,
        "steps": len(stay.steps),
        "ended": stay.ended or "goes on",
        "loss_at_entry": stay.loss_at_entry,
        "loss_at_exit": stay.loss_at_exit,
    }
