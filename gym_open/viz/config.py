"""What decides how much of a source is shown: the settings, and the part that a person selects."""

import re
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import msgspec

from gym_open.config import Config, PositiveInt
from gym_open.errors import UsageError


class VizConfig(Config, frozen=True):
    """How much of a long log or release a Rerun recording or a film shows.

    One rule reduces the steps: of n selected steps of a stream, a recording shows those whose number in the stream is
    divisible by k = ceil(n / limit), and the first step of every segment. Images, poses and series have own limits.
    Coverage counts every step, shown or not. Events, switches and losses of worlds are always complete.
    """

    max_images: PositiveInt = 2_000
    """Limit of images per stream, and of coverage maps (1 to 3 kB each; with depth and segmentation about 40 kB)."""
    max_poses: PositiveInt = 20_000
    """Limit of steps per stream that show objects, contacts, trail and action (about 1 kB each)."""
    max_points: PositiveInt = 50_000
    """Limit of points per stream and series, such as reward or loss."""
    trail_steps: PositiveInt = 200
    """Length of the agent's trail on the table, in steps of the stream, shown or not; new in each segment."""
    film_pictures: PositiveInt = 400
    """Limit of frames of a film of a log or release, at 20 frames per second."""
    film_look: Literal["handsome", "observation"] = "handsome"
    """Look of films: `handsome` needs OpenGL and 0.1 s per frame, `observation` is what an agent sees, enlarged."""


class Choice(msgspec.Struct, frozen=True):
    """The part of a source to show; by default all of it.

    Raises:
        UsageError: if a number is negative, or a range of steps is empty.
    """

    puzzle: str | None = None
    """Id of an evaluation puzzle, such as `tool-use/017`."""
    episode: int | None = None
    """Number of an episode of a release."""
    segment: int | None = None
    """Number of a segment in its stream, from 0."""
    steps: range | None = None
    """Half-open range of a stream's steps; it may end after the last step."""
    release: Path | None = None
    """Release from which an encoder gets its images."""
    stream: int | None = None
    """Number of a stream of a log or release."""

    def __post_init__(self) -> None:
        for name in ("episode", "segment", "stream"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise UsageError(f"--{name}: expected 0 or more, got {value}")
        if self.steps is not None and not (0 <= self.steps.start < self.steps.stop and self.steps.step == 1):
            start, stop = self.steps.start, self.steps.stop
            raise UsageError(f"--steps: expected A:B with 0 <= A < B, got {start}:{stop}")

    def given(self) -> list[str]:
        """Names of the fields that are set."""
        return [name for name in self.__struct_fields__ if getattr(self, name) is not None]

    def refuse_others(self, what: str, known: Collection[str]) -> None:
        """Refuse a selection that does not apply to `what`.

        Raises:
            UsageError: if a field that is not in `known` is set.
        """
        for name in self.given():
            if name not in known:
                options = ", ".join(f"--{item}" for item in sorted(known)) or "nothing"
                raise UsageError(f"--{name} does not apply to {what}; leave it out (options that apply: {options})")


def parse_steps(text: str) -> range:
    """Parse `A:B` as the steps from A to B, without B; A defaults to the first step, B to the end.

    Raises:
        UsageError: if `text` does not have this form.
    """
    match = re.fullmatch(r"([0-9]{0,18}):([0-9]{0,18})", text)
    if not match:
        raise UsageError(f"--steps: expected A:B, such as 1000:2000, 1000: or :2000, got {text!r}")
    return range(int(match[1] or 0), int(match[2] or sys.maxsize))
