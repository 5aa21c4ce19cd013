"""How much of a source a view shows: settings, and the part that a person picks."""

import re
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import msgspec

from gym_open.config import Config, PositiveInt
from gym_open.errors import UsageError


class VizConfig(Config, frozen=True):
    """Anything that gym-open makes, as a Rerun recording.

    Play is thinned by one rule. Of the n steps of a stream that are to be shown, those are whose number in the stream
    is divisible by k = ceil(n / limit), and the first of every segment. Pictures, places and series have a limit each.
    What is counted over time (coverage) counts every step, shown or not; events, switches and losses of worlds are
    whole.
    """

    max_images: PositiveInt = 2_000
    """Limit of pictures a stream, and of maps of coverage (about 1 to 3 kB each; with depth and segmentation 40 kB)."""
    max_poses: PositiveInt = 20_000
    """Limit of steps a stream at which objects, contacts, trail and action are shown (about 1 kB each)."""
    max_points: PositiveInt = 50_000
    """Limit of points a stream of each series: reward, loss and all else that is drawn as a curve."""
    trail_steps: PositiveInt = 200
    """Steps of the agent's trail on the table, in the world that it is in; steps of the stream, shown or not."""
    film_pictures: PositiveInt = 400
    """Limit of pictures of a film of play, at 20 a second."""
    film_look: Literal["handsome", "observation"] = "handsome"
    """Of films: for people, which needs OpenGL and a tenth of a second a picture, or as an agent sees it, enlarged."""


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
