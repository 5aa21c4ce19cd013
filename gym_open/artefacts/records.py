"""The three records of an artefact as data, and functions that read them."""

import hashlib
import stat
from pathlib import Path
from typing import Any

import msgspec

from gym_open.errors import ArtefactError

CONFIG, LINEAGE, MANIFEST = "config.json", "lineage.json", "manifest.json"
SIGNATURE = "signature.json"
"""Signature of a release, made after it: the only file that its manifest does not list."""
SCRATCH = "checkpoint"
"""Folder in an unfinished artefact for all that a resumed run needs; removed when the artefact is sealed."""

_MAX_RECORD_BYTES = 2**26
"""A larger manifest or lineage is refused. This is fifty times the size in a large release."""


class Entry(msgspec.Struct, frozen=True):
    """One file of a manifest."""

    sha256: str
    bytes: int


class Parent(msgspec.Struct, frozen=True):
    """An input artefact with its records, so that a chain can be checked where the input is missing."""

    digest: str
    manifest: dict[str, Entry]
    lineage: "Lineage"

    def is_consistent(self) -> bool:
        """Whether the digest fits this manifest, and the manifest fits this lineage."""
        entry = self.manifest.get(LINEAGE)
        return (
            entry is not None
            and hashlib.sha256(canonical_json(self.manifest)).hexdigest() == self.digest
            and hashlib.sha256(canonical_json(self.lineage)).hexdigest() == entry.sha256
        )


class Lineage(msgspec.Struct, frozen=True):
    """Origin of an artefact."""

    kind: str
    key: str
    """Digest of all inputs: kind, configuration, parents, code."""
    code: str
    packages: dict[str, str]
    facts: dict[str, Any]
    """Facts that later stages rely on, for example the task and puzzle digests of a log."""
    parents: list[Parent]


def canonical_json(value: Any) -> bytes:
    """Encode JSON with sorted keys and a final newline: equal values give equal bytes."""
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
    """The configuration that made the artefact at `path`, as plain data."""
    return _read(path / CONFIG, dict[str, Any])


def manifest(path: Path) -> dict[str, Entry]:
    """SHA-256 and size of every file of the artefact at `path` except the manifest itself, by name.

    Raises:
        ArtefactError: if it is missing or not readable as a manifest.
    """
    return _read(path / MANIFEST, dict[str, Entry])


def read_record(path: Path) -> bytes:
    """Read the bytes of a record. A link, a special file or a file that is too large is refused.

    Raises:
        ArtefactError: if it is refused.
        OSError: if it is missing or cannot be read.
    """
    about = path.lstat()
    if not stat.S_ISREG(about.st_mode) or about.st_size > _MAX_RECORD_BYTES:
        raise ArtefactError(f"{path}: a link, a special file, or over {_MAX_RECORD_BYTES:,} bytes; get it again")
    return path.read_bytes()


def _read(path: Path, kind: Any) -> Any:
    try:
        return msgspec.json.decode(read_record(path), type=kind)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing; the artefact is not whole, build it again") from None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the artefact again") from None
