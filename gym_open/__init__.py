"""gym-open: OPEn, an open-ended physics environment for learning without a task, as data and offline learning."""

__version__ = "0.1.0"
