"""CHANGELOG.md: what changed in this version, followed by the changelog of the previous version."""

from gym_open.datasets.compare import payload
from gym_open.datasets.compare.diff import Diff
from gym_open.datasets.config import Header
from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release
from gym_open.formats.releases.layout import CHANGELOG
from gym_open.markdown import cell
from gym_open.terminal import printable

_LONGEST = 2**20
"""Largest size in bytes of a previous changelog."""


def write_changelog(release: Release, header: Header, previous: Release | None, diff: Diff | None) -> None:
    """Write the changelog of `release`, as `changelog` gives it."""
    (release.root / CHANGELOG).write_text(changelog(header, release, previous, diff), encoding="utf-8")


def changelog(header: Header, release: Release, previous: Release | None, diff: Diff | None) -> str:
    """Text of the changelog of a release.

    Args:
        header: name, version and date of the release.
        release: its data and `meta/` must be there already.
        previous: the version before it, if there is one; its sections follow the new one.
        diff: what changed since `previous`.

    Raises:
        ArtefactError: if the previous release, or its changelog, is not readable.
    """
    dated = f" ({header.published})" if header.published else ""
    head = f"# Changelog of {header.name}\n\n## {header.version}{dated}\n\n"
    content = f"Content digest `{payload.digests(release.root).release}`.\n"
    if previous is None or diff is None:
        return f"{head}First release.\n\n{content}"
    lines = "".join(f"- {cell(item.text)}\n" for item in diff.meanings)
    return f"{head}A {diff.bump} change since {previous.version}:\n\n{lines}\n{content}\n{_earlier(previous)}"


def _earlier(previous: Release) -> str:
    """The sections of the previous changelog, without its title."""
    path = previous.root / CHANGELOG
    try:
        if path.stat().st_size > _LONGEST:
            raise ArtefactError(f"{path}: larger than {_LONGEST:,} bytes; get that release again")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; get that release again") from None
    start = text.find("## ")
    return printable(text[start:]) if start >= 0 else ""
