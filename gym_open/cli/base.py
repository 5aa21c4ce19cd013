"""What every sub-command is, and how it says what it made."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import ClassVar

from rich.console import Console

from gym_open import artefacts, progress
from gym_open.summary import short, stage_record
from gym_open.terminal import Voice

out = Console(emoji=False)
voice = Voice(out)
say = voice.say


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """A sub-command: its fields are its options, its docstring its help."""

    about: ClassVar[str]
    """A line for the overview."""

    @abstractmethod
    def run(self) -> None:
        """Do it."""


@dataclass(frozen=True, kw_only=True)
class Making(Command):
    """A sub-command that makes artefacts: scripts call it, too."""

    quiet: bool = False
    """Print errors, and one line on what came of it."""
    json: bool = False
    """Print a line of JSON for each artefact: stage, result, seconds, path, digest, kind, figures. The rest goes to
    standard error."""

    stages: ClassVar[bool] = False
    """Whether it goes through stages that say themselves when they begin and end."""


@dataclass
class _Running:
    name: str = ""
    started: float = 0.0


_running = _Running()


@contextmanager
def speaking(command: Command, name: str) -> Iterator[None]:
    """While `command` of that name runs, speak as its options ask for, and show that it goes on."""
    with ExitStack() as stack:
        _running.name, _running.started = name, time.perf_counter()
        if isinstance(command, Making):
            stack.callback(_choose, quiet=False, json=False)
            _choose(quiet=command.quiet, json=command.json)
            if not command.stages:
                if not progress.on_terminal():
                    progress.write(f"{name} …")
                stack.enter_context(progress.stage(name))
        yield


def _choose(*, quiet: bool, json: bool) -> None:
    voice.choose(quiet=quiet, json=json)
    progress.console.quiet = quiet


def report(made: artefacts.Outcome, *then: str) -> None:
    """Say what came of the command that runs, and which commands to type next."""
    voice.record(stage_record(_running.name, made, time.perf_counter() - _running.started))
    verb = "made" if made.made else "up to date, nothing to do:"
    voice.result(f"{short(made.path)}  (digest {artefacts.digest(made.path)[:16]})", verb=verb)
    if made.earlier is not None:
        say(f"  what was there before, of other inputs, is now {short(made.earlier)}")
    for line in then:
        say(f"  next: {line}")
