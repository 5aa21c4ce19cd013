"""Artefacts: folders that are whole or absent, know their bytes, and know where they come from.

An artefact is a folder of payload files and three records:

    config.json     all of the configuration that made it, defaults included
    lineage.json    kind, key of its inputs, parents (digest and lineage of each), code and package versions, facts
    manifest.json   SHA-256 and size of every other file

Its *digest* is the SHA-256 of manifest.json. No path, host, user name or time of day is in any of them, so the same
inputs give the same digest in any folder. It is written in a hidden sibling folder and renamed when it is whole.

A release may have a signature.json beside them: it signs the manifest, so it cannot be in it.
"""

import functools
import hashlib
import importlib.metadata
import itertools
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

import gym_open
from gym_open.config import Config, to_dict
from gym_open.errors import ArtefactError, RefusedError, UsageError
from gym_open.files import FULL, lock, sha256_file, unwritable, write_atomically

CONFIG, LINEAGE, MANIFEST = "config.json", "lineage.json", "manifest.json"
SIGNATURE = "signature.json"
"""Of a release, and made after it: the one file that its manifest does not list."""
SCRATCH = "checkpoint"
"""Folder inside an unfinished artefact for whatever a resume needs; removed before sealing."""

_MAX_RECORD_BYTES = 2**26
"""A manifest or lineage is refused above this size: fifty times what a large release has."""
MAX_SIGNATURE_BYTES = 2**20
"""A signature above this size is never read: that of a release with a thousand files has 300 kB."""
_PART = re.compile(r"[A-Za-z0-9_+=,@-][A-Za-z0-9_+=,@.-]*")
"""Part of a file's name in an artefact: nothing hidden, no way up, nothing that a shell or terminal takes amiss."""

RECORDED_PACKAGES = (
    "av", "lerobot", "matplotlib", "mcap", "mujoco", "mujoco-core", "numba", "numpy", "pillow", "pyarrow", "torch",
)  # fmt: skip


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


class Outcome(msgspec.Struct, frozen=True):
    """What `build` did."""

    path: Path
    made: bool
    """Made now, or found up to date."""
    earlier: Path | None = None
    """Where an artefact of other inputs, which stood at `path` before, was put aside."""


def canonical_json(value: Any) -> bytes:
    """JSON with sorted keys and a final newline: equal values give equal bytes."""
    return msgspec.json.format(msgspec.json.encode(value, order="sorted"), indent=1) + b"\n"


@functools.cache
def code_version() -> str:
    """Version of gym-open and a digest of its source files, so that changed code is never taken for the same."""
    root = Path(gym_open.__file__).parent
    total = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.jinja")]):
        total.update(f"{path.relative_to(root).as_posix()} {sha256_file(path)}\n".encode())
    return f"{gym_open.__version__}+{total.hexdigest()[:12]}"


@functools.cache
def _packages() -> dict[str, str]:
    found = {}
    for name in RECORDED_PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue  # training and evaluation also run where LeRobot is not installed
    return found


def digest(path: Path) -> str:
    """Digest of the artefact at `path`.

    Raises:
        ArtefactError: if there is no artefact.
    """
    try:
        return hashlib.sha256(_record(path / MANIFEST)).hexdigest()
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


def _record(path: Path) -> bytes:
    about = path.lstat()
    if not stat.S_ISREG(about.st_mode) or about.st_size > _MAX_RECORD_BYTES:
        raise ArtefactError(f"{path}: a link, a special file, or over {_MAX_RECORD_BYTES:,} bytes; get it anew")
    return path.read_bytes()


def _read(path: Path, kind: Any) -> Any:
    try:
        return msgspec.json.decode(_record(path), type=kind)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing; the artefact is not whole, build it again") from None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the artefact again") from None


_STRANGE = "links and special files do not belong in an artefact; remove it"


class Problem(msgspec.Struct, frozen=True, order=True):
    """Something that is wrong with a file of an artefact."""

    file: str
    """Its name below the artefact's folder, with slashes; as untrusted as the artefact."""
    what: str
    """What is wrong, and what to do."""


def problems(path: Path, *, hashed: Callable[[str], bool] = lambda _: True) -> Iterator[Problem]:
    """Everything that keeps the artefact at `path` from being what its manifest says, and whole.

    Files that are missing, changed, extra, linked or special, folders without a file, names that leave the folder or
    hold odd characters, and a manifest that is not written as `build` writes it. Hard links are files like others.

    Args:
        path: folder of the artefact.
        hashed: of which files (by name) the bytes are read; of the others only the size is held against the manifest.

    Raises:
        ArtefactError: if there is no manifest, or it cannot be read.
    """
    digest(path)  # raises if there is none
    listed = manifest(path)
    if _record(path / MANIFEST) != canonical_json(listed):
        yield Problem(MANIFEST, "not written as gym-open writes it (changed bytes); restore it or build again")
    for name in sorted({CONFIG, LINEAGE} - listed.keys()):
        yield Problem(name, f"not listed in {MANIFEST}; build again")
    for name in sorted(listed):
        if not all(_PART.fullmatch(part) for part in name.split("/")) or name == MANIFEST:
            yield Problem(name, f"a name that {MANIFEST} may not list: it leaves the folder, or has odd characters")
    present, folders, strange = _walk(path)
    yield from (Problem(name, _STRANGE) for name in strange)
    with suppress(ArtefactError):  # a lineage that cannot be read is none of a release
        if SIGNATURE not in listed and lineage(path).kind == "release":
            size = present.pop(SIGNATURE, 0)
            if size > MAX_SIGNATURE_BYTES:
                yield Problem(SIGNATURE, f"{size:,} bytes, at most {MAX_SIGNATURE_BYTES:,} are read; remove it")
    present.pop(MANIFEST, None)
    for name in sorted((listed.keys() | present.keys()) - set(strange)):
        if what := _wrong(path / name, present.get(name), listed.get(name), hashed(name)):
            yield Problem(name, what)
    for name in sorted(folders - {parent.as_posix() for file in present for parent in Path(file).parents}):
        yield Problem(name, "a folder without a file in it; remove it")


def _walk(root: Path) -> tuple[dict[str, int], set[str], list[str]]:
    """Size of every file, all folders, and what is neither, by name; no link is followed."""
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
    """What is wrong with one file, if anything."""
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
        hashed: as `problems` has it: which files to read.

    Raises:
        ArtefactError: naming the first file that is missing, changed or extra, or the wrong kind.
    """
    found = digest(path)
    if kind is not None and lineage(path).kind != kind:
        raise ArtefactError(f"{path}: expected an artefact of kind {kind!r}, got {lineage(path).kind!r}")
    for problem in problems(path, hashed=hashed):
        raise ArtefactError(f"{path / problem.file}: {problem.what}")
    return found


def build(
    out: Path, *, kind: str, config: Config, parents: Sequence[Path], work: Callable[[Path], Mapping[str, Any]],
    replace: bool = True,
) -> Outcome:  # fmt: skip
    """Make the artefact `out` unless it is already there and up to date.

    `work` gets a folder to write the payload into and returns the facts for the lineage. The folder survives a kill:
    if it holds files, `work` goes on from them. What was made of other inputs, whole or not, is set aside.

    Args:
        out: folder of the artefact.
        kind: `log`, `release`, `encoder`, `policy`, `probe`, `scores`, `recording` or `figure`.
        config: everything that decides the result, the seed included.
        parents: folders of the input artefacts; each is verified byte by byte first.
        work: writes the payload.
        replace: whether an artefact of other inputs at `out` is set aside, rather than left alone.

    Raises:
        ArtefactError: if a parent is damaged, `out` is something else, or the disk is full.
        RefusedError: if `work` raises it; nothing of what it made is kept.
        UsageError: if another process is writing `out` now, nothing can be written there, or it is there, of other
            inputs, and not to be replaced.
    """
    out = out.absolute()
    inputs = [Parent(digest=verify(parent), manifest=manifest(parent), lineage=lineage(parent)) for parent in parents]
    key = _key(kind, config, [parent.digest for parent in inputs])
    if out.exists():
        if not (out / LINEAGE).is_file():
            raise ArtefactError(f"{out}: exists and is not an artefact of gym-open; give another --out or remove it")
        if lineage(out).key == key:
            _verify_own(out)
            return Outcome(path=out, made=False)
        if not replace:
            raise UsageError(
                f"{out}: is there already, made of other inputs or by other code, and is never changed; give another "
                "--out, or of a release a higher --version"
            )
    partial = out.parent / f".{out.name}.partial"
    with lock(out):
        if not _claim(partial, key):
            try:
                facts = dict(work(partial))
            except RefusedError:
                shutil.rmtree(partial)
                raise
            except OSError as error:
                if error.errno in FULL:
                    raise unwritable(Path(error.filename or partial), error) from error
                raise
            record = Lineage(kind=kind, key=key, code=code_version(), packages=_packages(), facts=facts, parents=inputs)
            _seal(partial, config, record)
        earlier = _set_aside(out) if out.exists() else None
        partial.rename(out)
    return Outcome(path=out, made=True, earlier=earlier)


def _verify_own(out: Path) -> None:
    try:
        verify(out)
    except ArtefactError as error:
        raise ArtefactError(f"{error}. To make it anew: remove the folder {out} and run the same command") from None


def _set_aside(path: Path) -> Path:
    """Rename `path` to the first free `NAME-1`, `NAME-2`, …: nothing that was made is ever deleted."""
    aside = next(name for n in itertools.count(1) if not (name := path.with_name(f"{path.name}-{n}")).exists())
    path.rename(aside)
    return aside


def is_up_to_date(out: Path, *, kind: str, config: Config, parents: Sequence[Path]) -> bool:
    """Whether `build` would find `out` up to date: made of these inputs by this code, and whole.

    Every byte of `out` is read, and of the parents only their manifests: who asks this of many artefacts asks it of the
    parents, too.
    """
    try:
        key = _key(kind, config, [digest(parent) for parent in parents])
        return lineage(out).key == key and not any(problems(out))
    except ArtefactError:
        return False


def _key(kind: str, config: Config, parents: Sequence[str]) -> str:
    value = [kind, to_dict(config), parents, code_version()]
    return hashlib.sha256(canonical_json(value)).hexdigest()


def _claim(partial: Path, key: str) -> bool:
    """Take the folder to work in; True if all is done, by a run that was killed between sealing and renaming it."""
    if (partial / MANIFEST).is_file() and lineage(partial).key == key:
        shutil.rmtree(partial / SCRATCH, ignore_errors=True)
        _verify_own(partial)
        return True
    mark = partial / SCRATCH / "key"
    if partial.exists() and (not mark.is_file() or mark.read_text() != key):
        _set_aside(partial)
    mark.parent.mkdir(parents=True, exist_ok=True)
    if not mark.exists():
        write_atomically(mark, key.encode())
    return False


def _seal(partial: Path, config: Config, record: Lineage) -> None:
    write_atomically(partial / CONFIG, canonical_json(to_dict(config)))
    write_atomically(partial / LINEAGE, canonical_json(record))
    present, _, strange = _walk(partial)
    for name in strange:
        raise ArtefactError(f"{partial / name}: {_STRANGE}")
    entries = {
        name: Entry(sha256=sha256_file(partial / name), bytes=size)
        for name, size in present.items()
        if name != MANIFEST and not name.startswith(f"{SCRATCH}/")
    }
    write_atomically(partial / MANIFEST, canonical_json(entries))
    shutil.rmtree(partial / SCRATCH)  # last: a kill leaves a folder that the same command goes on from, or only renames
