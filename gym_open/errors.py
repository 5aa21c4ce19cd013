"""Errors with a remedy. Each class holds the exit code of the command that it ends."""

from typing import ClassVar


class GymOpenError(Exception):
    """A run or a check failed (exit code 1). The message names file, field, value and remedy."""

    exit_code: ClassVar[int] = 1


class UsageError(GymOpenError):
    """The command was used wrongly, and no work was started (exit code 2)."""

    exit_code: ClassVar[int] = 2


class MissingExtraError(UsageError, ModuleNotFoundError):
    """An optional package is not installed; `name` is its module."""


class ConfigError(UsageError):
    """A configuration holds an unknown key, or a value of the wrong type or out of range."""


class DivergedError(GymOpenError):
    """The outputs of a network are not finite any more: its weights cannot be repaired."""


class ArtefactError(GymOpenError):
    """An artefact on disk is missing, damaged, or of another kind than was asked for."""


class RefusedError(ArtefactError):
    """A new artefact must not be kept, because it holds something untrue."""
