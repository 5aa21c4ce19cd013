"""Logs of exploration, in MCAP: the front door to writing and reading them.

The layout is in docs/data-format.md. `LogWriter` writes, `resume_writer` goes on where a killed one left off,
`open_log` checks and reads, `open_whole_part` takes what is whole of a damaged log; most other modules are how they do
it: the container, the messages, the encoding. `replay`, `info` and `repair` are what the `gym-open log` commands do.
"""

from gym_open.extras import Named

with Named():
    from gym_open.formats.logs.reader import Log, found_files, log_files, open_log, open_logs, open_whole_part
    from gym_open.formats.logs.resume import resume_writer
    from gym_open.formats.logs.schemas import (
        Keyframe,
        LogError,
        LogHead,
        Segment,
        SegmentStart,
        StepMetrics,
        StepRecord,
        Stuck,
        Switch,
        log_name,
    )
    from gym_open.formats.logs.writer import LogWriter

__all__ = [
    "Keyframe",
    "Log",
    "LogError",
    "LogHead",
    "LogWriter",
    "Segment",
    "SegmentStart",
    "StepMetrics",
    "StepRecord",
    "Stuck",
    "Switch",
    "found_files",
    "log_files",
    "log_name",
    "open_log",
    "open_logs",
    "open_whole_part",
    "resume_writer",
]
