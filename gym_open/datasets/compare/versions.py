"""Versions that do not lie: the number of a release follows from what changed since the one before it."""

from pathlib import Path

from gym_open.datasets.compare.diff import Diff, diff_releases
from gym_open.datasets.compare.semver import implied, parse
from gym_open.errors import RefusedError
from gym_open.formats.releases import Release

__all__ = ["check", "implied", "latest_below"]


def check(previous: Release, new: Release) -> Diff:
    """Hold the version of `new` against what changed since `previous`, and return what that is.

    `new` may still be without its manifest, as it is just before it is sealed.

    Raises:
        RefusedError: if nothing changed, or another version is the honest one (which is named), or the two are not of
            one name.
    """
    if previous.name != new.name:
        raise RefusedError(
            f"{previous.root}: holds {previous.name!r} and not {new.name!r}, so it is no earlier version of it; give "
            "another --out, or the right --previous"
        )
    diff = diff_releases(previous, new)
    if diff.bump == "none":
        raise RefusedError(
            f"{new.name} {new.version}: nothing but version and date differs from {previous.version} "
            f"({previous.root}); a version that brings nothing is refused: keep {previous.version}"
        )
    honest = implied(previous.version, diff.bump)
    if new.version != honest:
        raise RefusedError(
            f"{new.name}: version {new.version} does not say what changed since {previous.version} ({previous.root}); "
            f"a {diff.bump} change ({diff.meanings[0].text}) makes it {honest}: give --version {honest}"
        )
    return diff


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
