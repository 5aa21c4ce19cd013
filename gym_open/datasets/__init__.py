"""Stage 2: logs become versioned dataset releases in LeRobot v3.0. `open_dataset` opens them, compact or not."""

from gym_open.formats.releases import Release, open_release
from gym_open.replay.compact import open_dataset

__all__ = ["Release", "open_dataset", "open_release"]
