"""Compressed files of compact releases: rows as lines of JSON, and numbers; both read piece by piece.

The files are untrusted. A reader unpacks as many numbers as it is asked for, and rows only up to a multiple of the
file's size, so that a small file cannot fill the memory.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec
import numpy as np
import zstandard

from gym_open.errors import ArtefactError

_LEVEL = 19
_WINDOW_BYTES = 2**23
"""Greatest window of a compressed file; zstd's at this level."""
_MAX_RATIO, _MAX_LINE = 512, 2**26
_PIECE = 2**20
_BLOCK = 2**16
"""Numbers in a block. The first bytes of all numbers of a block come first, because they are alike."""
_REMEDY = "it is damaged or not from gym-open; get the compact release again"

R = TypeVar("R", bound=msgspec.Struct)


def write_rows(path: Path, rows: Iterable[msgspec.Struct]) -> None:
    """Write rows as lines of JSON."""
    with path.open("wb") as raw, zstandard.ZstdCompressor(level=_LEVEL).stream_writer(raw) as file:
        for row in rows:
            file.write(msgspec.json.encode(row) + b"\n")


def read_rows(path: Path, kind: type[R]) -> Iterator[R]:
    """Read the rows of type `kind`.

    Raises:
        ArtefactError: if the file is missing, damaged, holds something else, or would unpack to far more than its size.
    """
    number = 0
    try:
        for line in _lines(path):
            yield msgspec.json.decode(line, type=kind)
            number += 1
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: row {number}: {error}; {_REMEDY}") from None


def _lines(path: Path) -> Iterator[bytes]:
    rest, unpacked = b"", 0
    with _Compressed(path) as (raw, size):
        while piece := _read(path, raw, _PIECE):
            unpacked += len(piece)
            *lines, rest = (rest + piece).split(b"\n")
            if unpacked > _MAX_RATIO * size + _PIECE or len(rest) > _MAX_LINE:
                raise ArtefactError(f"{path}: unpacks to more than {_MAX_RATIO} times its {size:,} bytes; {_REMEDY}")
            yield from lines
    if rest:
        raise ArtefactError(f"{path}: its last row has no end; {_REMEDY}")


class NumberWriter:
    """Writes numbers of one type; a context manager."""

    def __init__(self, path: Path, kind: type[np.generic]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._kind = np.dtype(kind).newbyteorder("<")
        self._raw = path.open("wb")
        self._file = zstandard.ZstdCompressor(level=_LEVEL).stream_writer(self._raw)
        self._waiting = np.empty(0, self._kind)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._write(self._waiting)
        self._file.close()
        self._raw.close()

    def add(self, values: np.ndarray) -> None:
        """Add numbers; they are converted to the file's type."""
        waiting = np.concatenate([self._waiting, values.astype(self._kind)])
        full = len(waiting) // _BLOCK * _BLOCK
        for start in range(0, full, _BLOCK):
            self._write(waiting[start : start + _BLOCK])
        self._waiting = waiting[full:]

    def _write(self, block: np.ndarray) -> None:
        if len(block):
            self._file.write(block.view(np.uint8).reshape(len(block), -1).T.tobytes())


class NumberReader:
    """Reads the `total` numbers of a file in order; a context manager.

    Raises:
        ArtefactError: if the file is missing, damaged, or holds more or fewer numbers.
    """

    def __init__(self, path: Path, kind: type[np.generic], total: int) -> None:
        self._path, self._kind, self._left = path, np.dtype(kind).newbyteorder("<"), total
        self._block = np.empty(0, self._kind)
        self._at = 0
        self._file = _Compressed(path)

    def __enter__(self) -> Self:
        self._raw, _ = self._file.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None and (self._left or self._at < len(self._block) or _read(self._path, self._raw, 1)):
                raise ArtefactError(f"{self._path}: holds more numbers than its episodes have; {_REMEDY}")
        finally:
            self._file.__exit__(kind, error, trace)

    def take(self, count: int) -> np.ndarray:
        """The next `count` numbers."""
        found: list[np.ndarray] = []
        while count > 0:
            if self._at == len(self._block):
                self._next_block()
            part = self._block[self._at : self._at + count]
            found.append(part)
            self._at += len(part)
            count -= len(part)
        return np.concatenate([np.empty(0, self._kind), *found])

    def _next_block(self) -> None:
        size = min(_BLOCK, self._left)
        width = self._kind.itemsize
        data = _read(self._path, self._raw, size * width)
        if len(data) != size * width or not size:
            raise ArtefactError(f"{self._path}: holds fewer numbers than its episodes have; {_REMEDY}")
        self._block = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(width, size).T).view(self._kind)[:, 0]
        self._at, self._left = 0, self._left - size


class _Compressed:
    """A compressed file and its size on disk."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> tuple[Any, int]:
        if self._path.is_symlink() or not self._path.is_file():
            raise ArtefactError(f"{self._path}: missing, or a link; {_REMEDY}")
        self._raw = self._path.open("rb")
        reader = zstandard.ZstdDecompressor(max_window_size=_WINDOW_BYTES).stream_reader(self._raw, closefd=False)
        return reader, self._path.stat().st_size

    def __exit__(self, *error: object) -> None:
        self._raw.close()


def _read(path: Path, file: Any, count: int) -> bytes:
    """Read up to `count` bytes, fewer only at the end."""
    pieces: list[bytes] = []
    try:
        while count > 0 and (piece := file.read(count)):
            pieces.append(piece)
            count -= len(piece)
    except zstandard.ZstdError as error:
        raise ArtefactError(f"{path}: cannot be unpacked: {error}; {_REMEDY}") from None
    return b"".join(pieces)
