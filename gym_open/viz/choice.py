"""What a person picked of a source: a puzzle, an episode, a segment, a range of steps; all optional."""

import re
import sys
from collections.abc import Collection
from pathlib import Path

import msgspec

from gym_open.errors import UsageError


class Choice(msgspec.Struct, frozen=True):
    """Part of a source; the whole of it by default.

    Raises:
        UsageError: if a number is negative, or a range of steps is empty.
    """

    puzzle: str | None = None
    """Of the evaluation, such as `tool-use/017`."""
    episode: int | None = None
    """Of a release."""
    segment: int | None = None
    """Of a stream, counted from 0."""
    steps: range | None = None
    """Half-open, of a stream's steps; its end may lie beyond the last."""
    release: Path | None = None
    """Whose pictures an encoder is shown."""
    stream: int | None = None
    """Of a log or release."""

    def __post_init__(self) -> None:
        for name in ("episode", "segment", "stream"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise UsageError(f"--{name}: expected 0 or more, got {value}")
        if self.steps is not None and not (0 <= self.steps.start < self.steps.stop and self.steps.step == 1):
            start, stop = self.steps.start, self.steps.stop
            raise UsageError(f"--steps: expected A:B with 0 <= A < B, got {start}:{stop}")

    def given(self) -> list[str]:
        """Names of what was picked."""
        return [name for name in self.__struct_fields__ if getattr(self, name) is not None]

    def refuse_others(self, what: str, known: Collection[str]) -> None:
        """Refuse what cannot be picked of `what`.

        Raises:
            UsageError: if something that is not `known` was picked.
        """
        for name in self.given():
            if name not in known:
                options = ", ".join(f"--{item}" for item in sorted(known)) or "nothing"
                raise UsageError(f"--{name} picks nothing of {what}; leave it out (what can be picked: {options})")


def parse_steps(text: str) -> range:
    """The steps that `A:B` means, B excluded; without A from the first, without B to the last.

    Raises:
        UsageError: if `text` is not of this form.
    """
    match = re.fullmatch(r"([0-9]{0,18}):([0-9]{0,18})", text)
    if not match:
        raise UsageError(f"--steps: expected A:B, such as 1000:2000, 1000: or :2000, got {text!r}")
    return range(int(match[1] or 0), int(match[2] or sys.maxsize))
