"""Logs of exploration in MCAP: the names that other rooms use to write and read them.

docs/data-format.md describes the layout. `LogWriter` writes a log. `resume_writer` continues the log of a killed
writer. `open_log` checks and reads a log. `open_whole_part` reads the undamaged beginning of a damaged log. `info` and
`repair` implement the `gym-open log` commands. The other modules are the container, the messages and their encoding.
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
