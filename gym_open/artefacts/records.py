"""The three records of an artefact, as data, and how they are read."""

import hashlib
import stat
from pathlib import Path
from typing import Any

import msgspec

from gym_open.errors import ArtefactError

CONFIG, LINEAGE, MANIFEST = "config.json", "lineage.json", "manifest.json"
SIGNATURE = "signature.json"
"""Of a release, and made after it: the one file that its manifest does not list."""
SCRATCH = "checkpoint"
"""Folder inside an unfinished artefact for whatever a resume needs; removed before sealing."""

_MAX_RECORD_BYTES = 2**26
"""A manifest or lineage is refused above this size: fifty times what a large release has."""


class Entry(msgspec.Struct, frozen=True):
    """One file of a manifest."""

    sha256: str
    bytes: int


class Parent(msgspec.Struct, frozen=True):
    """An input artefact with its own records, so that a chain can be read and checked without the input being there."""

    digest: str
    manifest: dict[str, Entry]
    lineage: "Lineage"

    def is_consistent(self) -> bool:
        """Whether the digest is that of this manifest, and the manifest's lineage is this lineage."""
        entry = self.manifest.get(LINEAGE)
        return (
            entry is not None
            and hashlib.sha256(canonical_json(self.manifest)).hexdigest() == self.digest
            and hashlib.sha256(canonical_json(self.lineage)).hexdigest() == entry.sha256
        )


class Lineage(msgspec.Struct, frozen=True):
    """Where an artefact comes from."""

    kind: str
    key: str
    """Digest of everything that went in: kind, configuration, parents, code."""
    code: str
    packages: dict[str, str]
    facts: dict[str, Any]
    """What later stages must be able to rely on, for example the task and puzzle digests of a log."""
    parents: list[Parent]


def canonical_json(value: Any) -> bytes:
    """JSON with sorted keys and a final newline: equal values give equal bytes."""
    return msgspec.json.format(msgspec.json.encode(value, order="sorted"), indent=1) + b"\n"


def digest(path: Path) -> str:
    """Digest of the artefact at `path`.

    Raises:
        ArtefactError: if there is no artefact.
    """
    try:
        return hashlib.sha256(read_record(path / MANIFEST)).hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        raise ArtefactError(f"{path}: not an artefact of gym-open ({MANIFEST} is missing); build it first") from None


def lineage(path: Path) -> Lineage:
    """Lineage record of the artefact at `path`.

    Raises:
        ArtefactError: if it is missing or not readable as a lineage.
    """
    return _read(path / LINEAGE, Lineage)


def config_of(path: Path) -> dict[str, Any]:
    """The configuration, as plain data, that made the artefact at `path`."""
    return _read(path / CONFIG, dict[str, Any])


def manifest(path: Path) -> dict[str, Entry]:
    """SHA-256 and size of every file of the artefact at `path` but the manifest itself, by name.

    Raises:
        ArtefactError: if it is missing or not readable as a manifest.
    """
    return _read(path / MANIFEST, dict[str, Entry])


def read_record(path: Path) -> bytes:
    """Bytes of a record; refused if it is a link, a special file or too large.

    Raises:
        ArtefactError: if it is refused.
        OSError: if it is missing or cannot be read.
    """
    about = path.lstat()
    if not stat.S_ISREG(about.st_mode) or about.st_size > _MAX_RECORD_BYTES:
        raise ArtefactError(f"{path}: a link, a special file, or over {_MAX_RECORD_BYTES:,} bytes; get it anew")
    return path.read_bytes()


def _read(path: Path, kind: Any) -> Any:
    try:
        return msgspec.json.decode(read_record(path), type=kind)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing; the artefact is not whole, build it again") from None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the artefact again") from None
