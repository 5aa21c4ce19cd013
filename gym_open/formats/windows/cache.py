"""Cache of a release's images: decoded from PNG or video once, then kept in small compressed blocks.

During exploration the camera stands still and little moves, so eight consecutive frames compress to about 200 bytes
each. Reading a frame from such a block takes about 20 µs, decoding a PNG file ten times as long. Two million frames
need about 400 MB.
"""

import fcntl
import io
import mmap
import os
import struct
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
import zstandard

from gym_open import artefacts, progress
from gym_open.errors import ArtefactError
from gym_open.formats.releases import IMAGE, Release

LIMIT_BYTES = 2 << 30
"""Default limit of a cache."""

_BLOCK = 8
"""Frames compressed together. With 4, a cache needs 1.5 times the space; with 16, reading takes 1.5 times as long."""
_LEVEL = 3
_PIECE = 2048
"""Frames decoded at a time: 43 MB."""
_TAIL = struct.Struct("<16sqq")
"""End of a cache: `_MAGIC`, number of its frames, limit with which it was made."""
_MAGIC = b"gym-open-frames1"


class Pictures:
    """Images of a release by frame number; the name stays, because cards of published releases use it.

    The constructor decodes frames from the first one on until the limit is reached. It keeps them in memory, or in a
    file of the folder `cache`. The file is named after the release's digest, and later readers of the same release use
    it. All other frames are read from the release on every request, which is slower and gives the same images.

    A cache file is written under a temporary name and renamed when it is complete. If two processes want the same file,
    the second one waits.

    Args:
        release: an open release. Every byte of it is checked before a cache is made.
        cache: folder for the cache, created if missing; None keeps the cache in memory.
        limit_bytes: greatest size of the cache.

    Raises:
        ArtefactError: if the release is damaged, or the cache cannot be written.
    """

    def __init__(self, release: Release, *, cache: Path | None = None, limit_bytes: int = LIMIT_BYTES) -> None:
        self.release = release
        self._cache, self._limit = cache, limit_bytes
        self._shape: tuple[int, ...] = tuple(release.info["features"][IMAGE]["shape"])
        kept = _in_memory(release, limit_bytes) if cache is None else _on_disk(release, cache, limit_bytes)
        self._blocks, self._offsets, self.cached, self._nbytes = kept.blocks, kept.offsets, kept.frames, kept.nbytes

    cached: int
    """Number of cached frames: frames 0 … `cached` - 1 are in the cache."""

    @property
    def nbytes(self) -> int:
        """Size of the cache in bytes."""
        return self._nbytes

    def __len__(self) -> int:
        """Number of frames of the release."""
        return len(self.release)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a copy in another process open the release and the cache itself."""
        if self._cache is None:
            raise TypeError("images in memory cannot be sent to another process; give Pictures a cache folder")
        return _reopen, (self.release.opener, self.release.root, self.release.digest, self._cache, self._limit)

    def take(self, frames: np.ndarray) -> np.ndarray:
        """Images of `frames` (integers of any shape): (*frames.shape, 84, 84, 3) uint8 RGB.

        Threads may call this at the same time.

        Raises:
            IndexError: if a number is not a frame of this release.
            ArtefactError: if the cache file is damaged.
        """
        wanted = frames.reshape(-1)
        if wanted.size and not 0 <= wanted.min() <= wanted.max() < len(self):
            raise IndexError(f"frame numbers must be in [0, {len(self)}), got {wanted.min()}…{wanted.max()}")
        out = np.empty((wanted.size, *self._shape), dtype=np.uint8)
        order = np.argsort(wanted, kind="stable")
        split = np.searchsorted(wanted, self.cached, sorter=order)
        self._fill(out, wanted, order[:split])
        if split < len(order):
            out[order[split:]] = self.release.images(wanted[order[split:]])
        return out.reshape(*frames.shape, *self._shape)

    def _fill(self, out: np.ndarray, wanted: np.ndarray, ascending: np.ndarray) -> None:
        """Fill `out`, each block decompressed once; `ascending` are indices of `out` and `wanted`, by frame number."""
        decompressor = zstandard.ZstdDecompressor()
        block, held = np.empty(0, dtype=np.uint8), -1
        for place, frame in zip(ascending.tolist(), wanted[ascending].tolist(), strict=True):
            number = frame // _BLOCK
            if number != held:
                packed = self._blocks[self._offsets[number] : self._offsets[number + 1]]
                try:
                    data = decompressor.decompress(packed)
                except zstandard.ZstdError as error:
                    raise ArtefactError(
                        f"{self._cache}: block {number} of the images of release {self.release.digest} is damaged "
                        f"({error}); remove this cache"
                    ) from None
                block, held = np.frombuffer(data, dtype=np.uint8).reshape(-1, *self._shape), number
            out[place] = block[frame % _BLOCK]


def _reopen(opener: Callable[[Path], Release], root: Path, digest: str, cache: Path, limit_bytes: int) -> Pictures:
    release = opener(root)
    if release.digest != digest:
        raise _changed(root)
    return Pictures(release, cache=cache, limit_bytes=limit_bytes)


def _changed(root: Path) -> ArtefactError:
    return ArtefactError(f"{root}: has changed since it was opened; open it again")


class _BlockCache:
    """A complete cache: consecutive blocks, the offset of each (int64), and `_TAIL`.

    Raises:
        ValueError: if `data` is not a cache.
    """

    def __init__(self, data: memoryview) -> None:
        if len(data) < _TAIL.size:
            raise ValueError("too short")
        magic, self.frames, self.limit = _TAIL.unpack(data[-_TAIL.size :])
        blocks = -(-self.frames // _BLOCK)
        end = len(data) - _TAIL.size - 8 * (blocks + 1)
        if magic != _MAGIC or self.frames < 0 or end < 0:
            raise ValueError("not made by this version")
        self.offsets = np.frombuffer(data[end : -_TAIL.size], dtype="<i8")
        if self.offsets[0] != 0 or self.offsets[-1] != end or (np.diff(self.offsets) <= 0).any():
            raise ValueError("offsets do not fit")
        self.blocks, self.nbytes = data[:end], len(data)

    def serves(self, frames: int, limit_bytes: int) -> bool:
        """Whether `limit_bytes` would give this same cache for a release with this number of frames."""
        whole = self.frames == frames and self.nbytes <= limit_bytes
        return whole or self.limit == limit_bytes

    @classmethod
    def found(cls, path: Path, frames: int, limit_bytes: int) -> Self | None:
        """The cache at `path`, if it exists and `serves`."""
        try:
            with path.open("rb") as file:
                kept = cls(memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))
        except (OSError, ValueError):
            return None
        return kept if kept.serves(frames, limit_bytes) else None


def _in_memory(release: Release, limit_bytes: int) -> _BlockCache:
    sink = io.BytesIO()
    _write(release, sink, limit_bytes)
    return _BlockCache(sink.getbuffer())


def _on_disk(release: Release, folder: Path, limit_bytes: int) -> _BlockCache:
    path, partial = folder / f"{release.digest}.frames", folder / f".{release.digest}.partial"
    if kept := _BlockCache.found(path, len(release), limit_bytes):
        return kept
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _alone(folder / f".{release.digest}.lock"):
            if kept := _BlockCache.found(path, len(release), limit_bytes):  # another process made it in the meantime
                return kept
            try:
                with partial.open("wb") as sink:
                    _write(release, sink, limit_bytes)
                    sink.flush()
                    os.fsync(sink.fileno())
                partial.replace(path)
            finally:
                partial.unlink(missing_ok=True)
    except OSError as error:
        raise ArtefactError(
            f"{error.filename or path}: the cache of images cannot be written ({error.strerror or error}); make "
            "room, or give another cache folder"
        ) from error
    kept = _BlockCache.found(path, len(release), limit_bytes)
    if kept is None:
        raise ArtefactError(f"{path}: was changed by another program; give another cache folder")
    return kept


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Hold `lock`; its file stays, because another process may wait for it."""
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            progress.console.print("another process decodes these images: waiting for it", highlight=False)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _write(release: Release, sink: BinaryIO, limit_bytes: int) -> None:
    """Write a cache of the frames that fit into `limit_bytes`. Decoding uses all cores."""
    if artefacts.verify(release.root) != release.digest:
        raise _changed(release.root)
    offsets, frames = array("q", [0]), 0
    compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
    with progress.bar("decode images", len(release)) as bar:
        for images in release.image_pieces(_PIECE):
            blocks = [compressor.compress(images[i : i + _BLOCK].data) for i in range(0, len(images), _BLOCK)]
            ends = np.cumsum([len(block) for block in blocks]) + offsets[-1]
            sizes = ends + 8 * (len(offsets) + 1 + np.arange(len(blocks))) + _TAIL.size
            fit = int(np.searchsorted(sizes, limit_bytes, side="right"))
            sink.writelines(blocks[:fit])
            offsets.extend(ends[:fit].tolist())
            frames += min(fit * _BLOCK, len(images))
            bar.advance(len(images))
            if fit < len(blocks):
                break
    sink.write(np.asarray(offsets, dtype="<i8").tobytes())
    sink.write(_TAIL.pack(_MAGIC, frames, limit_bytes))
