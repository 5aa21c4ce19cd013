"""Errors that a person can act on. Each carries the exit code that the command ends with."""

from typing import ClassVar


class GymOpenError(Exception):
    """A run or a check failed (exit code 1). The message names file, field, value and remedy."""

    exit_code: ClassVar[int] = 1


class UsageError(GymOpenError):
    """The command was used wrongly: nothing was started (exit code 2)."""

    exit_code: ClassVar[int] = 2


class MissingExtraError(UsageError, ModuleNotFoundError):
    """A package that only some parts of gym-open need is not installed; `name` is its module."""


class ConfigError(UsageError):
    """A configuration holds an unknown, ill-typed or out-of-range value."""


class DivergedError(GymOpenError):
    """What a network gives is no longer finite: its weights are beyond repair."""


class ArtefactError(GymOpenError):
    """An artefact on disk is missing, damaged, or not what was asked for."""


class RefusedError(ArtefactError):
    """What was made must not be kept, since something in it is not true."""
