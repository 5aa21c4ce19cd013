"""Check that an artefact is whole and holds exactly what its manifest lists."""

import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from gym_open.artefacts.records import (
    CONFIG,
    LINEAGE,
    MANIFEST,
    SIGNATURE,
    Entry,
    canonical_json,
    digest,
    lineage,
    manifest,
    read_record,
)  # fmt: skip
from gym_open.errors import ArtefactError
from gym_open.files import sha256_file

MAX_SIGNATURE_BYTES = 2**20
"""A larger signature is never read. The signature of a release with a thousand files has 300 kB."""
_PART = re.compile(r"[A-Za-z0-9_+=,@-][A-Za-z0-9_+=,@.-]*")
"""A part of a file's name in an artefact: not hidden, not `..`, without characters special to a shell or terminal."""
STRANGE = "links and special files do not belong in an artefact; remove it"


class Problem(msgspec.Struct, frozen=True, order=True):
    """A fault in a file of an artefact."""

    file: str
    """Path within the artefact's folder, with slashes. It is as untrusted as the artefact."""
    what: str
    """What is wrong, and what to do."""


def problems(path: Path, *, hashed: Callable[[str], bool] = lambda _: True) -> Iterator[Problem]:
    """Find all faults of the artefact at `path`.

    Faults are files that are missing, changed, extra, linked or special, folders without a file, names that leave the
    folder or hold odd characters, and a manifest that is not written as `build` writes it. Hard links are ordinary
    files.

    Args:
        path: folder of the artefact.
        hashed: selects by name the files whose bytes are read. For the others, only the size is compared.

    Raises:
        ArtefactError: if there is no manifest, or it cannot be read.
    """
    digest(path)  # raises if there is none
    listed = manifest(path)
    if read_record(path / MANIFEST) != canonical_json(listed):
        yield Problem(MANIFEST, "not written as gym-open writes it (changed bytes); restore it or build again")
    for name in sorted({CONFIG, LINEAGE} - listed.keys()):
        yield Problem(name, f"not listed in {MANIFEST}; build again")
    for name in sorted(listed):
        if not all(_PART.fullmatch(part) for part in name.split("/")) or name == MANIFEST:
            yield Problem(name, f"a name that {MANIFEST} may not list: it leaves the folder, or has odd characters")
    present, folders, strange = walk(path)
    yield from (Problem(name, STRANGE) for name in strange)
    with suppress(ArtefactError):  # an unreadable lineage belongs to no release
        if SIGNATURE not in listed and lineage(path).kind in {"release", "compact"}:
            size = present.pop(SIGNATURE, 0)
            if size > MAX_SIGNATURE_BYTES:
                yield Problem(SIGNATURE, f"{size:,} bytes, at most {MAX_SIGNATURE_BYTES:,} are read; remove it")
    present.pop(MANIFEST, None)
    for name in sorted((listed.keys() | present.keys()) - set(strange)):
        if what := _wrong(path / name, present.get(name), listed.get(name), hashed(name)):
            yield Problem(name, what)
    for name in sorted(folders - {parent.as_posix() for file in present for parent in Path(file).parents}):
        yield Problem(name, "a folder without a file in it; remove it")


def walk(root: Path) -> tuple[dict[str, int], set[str], list[str]]:
    """Size of every file, all folders, and all other items, by name. No link is followed."""
    files: dict[str, int] = {}
    folders: set[str] = set()
    strange: list[str] = []
    waiting = [""]
    while waiting:
        prefix = waiting.pop()
        with os.scandir(root / prefix) as items:
            for item in items:
                name, about = prefix + item.name, item.stat(follow_symlinks=False)
                if stat.S_ISDIR(about.st_mode):
                    folders.add(name)
                    waiting.append(f"{name}/")
                elif stat.S_ISREG(about.st_mode):
                    files[name] = about.st_size
                else:
                    strange.append(name)
    return files, folders, sorted(strange)


def _wrong(path: Path, size: int | None, expected: Entry | None, hashed: bool) -> str | None:
    """The fault of one file, or None."""
    if expected is None:
        return f"not listed in {MANIFEST}; remove the extra file"
    if size is None:
        return f"missing, but listed in {MANIFEST}; restore it or build again"
    if size != expected.bytes:
        return f"{size} bytes, {MANIFEST} says {expected.bytes}; restore it or build again"
    try:
        if hashed and sha256_file(path) != expected.sha256:
            return f"its SHA-256 is not the one in {MANIFEST} (changed bytes); restore it or build again"
    except OSError as error:
        return f"cannot be read ({error.strerror or error}); make it readable, or restore it"
    return None


def verify(path: Path, kind: str | None = None, *, hashed: Callable[[str], bool] = lambda _: True) -> str:
    """Check every byte of the artefact at `path` and return its digest.

    Args:
        path: folder of the artefact.
        kind: if given, the kind that it must be (`log`, `release`, `encoder`, `policy`, …).
        hashed: selects the files to read, as in `problems`.

    Raises:
        ArtefactError: naming the first file that is missing, changed or extra, or the kind if it is another.
    """
    found = digest(path)
    if kind is not None and lineage(path).kind != kind:
        raise ArtefactError(f"{path}: expected an artefact of kind {kind!r}, got {lineage(path).kind!r}")
    for problem in problems(path, hashed=hashed):
        raise ArtefactError(f"{path / problem.file}: {problem.what}")
    return found
