"""What every sub-command is, and how it says what it made."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from rich.console import Console

from gym_open import artefacts
from gym_open.summary import short

out = Console()


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """A sub-command: its fields are its options, its docstring its help."""

    about: ClassVar[str]
    """A line for the overview."""

    @abstractmethod
    def run(self) -> None:
        """Do it."""


def report(made: artefacts.Outcome, *then: str) -> None:
    """Say what came of it and which commands to type next."""
    verb = "made" if made.made else "up to date, nothing to do:"
    out.print(f"[bold green]{verb}[/] {short(made.path)}  (digest {artefacts.digest(made.path)[:16]})", soft_wrap=True)
    if made.earlier is not None:
        out.print(f"  what was there before, of other inputs, is now {short(made.earlier)}", soft_wrap=True)
    for line in then:
        out.print(f"  next: {line}", highlight=False, soft_wrap=True)
