"""Logs of exploration, one MCAP file a stream: the front door to writing and reading them.

The layout is in docs/data-format.md. `LogWriter` writes, `open_log` checks and reads; the other modules named `log_*`
are how they do it: the container, the messages, the encoding.
"""

from gym_open.formats.log_reader import Log, log_files, open_log
from gym_open.formats.log_schemas import LogError, Segment, SegmentStart, StepRecord, Switch
from gym_open.formats.log_writer import LogHead, LogWriter

__all__ = [
    "Log",
    "LogError",
    "LogHead",
    "LogWriter",
    "Segment",
    "SegmentStart",
    "StepRecord",
    "Switch",
    "log_files",
    "open_log",
]
