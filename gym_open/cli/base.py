"""The base classes of sub-commands, and the functions by which they print results."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.console import Console, RenderableType

from gym_open import artefacts, progress
from gym_open.summary import short, stage_record
from gym_open.terminal import Voice

out = Console(emoji=False)
voice = Voice(out)
say = voice.say


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """A sub-command: its fields are its options, and its docstring is its help text."""

    about: ClassVar[str]
    """One line for the overview of all commands."""

    @abstractmethod
    def run(self) -> None:
        """Run the command."""


@dataclass(frozen=True, kw_only=True)
class ArtefactCommand(Command):
    """A sub-command that makes artefacts, with options for scripts."""

    quiet: bool = False
    """Print only errors and one line with the result."""
    json: bool = False
    """Print one line of JSON per artefact: stage, result, seconds, path, digest, kind, figures. All other output goes
    to standard error."""

    stages: ClassVar[bool] = False
    """Whether the command has several stages, which report themselves when they begin and end."""


@dataclass
class _RunningCommand:
    name: str = ""
    started: float = 0.0


_running = _RunningCommand()


@contextmanager
def speaking(command: Command, name: str) -> Iterator[None]:
    """While a command runs, print as its options say, and show that it is running."""
    with ExitStack() as stack:
        _running.name, _running.started = name, time.perf_counter()
        if isinstance(command, ArtefactCommand):
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


def show(*renderables: RenderableType) -> None:
    """Print tables and other formatted results."""
    for item in renderables:
        out.print(item)


def say_next(*commands: str) -> None:
    """Print the commands to type next."""
    for command in commands:
        say(f"  next: {command}")


def say_made(path: Path, *commands: str, note: str = "") -> None:
    """Print the path of a new file or folder, a note, and the commands to type next."""
    say(short(path) + (f"  ({note})" if note else ""), verb="made")
    say_next(*commands)


def report(made: artefacts.Outcome, *commands: str) -> None:
    """Print the artefact that the current command made, or its JSON record, and the commands to type next."""
    voice.record(stage_record(_running.name, made, time.perf_counter() - _running.started))
    verb = "made" if made.made else "up to date, nothing to do:"
    voice.result(f"{short(made.path)}  (digest {artefacts.digest(made.path)[:16]})", verb=verb)
    if made.earlier is not None:
        say(f"  the earlier artefact, which was made from other inputs, is now {short(made.earlier)}")
    say_next(*commands)
