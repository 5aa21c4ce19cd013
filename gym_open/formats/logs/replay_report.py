"""A replay of logs as a person reads it: a row a stream, and the windows that went another way."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.table import Table

from gym_open import progress
from gym_open.errors import UsageError
from gym_open.formats.logs.reader import Log, open_log, open_logs
from gym_open.formats.logs.replay import replay, same_model
from gym_open.formats.replaying import VERDICTS, Verdict, Window
from gym_open.terminal import markup

SHOWN = 12
"""Windows that are listed at most."""


class Report(msgspec.Struct):
    """What came of a replay."""

    verdict: Verdict
    """The worst of all windows."""
    tables: list[Table]
    notes: list[str]
    """What else is to be known, such as a model of another version."""
    first_diverged: str = ""
    """Where, in words."""


def replay_report(source: Path, tolerance: float, streams: Sequence[int] = ()) -> Report:
    """Replay a log file, or all of a folder's (or only some streams), and say what came of it.

    Raises:
        ArtefactError: if a log is missing or damaged, or not of this version's world.
        UsageError: if a stream is not there, or the tolerance is negative.
    """
    if not tolerance >= 0:
        raise UsageError(f"--tolerance: expected 0 or more, got {tolerance}")
    logs = [open_log(source)] if source.is_file() else open_logs(source)
    known = [log.stream for log in logs]
    if unknown := sorted(set(streams) - set(known)):
        raise UsageError(f"--streams: {source} holds the streams {known}, got {unknown}")
    chosen = [log for log in logs if not streams or log.stream in streams]
    found: list[tuple[Log, list[Window]]] = []
    with progress.bar("replaying", sum(log.n_steps for log in chosen)) as bar:
        for log in chosen:
            windows: list[Window] = []
            for window in replay(log, tolerance):
                windows.append(window)
                bar.advance(window.steps, f"stream {log.stream}")
            found.append((log, windows))
    return _report(found, tolerance)


def _report(found: Sequence[tuple[Log, list[Window]]], tolerance: float) -> Report:
    notes = [
        f"stream {log.stream}: the model in it is not the one that this version builds; it was written by "
        f"{log.provenance.get('code', 'an unknown version')}"
        for log, _ in found
        if not same_model(log)
    ]
    tables = [by_stream([windows for _, windows in found], tolerance)]
    others = [window for _, windows in found for window in windows if window.verdict != "identical"]
    others.sort(key=lambda window: -VERDICTS.index(window.verdict))
    if others:
        tables.append(by_window(others))
    report = Report(worst(others), tables, notes)
    if report.verdict == "diverged":
        first = others[0]
        report.first_diverged = f"stream {first.stream}, segment {first.segment}, step {first.first_diverged}"
    return report


def worst(windows: Sequence[Window]) -> Verdict:
    """The worst verdict of all windows."""
    return VERDICTS[max((VERDICTS.index(window.verdict) for window in windows), default=0)]


def _table(title: str, columns: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left")
    for name in columns:
        table.add_column(name, justify="left" if name == "worst" else "right", overflow="fold")
    return table


def by_stream(streams: Sequence[list[Window]], tolerance: float) -> Table:
    """A row for each stream's windows."""
    title = f"windows by verdict, tolerance {tolerance:g}; what differs"
    columns = ("stream", "steps", "identical", "within", "diverged", "off by", "contacts", "pixels")
    table = _table(title, columns)
    for windows in filter(None, streams):
        counts = [sum(window.verdict == verdict for window in windows) for verdict in VERDICTS]
        table.add_row(
            str(windows[0].stream), f"{sum(window.steps for window in windows):,}",
            *(f"{count:,}" for count in counts), f"{max(map(_error, windows)):.2g}",
            f"{sum(window.contact_steps for window in windows):,}", f"{sum(window.pixels for window in windows):,}",
        )  # fmt: skip
    return table


def by_window(windows: Sequence[Window]) -> Table:
    """A row for each of the first windows, which are not identical."""
    title = f"windows that are not identical ({min(len(windows), SHOWN)} of {len(windows)}), from which step on"
    columns = ("segment", "differs", "diverges", "worst", "off by", "contacts", "pixels")
    table = _table(title, columns)
    for window in windows[:SHOWN]:
        furthest = max(window.state_error, key=window.state_error.__getitem__, default="–")
        table.add_row(
            f"{window.stream}/{window.segment}", f"{window.first_different:,}",
            "–" if window.first_diverged is None else f"{window.first_diverged:,}", markup(furthest),
            f"{_error(window):.2g}",
            f"{window.contact_steps:,}", f"{window.pixels:,}",
        )  # fmt: skip
    return table


def _error(window: Window) -> float:
    return max(window.state_error.values(), default=0.0)
