"""Tables of a replay for people: one row per stream, and the windows that differ."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.table import Table

from gym_open import progress
from gym_open.errors import UsageError
from gym_open.formats.logs.reader import Log, open_log, open_logs
from gym_open.replay.logs import replay, same_model
from gym_open.replay.player import VERDICTS, ReplayWindow, Verdict
from gym_open.terminal import markup, titled_table

SHOWN = 12
"""Greatest number of windows in the list."""


class ReplayReport(msgspec.Struct):
    """The result of a replay of logs."""

    verdict: Verdict
    """The worst of all windows."""
    tables: list[Table]
    notes: list[str]
    """Remarks, such as a model of another version."""
    first_diverged: str = ""
    """Where the first window diverged, in words."""


def replay_report(source: Path, tolerance: float, streams: Sequence[int] = ()) -> ReplayReport:
    """Replay one log file, or all logs of a folder (or only some streams), and report the result.

    Raises:
        ArtefactError: if a log is missing or damaged, or does not fit this version's world.
        UsageError: if a stream does not exist, or the tolerance is negative.
    """
    if not tolerance >= 0:
        raise UsageError(f"--tolerance: expected 0 or more, got {tolerance}")
    logs = [open_log(source)] if source.is_file() else open_logs(source)
    known = [log.stream for log in logs]
    if unknown := sorted(set(streams) - set(known)):
        raise UsageError(f"--streams: {source} holds the streams {known}, got {unknown}")
    chosen = [log for log in logs if not streams or log.stream in streams]
    found: list[tuple[Log, list[ReplayWindow]]] = []
    with progress.bar("replaying", sum(log.n_steps for log in chosen)) as bar:
        for log in chosen:
            windows: list[ReplayWindow] = []
            for window in replay(log, tolerance):
                windows.append(window)
                bar.advance(window.steps, f"stream {log.stream}")
            found.append((log, windows))
    return _report(found, tolerance)


def _report(found: Sequence[tuple[Log, list[ReplayWindow]]], tolerance: float) -> ReplayReport:
    notes = [
        f"stream {log.stream}: the model in it is not the one that this version builds; it was written by "
        f"{log.provenance.get('code', 'an unknown version')}"
        for log, _ in found
        if not same_model(log)
    ]
    every = [window for _, windows in found for window in windows]
    report = ReplayReport(worst_verdict(every), replay_tables(every, tolerance), notes)
    if report.verdict == "diverged":
        first = _worst_first(every)[0]
        report.first_diverged = f"stream {first.stream}, segment {first.segment}, step {first.first_diverged}"
    return report


def worst_verdict(windows: Sequence[ReplayWindow]) -> Verdict:
    """The worst verdict of all windows."""
    return VERDICTS[max((VERDICTS.index(window.verdict) for window in windows), default=0)]


def replay_tables(windows: Sequence[ReplayWindow], tolerance: float) -> list[Table]:
    """One table with a row per stream and, if windows differ, one with a row for each of the worst `SHOWN` windows."""
    streams: dict[int, list[ReplayWindow]] = {}
    for window in sorted(windows, key=lambda window: window.stream):
        streams.setdefault(window.stream, []).append(window)
    others = _worst_first(windows)
    return [_stream_table(list(streams.values()), tolerance), *([_window_table(others)] if others else [])]


def _worst_first(windows: Sequence[ReplayWindow]) -> list[ReplayWindow]:
    """The windows that are not identical, the worst first."""
    others = [window for window in windows if window.verdict != "identical"]
    return sorted(others, key=lambda window: -VERDICTS.index(window.verdict))


def _stream_table(streams: Sequence[list[ReplayWindow]], tolerance: float) -> Table:
    title = f"windows by verdict, tolerance {tolerance:g}; what differs"
    columns = ("stream", "steps", "identical", "within", "diverged", "off by", "contacts", "pixels")
    table = titled_table(title, columns, right=columns)
    for windows in streams:
        counts = [sum(window.verdict == verdict for window in windows) for verdict in VERDICTS]
        table.add_row(
            str(windows[0].stream), f"{sum(window.steps for window in windows):,}",
            *(f"{count:,}" for count in counts), f"{max(map(_error, windows)):.2g}",
            f"{sum(window.contact_steps for window in windows):,}", f"{sum(window.pixels for window in windows):,}",
        )  # fmt: skip
    return table


def _window_table(windows: Sequence[ReplayWindow]) -> Table:
    title = f"windows that are not identical ({min(len(windows), SHOWN)} of {len(windows)}), from which step on"
    columns = ("segment", "differs", "diverges", "worst", "off by", "contacts", "pixels")
    table = titled_table(title, columns, right=set(columns) - {"worst"})
    for window in windows[:SHOWN]:
        furthest = max(window.state_error, key=window.state_error.__getitem__, default="–")
        table.add_row(
            f"{window.stream}/{window.segment}", f"{window.first_different:,}",
            "–" if window.first_diverged is None else f"{window.first_diverged:,}", markup(furthest),
            f"{_error(window):.2g}",
            f"{window.contact_steps:,}", f"{window.pixels:,}",
        )  # fmt: skip
    return table


def _error(window: ReplayWindow) -> float:
    return max(window.state_error.values(), default=0.0)
