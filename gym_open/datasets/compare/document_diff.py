"""Compare a document of two releases, apart from what any two versions differ in."""

import re
from typing import Any

import msgspec

from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release
from gym_open.formats.releases.layout import CHANGELOG, CROISSANT
from gym_open.terminal import printable

_LARGEST = 2**24
"""A larger document is not read: it counts as changed."""
_YEAR = re.compile(r", year=\{\d{4}\}")
_FOLLOWS = re.compile(
    r'\n# the version before;.*\nprevious=.*\nif .*\n    echo .*\n    exit 1\nfi\n| --previous "\$previous"'
    r"|# the version before is looked for.*\nbeside=.*\nmkdir .*\n\[ -e .*\n"
)
"""The part of `rebuild.sh` about the previous version, which differs in every version."""


def same_but_for_version(a: Release, b: Release, path: str, *, data_changed: bool) -> bool:
    """Whether a document differs only in version and date, and in what follows from them.

    Args:
        a: one release.
        b: the other.
        path: path of a document that both releases have, neither data nor `meta/`.
        data_changed: data or tables changed, so that their sizes and digests in a document also differ.

    Raises:
        ArtefactError: if the file is not readable.
    """
    if max((one.records / path).stat().st_size for one in (a, b)) > _LARGEST:
        return False
    said = {str(text) for one in (a, b) for text in (one.version, one.info["gym_open"].get("published")) if text}
    old, new = (_text(one, path) for one in (a, b))
    if path == CHANGELOG and a.version != b.version and (start := old.find("## ")) >= 0:
        return new.endswith(printable(old[start:])) or _blank(old, said) == _blank(new, said)
    old, new = _blank(old, said), _blank(new, said)
    if path == CROISSANT:
        return _described(old, data_changed) == _described(new, data_changed)
    if path.startswith("rebuild/") and a.version != b.version:
        old, new = _FOLLOWS.sub("", old), _FOLLOWS.sub("", new)
    return old == new


def _text(release: Release, path: str) -> str:
    try:
        return (release.records / path).read_bytes().decode("utf-8", "surrogateescape")  # figures are documents too
    except OSError as error:
        raise ArtefactError(f"{release.records / path}: not readable: {error}; build the release again") from None


def _blank(text: str, said: set[str]) -> str:
    for item in sorted(said):
        text = text.replace(item, "")
    return text


def _described(text: str, data_changed: bool) -> Any:
    """Croissant's document without its date, and without its files if data changed; the text if it is no JSON."""
    try:
        found = msgspec.json.decode(_YEAR.sub("", text).encode("utf-8", "surrogateescape"), type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return text
    ignored = {"datePublished"} | ({"distribution"} if data_changed else set())
    return {key: value for key, value in found.items() if key not in ignored}
