"""What happened, in words: switches of world, what got stuck, and where a damaged log ends."""

import math
from collections.abc import Sequence

import rerun as rr

from gym_open.formats.logs import Stuck, Switch
from gym_open.terminal import printable
from gym_open.viz.play.columns import times
from gym_open.viz.play.streams import Stream

_MOST = 6
"""Losses that are told of a switch, the highest first."""


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
