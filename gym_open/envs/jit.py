"""Compiling with numba, cached on disk wherever this process may write."""

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
    """Compile on first call, without the interpreter lock, and keep the machine code for later processes.

    Where neither the package's folder nor the user's cache folder can be written, a temporary one of the user's own is
    used; where that is not safe, nothing is kept.
    """
    try:
        dispatcher: Any = _compile(function)
    except RuntimeError:  # no folder to cache in
        own = _own_folder()
        if own is None:
            return _compile(function, cache=False)
        numba.core.config.CACHE_DIR = str(own)  # pyright: ignore[reportAttributeAccessIssue]
        dispatcher = _compile(function)
    # Numba makes it anew when the function's own file changes. But what it calls in other files is in it, too, and what
    # was kept cannot even be read once a type in it has moved. Another version is left unread, and overwritten.
    digests = [source_digest(folder) for folder in (Path(__file__).parent, Path(function.__code__.co_filename).parent)]
    dispatcher._cache._cache_file._version = " ".join([numba.__version__, *digests])  # noqa: SLF001
    return dispatcher


def _compile(function: Callable[..., Any], *, cache: bool = True) -> Any:
    return numba.njit(cache=cache, nogil=True, error_model="numpy")(function)


def _own_folder() -> Path | None:
    """A temporary folder that no one else can write to: what is read from it is executed. None if there is none."""
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
    """SHA-256 in hex of the files under a folder that hold compiled code, and of where they are."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        text = path.read_bytes()
        if b"@compiled" in text or b"intrinsic(" in text:
            digest.update(path.relative_to(folder).as_posix().encode() + b"\n" + text)
    return digest.hexdigest()
