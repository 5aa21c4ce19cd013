"""Compile with numba, and cache the machine code on disk if this process can write there."""

import functools
import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numba.core.config


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function at its first call, free of the interpreter lock; keep the machine code for later processes.

    If neither the package's folder nor the user's cache folder is writable, a temporary folder of the user holds the
    machine code. If that folder is not safe, nothing is kept.
    """
    try:
        dispatcher: Any = _compile(function)
    except RuntimeError:  # no folder to cache in
        own = _own_folder()
        if own is None:
            return _compile(function, cache=False)
        numba.core.config.CACHE_DIR = str(own)  # pyright: ignore[reportAttributeAccessIssue]
        dispatcher = _compile(function)
    # Numba compiles again when the function's own file changes. But the machine code also holds functions of other
    # files, and it becomes unreadable when a type in it moves. So a digest of these files is part of the cache's
    # version: code of another version is not read, but overwritten.
    digests = [source_digest(folder) for folder in (Path(__file__).parent, Path(function.__code__.co_filename).parent)]
    dispatcher._cache._cache_file._version = " ".join([numba.__version__, *digests])  # noqa: SLF001
    return dispatcher


def _compile(function: Callable[..., Any], *, cache: bool = True) -> Any:
    return numba.njit(cache=cache, nogil=True, error_model="numpy")(function)


def _own_folder() -> Path | None:
    """A temporary folder to which only this user can write, since its files are executed; None if there is none."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"gym-open-numba-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    safe = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o077
    return folder if safe else None


@functools.cache
def source_digest(folder: Path) -> str:
    """SHA-256 in hex of the paths and contents of all files under a folder that hold compiled code."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        text = path.read_bytes()
        if b"@compiled" in text or b"intrinsic(" in text:
            digest.update(path.relative_to(folder).as_posix().encode() + b"\n" + text)
    return digest.hexdigest()
