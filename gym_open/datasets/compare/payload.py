"""Digests of the files of a release, by bytes and by content. The release may still be unsealed."""

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from gym_open import artefacts
from gym_open.artefacts import Entry
from gym_open.files import sha256_file
from gym_open.formats.releases.info import read_json
from gym_open.formats.releases.layout import DIGESTS_PATH, RECORDS, SIGNATURE


class Digests(msgspec.Struct, frozen=True):
    """`meta/digests.json`: digests of decoded content."""

    release: str
    files: dict[str, str]
    """Digest of every parquet file and video, by path."""


def digests(root: Path) -> Digests:
    """Read the content digests in the release at `root`.

    Raises:
        ArtefactError: if they are missing or not readable.
    """
    return read_json(root / DIGESTS_PATH, Digests)


def entries(root: Path) -> dict[str, Entry]:
    """SHA-256 and size of every payload file, from the manifest, or from the files if there is no manifest yet.

    Raises:
        ArtefactError: if the manifest is not readable.
    """
    if (root / artefacts.MANIFEST).exists():
        found = artefacts.manifest(root)
        return {path: found[path] for path in sorted(found) if path not in RECORDS}
    return {path: _entry(root / path) for path in sorted(_payload_paths(root))}


def total_bytes(found: Mapping[str, Entry]) -> int:
    """Sum of the sizes of all files in bytes."""
    return sum(entry.bytes for entry in found.values())


def _payload_paths(root: Path) -> Iterable[str]:
    for item in root.rglob("*"):
        path = item.relative_to(root).as_posix()
        if item.is_file() and path not in (*RECORDS, SIGNATURE) and not path.startswith(f"{artefacts.SCRATCH}/"):
            yield path


def _entry(path: Path) -> Entry:
    status = path.stat()
    return _hashed(path, status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=100_000)
def _hashed(path: Path, size: int, mtime_ns: int) -> Entry:  # noqa: ARG001 (size and time are part of the cache's key)
    return Entry(sha256=sha256_file(path), bytes=size)
