"""Version numbers: MAJOR.MINOR.PATCH, with the meaning that TensorFlow Datasets gives them.

MAJOR: existing data changed. MINOR: data were added. PATCH: the same data in other files or with other documents.
"""

import re
from pathlib import Path
from typing import Literal

import msgspec

from gym_open.errors import ArtefactError

Bump = Literal["none", "patch", "minor", "major"]
RANK: dict[Bump, int] = {"none": 0, "patch": 1, "minor": 2, "major": 3}


class Meaning(msgspec.Struct, frozen=True):
    """A change, and the version bump that it requires."""

    bump: Bump
    text: str


_VERSION = re.compile(r"(0|[1-9][0-9]{0,8})\.(0|[1-9][0-9]{0,8})\.(0|[1-9][0-9]{0,8})")


def parse(version: str) -> tuple[int, int, int] | None:
    """Parse the three numbers of a version; None if it is not valid."""
    match = _VERSION.fullmatch(version)
    return (int(match[1]), int(match[2]), int(match[3])) if match else None


def implied(previous: str, bump: Bump) -> str:
    """The version that follows `previous` after a change of this kind, or `previous` if nothing changed.

    Raises:
        ArtefactError: if `previous` is not a version.
    """
    numbers = parse(previous)
    if numbers is None:
        raise ArtefactError(f"version must be three numbers, as 1.0.0, got {previous!r}; build that release again")
    major, minor, patch = numbers
    match bump:
        case "major":
            return f"{major + 1}.0.0"
        case "minor":
            return f"{major}.{minor + 1}.0"
        case "patch":
            return f"{major}.{minor}.{patch + 1}"
        case "none":
            return previous


def latest_below(out: Path, version: str) -> Path | None:
    """The highest version below `version` among the folders named X.Y.Z next to `out`; None if there is none."""
    below = parse(version)
    parent = out.absolute().parent
    if below is None or not parent.is_dir():
        return None
    found = [
        (numbers, item)
        for item in parent.iterdir()
        if (numbers := parse(item.name)) is not None and numbers < below and item.is_dir() and item.name != out.name
    ]
    return max(found)[1] if found else None
