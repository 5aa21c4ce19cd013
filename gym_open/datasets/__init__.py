"""Stage 2: logs become versioned dataset releases in LeRobot v3.0. `open_release` is their reader."""

from gym_open.formats.releases import Release, open_release

__all__ = ["Release", "open_release"]
