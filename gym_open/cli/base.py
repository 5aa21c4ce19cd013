"""What every sub-command is, and how it says what it made."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from rich.console import Console
from rich.text import Text

from gym_open import artefacts
from gym_open.summary import short
from gym_open.terminal import printable

out = Console(emoji=False)


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """A sub-command: its fields are its options, its docstring its help."""

    about: ClassVar[str]
    """A line for the overview."""

    @abstractmethod
    def run(self) -> None:
        """Do it."""


def say(text: str, *, verb: str = "") -> None:
    """Print a text as it is, paths and all: nothing in it is markup. A `verb` comes before it, in green."""
    out.print(Text.assemble((verb, "bold green"), " " if verb else "", printable(text)), soft_wrap=True)


def report(made: artefacts.Outcome, *then: str) -> None:
    """Say what came of it and which commands to type next."""
    verb = "made" if made.made else "up to date, nothing to do:"
    say(f"{short(made.path)}  (digest {artefacts.digest(made.path)[:16]})", verb=verb)
    if made.earlier is not None:
        say(f"  what was there before, of other inputs, is now {short(made.earlier)}")
    for line in then:
        say(f"  next: {line}")
