"""Simulation of compact releases: their episodes, and a reader that is used like a release."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from gym_open.formats.releases import Release


def open_dataset(root: Path, *, check: Literal["records", "bytes"] = "records") -> "Release":
    """Open a release or a compact release at `root`; both are read in the same way.

    Args:
        root: folder of either.
        check: as for `open_release`. Every byte of a compact release is checked in any case.

    Raises:
        ArtefactError: if it is missing, damaged, or neither of both.
        MissingExtraError: if the packages that read releases are not installed.
    """
    from gym_open.formats.compact.reader import is_compact, open_compact
    from gym_open.formats.releases import open_release

    if is_compact(root):
        from gym_open.replay.compact.release import CompactRelease  # slow to import: it simulates

        return CompactRelease(open_compact(root))
    return open_release(root, check=check)
