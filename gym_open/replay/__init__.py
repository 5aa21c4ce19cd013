"""Replay: recorded actions played again, from logs, releases and scored episodes, and compared with the recording."""
