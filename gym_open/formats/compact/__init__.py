"""Compact releases: the actions of a release, from which its frames are simulated again. They are files only here."""

from gym_open.formats.compact.reader import Compact, open_compact

__all__ = ["Compact", "open_compact"]
