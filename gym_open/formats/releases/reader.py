"""The one reader of dataset releases: LeRobot v3.0 folders written by `gym_open.datasets`.

    release = open_release(Path("datasets/out"))
    release.frames                     one row a frame: every scalar feature (pandas)
    release.column("observation.state")  a feature of all frames as one array
    release.images([0, 5, 7])          (3, 84, 84, 3) uint8, bit for bit what the log holds
    release.split("train")             frame numbers of a split

T actions make T + 1 frames: the last frame of an episode carries only the observation (`transition.valid` is False).
"""

import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.errors import ArtefactError
from gym_open.formats.pictures import decode_png, workers
from gym_open.formats.releases.layout import CODEBASE_VERSION, EPISODES_PATH, IMAGE, INFO_PATH, Table

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pandas as pd
    import pyarrow as pa

_CACHED_GROUPS = 512
"""Row groups whose PNG bytes stay in memory: about 1,000 frames each, so at most about 1.5 GB at 2.7 kB a frame."""


class Release:
    """A verified release on disk. Nothing but `info` is read until it is asked for."""

    def __init__(self, root: Path, digest: str, info: dict[str, Any]) -> None:
        self.root = root
        self.digest = digest
        """Digest of the artefact (SHA-256 of its manifest)."""
        self.info = info
        """`meta/info.json`: features, splits, frame rate, and under `gym_open` what is our own."""
        self._group = functools.lru_cache(maxsize=_CACHED_GROUPS)(self._read_group)

    def __len__(self) -> int:
        """Number of frames."""
        return self.info["total_frames"]

    @functools.cached_property
    def frames(self) -> "pd.DataFrame":
        """Every scalar feature, one row a frame; vectors are in `column`, pictures in `images`."""
        names = [name for name, feature in self.info["features"].items() if name != IMAGE and feature["shape"] == [1]]
        return self._data(names).to_pandas()

    @functools.cached_property
    def episodes(self) -> "pd.DataFrame":
        """One row an episode: LeRobot's columns and stream, segment, piece, world, puzzle, ended, continued, …."""
        import pandas as pd

        return pd.read_parquet(self.root / EPISODES_PATH)

    def column(self, name: str) -> np.ndarray:
        """A feature of all frames: (n,) for a scalar, (n, d) for a vector.

        Raises:
            KeyError: if there is no such feature, or it is the picture.
        """
        known = sorted(set(self.info["features"]) - {IMAGE})
        if name not in known:
            raise KeyError(f"{self.root}: no numeric feature {name!r}; it has {', '.join(known)}")
        column = self._data([name]).column(0).combine_chunks()
        shape = self.info["features"][name]["shape"]
        if shape == [1]:
            return column.to_numpy(zero_copy_only=False)
        return column.flatten().to_numpy().reshape(-1, *shape)

    def table(self, name: Table) -> "pd.DataFrame":
        """One of our own tables: streams, worlds, switches or segments (with the state that a replay starts from)."""
        import pandas as pd

        return pd.read_parquet(self.root / f"meta/{name}.parquet")

    def split(self, name: str) -> np.ndarray:
        """Frame numbers of the split `name` (`train`, `val`), int64, ascending; empty if there is no such split."""
        if name not in self.info["splits"]:
            return np.empty(0, dtype=np.int64)
        first, stop = (int(bound) for bound in self.info["splits"][name].split(":"))
        chosen = self.episodes.iloc[first:stop]
        if not len(chosen):
            return np.empty(0, dtype=np.int64)
        return np.arange(chosen["dataset_from_index"].iloc[0], chosen["dataset_to_index"].iloc[-1], dtype=np.int64)

    def pngs(self, indices: Sequence[int] | np.ndarray) -> list[bytes]:
        """PNG files of the frames `indices`, in their order.

        Raises:
            IndexError: if an index is not a frame of this release.
        """
        wanted = np.asarray(indices, dtype=np.int64)
        if wanted.size and (wanted.min() < 0 or wanted.max() >= len(self)):
            raise IndexError(
                f"{self.root}: frame numbers must be in [0, {len(self)}), got {wanted.min()}…{wanted.max()}"
            )
        starts = self._groups[0]
        groups = np.searchsorted(starts, wanted, side="right") - 1
        return [self._group(int(g))[int(i - starts[g])].as_py() for g, i in zip(groups, wanted, strict=True)]

    def images(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        """Pictures of the frames `indices`, in their order: (n, 84, 84, 3) uint8 RGB, decoded in threads.

        Raises:
            IndexError: if an index is not a frame of this release.
        """
        files = self.pngs(indices)
        out = np.empty((len(files), *self.info["features"][IMAGE]["shape"]), dtype=np.uint8)

        def fill(span: range) -> None:
            for i in span:
                out[i] = decode_png(files[i])

        step = 64
        with ThreadPoolExecutor(workers()) as pool:
            list(pool.map(fill, [range(i, min(i + step, len(files))) for i in range(0, len(files), step)]))
        return out

    @functools.cached_property
    def _files(self) -> list[Path]:
        return sorted(self.root.glob("data/chunk-*/file-*.parquet"))

    @functools.cached_property
    def _groups(self) -> tuple[np.ndarray, list[tuple[Path, int]]]:
        """First frame of every row group, and where the group is."""
        import pyarrow.parquet as pq

        starts, places, total = [], [], 0
        for path in self._files:
            metadata = pq.read_metadata(path)
            for group in range(metadata.num_row_groups):
                starts.append(total)
                places.append((path, group))
                total += metadata.row_group(group).num_rows
        return np.asarray(starts, dtype=np.int64), places

    def _read_group(self, number: int) -> "pa.Array":
        import pyarrow.parquet as pq

        path, group = self._groups[1][number]
        with pq.ParquetFile(path) as file:
            table = file.read_row_group(group, columns=[f"{IMAGE}.bytes"])
        return table.column(0).combine_chunks().field("bytes")

    def _data(self, names: list[str]) -> "pa.Table":
        import pyarrow as pa
        import pyarrow.parquet as pq

        return pa.concat_tables(pq.ParquetFile(path).read(columns=names) for path in self._files)


def open_release(root: Path) -> Release:
    """Open the release at `root` after checking every byte of it.

    Raises:
        ArtefactError: if it is missing, damaged (naming the file), not a release, or of another format version.
    """
    digest = artefacts.verify(root, "release")
    path = root / INFO_PATH
    try:
        info = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the release again") from None
    if info.get("codebase_version") != CODEBASE_VERSION:
        found = info.get("codebase_version")
        raise ArtefactError(f"{path}: codebase_version must be {CODEBASE_VERSION!r}, got {found!r}; build it again")
    return Release(root, digest, info)
