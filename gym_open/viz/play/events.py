"""What happened, in words: switches, what got stuck, damage, the list of segments, and facts about each of them."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open.formats.logs import Stuck, Switch
from gym_open.markdown import cell, table
from gym_open.terminal import printable
from gym_open.viz.play.images import Coverage
from gym_open.viz.play.streams import CONTACTS, REWARD, Span, Stay, Stream
from gym_open.viz.view import log_document, times

_MOST = 6
"""Losses that are told of a switch, the highest first."""
_HOW = """\
A segment is play in one world without interruption. What came of it stands in the entity of its name, which the link
is to: select it there, or under `stream_{stream}/segments` in the list of streams (the panel at the bottom), and look
at the selection panel (at the right edge). One segment alone is opened with `--stream {stream} --segment NUMBER`.
*Loss in* and *out* are the losses of its world when it was entered and left: *new* if it was never visited before, *–*
if it is not known."""
MOST_LISTED = 300
"""Segments of a document: Rerun draws all of it in every frame."""


def log_switches(rec: rr.RecordingStream, stream: Stream) -> None:
    """Log every switch among the steps shown, and the damage behind the last of them."""
    switches = stream.shown_switches()
    _log(rec, stream.name, [item.step for item in switches], [describe(item) for item in switches], "INFO")
    if stream.damage is not None:
        words = f"the log ends here, after step {stream.steps.stop - 1}: {printable(stream.damage)}"
        _log(rec, stream.name, [stream.steps.stop], [words], "ERROR")


def log_stuck(rec: rr.RecordingStream, stream: str, stuck: Sequence[Stuck]) -> None:
    """Log what began or ceased to be stuck."""
    for began, level in ((True, "WARN"), (False, "INFO")):
        some = [one for one in stuck if one.began == began]
        _log(rec, stream, [one.step for one in some], [describe_stuck(one) for one in some], level)


def _log(rec: rr.RecordingStream, stream: str, steps: Sequence[int], texts: Sequence[str], level: str) -> None:
    if texts:
        columns = rr.TextLog.columns(text=texts, level=[level] * len(texts))
        rec.send_columns(f"{stream}/events", times(steps), columns)


def describe(switch: Switch) -> str:
    """A switch in words, with the highest losses that it was decided by, if there were any."""
    known = sorted(
        ((loss, world) for world, loss in enumerate(switch.world_losses) if math.isfinite(loss)), reverse=True
    )
    start = "begin" if switch.from_world < 0 else f"world {switch.from_world}"
    goal = "end" if switch.to_world < 0 else f"world {switch.to_world}"
    unseen = sum(map(math.isinf, switch.world_losses))
    if not known and not unseen:
        return f"{start} → {goal} ({switch.reason}); no world model"
    told = ", ".join(f"{world}: {loss:.2g}" for loss, world in known[:_MOST])
    rest = f", {len(known) - _MOST} lower" if len(known) > _MOST else ""
    return f"{start} → {goal} ({switch.reason}); losses {told or 'none yet'}{rest}; {unseen} worlds never visited"


def describe_stuck(stuck: Stuck) -> str:
    """Who is stuck or free again, and where, in metres."""
    how = ("stuck in a corner" if stuck.kind == "corner" else "stuck") if stuck.began else "free again"
    return printable(f"{stuck.name} {how} at ({stuck.position[0]:.2f}, {stuck.position[1]:.2f}) m")


def segment_entity(stream: str, number: int) -> str:
    """Entity with the facts of a segment."""
    return f"{stream}/segments/segment_{number:04d}"


def log_list(rec: rr.RecordingStream, stream: Stream) -> None:
    """Log the document: a row a segment, each with a link to its entity."""
    log_document(rec, f"{stream.name}/segments", list_of(stream))


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
