"""Merge several releases into one: `merge_releases(config, releases, out)`."""

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
"""Settings that merged releases must have in common, in addition to their features."""
_IDENTITY = (IMAGE, "action.index")
"""Features by which two episodes are recognised as the same."""


def merge_releases(
    config: MergeConfig, releases: Sequence[Path], out: Path, *, workers: int | None = None, replace: bool = False
) -> artefacts.Outcome:
    """Make the release `out` from all episodes of `releases`, in their order, with those of each split together.

    If splits go by world, a layout that is in val in one of the releases is in val in the result. The same releases and
    configuration give the same bytes.

    Releases may differ in the parts of the intrinsic reward: parts that an explorer does not have are NaN.

    Args:
        config: name, version and so on of the result.
        releases: folders of releases with the same model and rules, which become the parents.
        out: folder of the result. The versions of a release are sibling folders named X.Y.Z.
        workers: number of threads; by default one per processor.
        replace: set aside an artefact of other inputs at `out`; otherwise refuse.

    Raises:
        ArtefactError: if a release is damaged, or the version does not follow from what changed since the previous one.
        UsageError: if there is no release, two of them hold the same episode, or they differ in a feature or rule
            (naming it).
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
    """Raise UsageError if two releases hold the same episode: it would count twice, and could be in both splits."""
    seen: dict[tuple[str, ...], tuple[Path, int]] = {}
    for release in releases:
        content = release.table("content")[list(_IDENTITY)]
        rows = release.episodes[["explorer", "puzzle"]]
        own = list(zip(*(rows[name] for name in rows), *(content[name] for name in content), strict=True))
        for number, episode in enumerate(own):
            if episode in seen:
                root, first = seen[episode]
                raise UsageError(
                    f"{release.root}: its episode {number} is episode {first} of {root}; it would be counted twice: "
                    "leave one of the releases out, or filter it"
                )
        seen |= {episode: (release.root, number) for number, episode in enumerate(own)}


def _check_alike(one: Release, other: Release) -> None:
    mine, yours = one.info["features"], other.info["features"]
    for name in sorted(name for name in {*mine, *yours} if not name.startswith(PART)):
        if mine.get(name) != yours.get(name):
            lacking = next((item.root for item, has in ((one, mine), (other, yours)) if name not in has), None)
            what = f"{lacking} lacks it" if lacking else "their descriptions of it differ"
            raise UsageError(
                f"{one.root} and {other.root} differ in the feature {name!r}: {what}; releases that are merged must "
                "have the same features"
            )
    for name in _RULES:
        here, there = one.info["gym_open"][name], other.info["gym_open"][name]
        if here != there:
            raise UsageError(f"{one.root} has {name} {here!r}, {other.root} {there!r}; they must be the same")
