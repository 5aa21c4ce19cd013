"""Write files whole or not at all, hash them, and lock folders so that one process writes at a time."""

import errno
import fcntl
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from gym_open.errors import ArtefactError, UsageError

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Error numbers of writing to a full disk; such errors often lack the file's name."""


def sha256_file(path: Path) -> str:
    """SHA-256 of a file, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_regular(path: Path, most: int, *, tail: bool = False) -> bytes:
    """Read at most `most` bytes of a regular file: the first ones, or the last ones if `tail`.

    Raises:
        OSError: if the file cannot be read, or is a link or not a regular file, because reading it may never end.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:  # noqa: PTH123  (a descriptor)
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        file.seek(max(status.st_size - most, 0) if tail else 0)
        return file.read(most)


def write_atomically(path: Path, data: bytes) -> None:
    """Write a temporary file, flush it to disk, then rename it: readers see the old bytes or the new, never a mixture.

    Raises:
        ArtefactError: if the file cannot be written, for example on a full disk; the old file stays.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.rename(path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def unwritable(path: Path, error: OSError) -> ArtefactError:
    """The error to raise if `path` could not be written, with the reason and the remedy."""
    return ArtefactError(
        f"{path}: cannot be written ({error.strerror or error}); what was there before is kept: make room, or make its "
        "folder writable, then run the same command again"
    )


@contextmanager
def lock(out: Path) -> Iterator[None]:
    """Lock `out` against other processes, by a file next to it. The parent folder is made if it is missing.

    Raises:
        UsageError: if another process holds the lock, or nothing can be written there.
        ArtefactError: if the disk is full.
    """
    with _mark(out) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                f"{out}: another gym-open process is writing it; wait for it or give another --out"
            ) from None
        try:
            yield
        finally:
            Path(file.name).unlink(missing_ok=True)


def _mark(out: Path) -> IO[str]:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        return (out.parent / f".{out.name}.lock").open("w")
    except OSError as error:
        if error.errno in FULL:
            raise unwritable(out, error) from error
        there = next(folder for folder in out.absolute().parents if folder.exists())
        why = f"nothing new can be made in {there}" if there.is_dir() else f"{there} is not a folder"
        raise UsageError(f"{out}: cannot be made: {why} ({error.strerror or error}); give another --out") from None
