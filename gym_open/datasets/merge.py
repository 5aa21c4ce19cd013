"""Several releases become one: `merge_releases(config, releases, out)`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gym_open import artefacts
from gym_open.datasets.config import MergeConfig
from gym_open.datasets.derived import derive
from gym_open.errors import UsageError
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.layout import IMAGE, PART

_RULES = ("split_by", "max_episode_steps", "pictures")
"""What releases that go together must have in common, beside their features."""
_PLAY = (IMAGE, "action.index", "reward.intrinsic")
"""Features that tell one play from another."""


def merge_releases(
    config: MergeConfig, releases: Sequence[Path], out: Path, *, workers: int | None = None, replace: bool = False
) -> artefacts.Outcome:
    """Make the release `out` of all episodes of `releases`, in their order, each split's together.

    Where splits go by world, a layout that is in val in any of them is in val in the result, so that nobody who trained
    on one of them has seen what is held out. The same releases and configuration give the same bytes.

    Releases may differ in what the intrinsic rewards are made of: an explorer's parts are NaN where others played.

    Args:
        config: name, version and so on of the result.
        releases: folders of releases of the same model and rules; they become its parents.
        out: folder of the result; versions of one release are siblings called X.Y.Z.
        workers: threads; all processors if not given.
        replace: set aside what stands at `out` if it was made of other inputs, rather than refuse.

    Raises:
        ArtefactError: if a release is damaged, or the version says other than what was changed since the one before.
        UsageError: if there is no release, two hold the same episode, or they differ in a feature or rule (which is
            named).
    """
    opened = [open_release(path) for path in releases]
    if not opened:
        raise UsageError("expected one release or more to merge, got none")
    for release in opened:
        _check_alike(opened[0], release)
    _check_distinct(opened)
    chosen = [(release, np.arange(len(release.episodes))) for release in opened]
    return derive(config, "merge", out, chosen, workers=workers, replace=replace)


def _check_distinct(releases: Sequence[Release]) -> None:
    """Raises UsageError if two releases hold the same play: it would be counted twice, and could be in both splits."""
    seen: dict[tuple[str, ...], tuple[Path, int]] = {}
    for release in releases:
        content = release.table("content")[list(_PLAY)]
        rows = release.episodes[["explorer", "puzzle"]]
        own = list(zip(*(rows[name] for name in rows), *(content[name] for name in content), strict=True))
        for number, play in enumerate(own):
            if play in seen:
                root, first = seen[play]
                raise UsageError(
                    f"{release.root}: its episode {number} is episode {first} of {root}; it would be counted twice: "
                    "leave one of the releases out, or filter it"
                )
        seen |= {play: (release.root, number) for number, play in enumerate(own)}


def _check_alike(one: Release, other: Release) -> None:
    mine, yours = one.info["features"], other.info["features"]
    for name in sorted(name for name in {*mine, *yours} if not name.startswith(PART)):
        if mine.get(name) != yours.get(name):
            lacking = next((item.root for item, has in ((one, mine), (other, yours)) if name not in has), None)
            what = f"{lacking} lacks it" if lacking else "they describe it otherwise"
            raise UsageError(
                f"{one.root} and {other.root} differ in the feature {name!r}: {what}; releases that are merged must "
                "have the same features"
            )
    for name in _RULES:
        here, there = one.info["gym_open"][name], other.info["gym_open"][name]
        if here != there:
            raise UsageError(f"{one.root} has {name} {here!r}, {other.root} {there!r}; they must be the same")
