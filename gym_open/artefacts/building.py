"""Make an artefact: in a hidden sibling folder that survives a kill and is renamed when it is whole."""

import functools
import hashlib
import importlib.metadata
import itertools
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gym_open.artefacts.checks import STRANGE, problems, verify, walk
from gym_open.artefacts.code import code_version
from gym_open.artefacts.records import (
    CONFIG,
    LINEAGE,
    MANIFEST,
    Entry,
    Lineage,
    Parent,
    canonical_json,
    digest,
    lineage,
    manifest,
)  # fmt: skip
from gym_open.config import Config, to_dict
from gym_open.errors import ArtefactError, RefusedError, UsageError
from gym_open.files import FULL, lock, sha256_file, unwritable, write_atomically

SCRATCH = "checkpoint"
"""Folder in an unfinished artefact for all that a resumed run needs; removed when the artefact is sealed."""

RECORDED_PACKAGES = (
    "av", "lerobot", "matplotlib", "mcap", "mujoco", "mujoco-core", "numba", "numpy", "pillow", "pyarrow", "torch",
)  # fmt: skip


class Outcome(msgspec.Struct, frozen=True):
    """The result of `build`."""

    path: Path
    made: bool
    """True if `build` made it now, False if it was up to date."""
    earlier: Path | None = None
    """Where an earlier artefact of other inputs, found at `path`, was set aside."""


@functools.cache
def _packages() -> dict[str, str]:
    found = {}
    for name in RECORDED_PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue  # training and evaluation also run without LeRobot
    return found


def build(
    out: Path, *, kind: str, config: Config, parents: Sequence[Path], work: Callable[[Path], Mapping[str, Any]],
    replace: bool = True,
) -> Outcome:  # fmt: skip
    """Make the artefact `out`, unless it exists and is up to date.

    `work` gets a folder to write the payload into and returns the facts for the lineage. The folder survives a kill:
    if it holds files, `work` continues from them. An artefact of other inputs, whole or not, is set aside.

    Args:
        out: folder of the artefact.
        kind: `log`, `release`, `encoder`, `policy`, `probe`, `scores`, `recording` or `figure`.
        config: everything that determines the result, including the seed.
        parents: folders of the input artefacts. Every byte of them is verified first.
        work: writes the payload.
        replace: set aside an artefact of other inputs at `out`; otherwise refuse.

    Raises:
        ArtefactError: if a parent is damaged, `out` is something else, or the disk is full.
        RefusedError: if `work` raises it. Nothing that `work` wrote is kept.
        UsageError: if another process is writing `out`, nothing can be written there, or an artefact of other inputs
            is there and `replace` is false.
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
                f"{out}: exists, made from other inputs or by other code, and is never changed; give another --out, or "
                "for a release a higher --version"
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
            record = Lineage(
                kind=kind, key=key, code=code_version(kind), packages=_packages(), facts=facts, parents=inputs
            )
            _seal(partial, config, record)
        earlier = _set_aside(out) if out.exists() else None
        partial.rename(out)
    return Outcome(path=out, made=True, earlier=earlier)


def remake(
    out: Path, *, kind: str, parents: Sequence[Path], work: Callable[[Path], tuple[Config, Mapping[str, Any]] | None]
) -> Path:
    """Make an artefact at `out`, where nothing is, whose records may already exist elsewhere.

    `work` gets a folder as in `build`. It writes the payload and returns None if it wrote the records too; otherwise it
    returns configuration and facts, and the artefact gets records of its own.

    Raises:
        ArtefactError: if a parent is damaged, the records do not fit the payload, or the disk is full.
        UsageError: if another process is writing `out`, or nothing can be written there.
    """
    out = out.absolute()
    inputs = [Parent(digest=verify(parent), manifest=manifest(parent), lineage=lineage(parent)) for parent in parents]
    key = hashlib.sha256(canonical_json(["remake", kind, [parent.digest for parent in inputs]])).hexdigest()
    partial = out.parent / f".{out.name}.partial"
    with lock(out):
        if not _claim(partial, key):
            try:
                made = work(partial)
            except OSError as error:
                if error.errno in FULL:
                    raise unwritable(Path(error.filename or partial), error) from error
                raise
            if made is None:
                shutil.rmtree(partial / SCRATCH)
                verify(partial, kind)
            else:
                config, facts = made
                packages, code = _packages(), code_version(kind)
                _seal(partial, config, Lineage(kind, key, code, packages, dict(facts), inputs))
        partial.rename(out)
    return out


def _verify_own(out: Path) -> None:
    try:
        verify(out)
    except ArtefactError as error:
        raise ArtefactError(f"{error}. To make it again, remove the folder {out} and run the same command") from None


def _set_aside(path: Path) -> Path:
    """Rename `path` to the first free `NAME-1`, `NAME-2`, …: no artefact is ever deleted."""
    aside = next(name for n in itertools.count(1) if not (name := path.with_name(f"{path.name}-{n}")).exists())
    path.rename(aside)
    return aside


def is_up_to_date(out: Path, *, kind: str, config: Config, parents: Sequence[Path]) -> bool:
    """Return whether `build` would find `out` up to date: made from these inputs by this code, and whole.

    It reads every byte of `out`, but only the manifests of the parents. To check a whole chain, call it for the parents
    too.
    """
    try:
        key = _key(kind, config, [digest(parent) for parent in parents])
        return lineage(out).key == key and not any(problems(out))
    except ArtefactError:
        return False


def _key(kind: str, config: Config, parents: Sequence[str]) -> str:
    value = [kind, to_dict(config), parents, code_version(kind)]
    return hashlib.sha256(canonical_json(value)).hexdigest()


def _claim(partial: Path, key: str) -> bool:
    """Take the working folder. True if it is sealed already: a run was killed before it renamed the folder."""
    if (partial / MANIFEST).is_file() and lineage(partial).key == key:
        shutil.rmtree(partial / SCRATCH, ignore_errors=True)
        _verify_own(partial)
        return True
    mark = partial / SCRATCH / "key"
    if partial.exists() and (not mark.is_file() or mark.read_bytes() != key.encode()):
        _set_aside(partial)
    mark.parent.mkdir(parents=True, exist_ok=True)
    if not mark.exists():
        write_atomically(mark, key.encode())
    return False


def _seal(partial: Path, config: Config, record: Lineage) -> None:
    write_atomically(partial / CONFIG, canonical_json(to_dict(config)))
    write_atomically(partial / LINEAGE, canonical_json(record))
    present, _, strange = walk(partial)
    for name in strange:
        raise ArtefactError(f"{partial / name}: {STRANGE}")
    entries = {
        name: Entry(sha256=sha256_file(partial / name), bytes=size)
        for name, size in present.items()
        if name != MANIFEST and not name.startswith(f"{SCRATCH}/")
    }
    write_atomically(partial / MANIFEST, canonical_json(entries))
    shutil.rmtree(
        partial / SCRATCH
    )  # last: after a kill, the same command continues in this folder, or only renames it
