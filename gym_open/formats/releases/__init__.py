"""Dataset releases on disk: their layout, their features, and their reader."""

from gym_open.formats.releases.episodes import EpisodeData
from gym_open.formats.releases.layout import IMAGE, INFO_PATH, Table
from gym_open.formats.releases.reader import Release, open_release

__all__ = ["IMAGE", "INFO_PATH", "EpisodeData", "Release", "Table", "open_release"]
