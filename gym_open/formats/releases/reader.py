"""Reader of dataset releases: LeRobot v3.0 folders written by `gym_open.datasets`.

    release = open_release(Path("datasets/open/explore/1.0.0"))
    release.frames                     one row per frame: every scalar feature (pandas)
    release.column("observation.state")  a feature of all frames as one array
    release.images([0, 5, 7])          (3, 84, 84, 3) uint8, the same bits as in the log (of PNG releases)
    release.split("train")             frame numbers of a split

T actions make T + 1 frames: the last frame of an episode holds only the observation (`transition.valid` is False). A
release is untrusted until it is verified: the reader opens only files with known names and checks what they hold.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gym_open import artefacts, extras
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.pngs import decode_untrusted
from gym_open.formats.releases import parquet, videos
from gym_open.formats.releases.episodes import EpisodeData
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import (
    DATA_PATHS,
    EPISODES_PATHS,
    IMAGE,
    SPLITS,
    TABLES,
    VIDEO_PATHS,
    Table,
    belongs,
)
from gym_open.formats.releases.schemas import NULLABLE, STATS, episodes_schema, table_schema
from gym_open.hardware import usable_cores

if TYPE_CHECKING:  # slow to import, and needed only for reading
    import pandas as pd
    import pyarrow as pa

_CACHED_GROUPS = 512
"""Row groups whose PNG bytes stay in memory: about 1,000 frames each, or 450 MB in all at 860 bytes per frame."""
_CACHED_TABLES = 4
"""Row groups whose numbers stay in memory: about 1.5 MB each."""
_BULK = ("data/", "videos/")
"""Folders whose bytes are not checked when a release is opened."""


class Release:
    """A release on disk whose names, sizes and records were checked. Only `info` is read before a method needs more."""

    def __init__(self, root: Path, digest: str, info: dict[str, Any], *, cached_groups: int = _CACHED_GROUPS) -> None:
        self.root = root
        self.digest = digest
        """Digest of the artefact (SHA-256 of its manifest)."""
        self.info = info
        """`meta/info.json`: features, splits, frame rate, and our own fields under `gym_open`."""
        self.name: str = info["gym_open"]["name"]
        """Namespace and name."""
        self.version: str = info["gym_open"]["version"]
        self._group = functools.lru_cache(maxsize=cached_groups)(self._read_group)
        self._group_numbers = functools.lru_cache(maxsize=_CACHED_TABLES)(self._read_numbers)

    def __len__(self) -> int:
        """Number of frames."""
        return self.info["total_frames"]

    @functools.cached_property
    def frames(self) -> "pd.DataFrame":
        """Every scalar feature, one row per frame. `column` gives vectors and `images` gives images."""
        names = [name for name, feature in self._numbers.items() if feature["shape"] == [1]]
        return self._data(names).to_pandas()

    @functools.cached_property
    def episodes(self) -> "pd.DataFrame":
        """One row per episode: LeRobot's columns and stream, segment, piece, world, puzzle, ended, continued, ….

        Raises:
            ArtefactError: if a file is damaged or of another schema, or the number of rows is not that in `info`.
        """
        import pyarrow as pa

        columns = episodes_schema(self.info["features"])
        names = [name for name in columns.names if not name.startswith(STATS)]
        found = [parquet.read(path, columns, names) for path in sorted(self.root.glob(EPISODES_PATHS))]
        table = self._whole("meta/episodes", pa.concat_tables([columns.empty_table().select(names), *found]))
        if len(table) != self.info["total_episodes"]:
            raise ArtefactError(
                f"{self.root}: {len(table):,} rows in meta/episodes, meta/info.json says "
                f"{self.info['total_episodes']:,}; get the release again"
            )
        return table.to_pandas()

    def column(self, name: str) -> np.ndarray:
        """One feature of all frames: (n,) for a scalar, (n, d) for a vector.

        Raises:
            KeyError: if there is no such feature, or it is the image.
            ArtefactError: if a file is damaged.
        """
        if name not in self._numbers:
            known = ", ".join(sorted(self._numbers))
            raise KeyError(f"{self.root}: no numeric feature {name!r}; it has {known}")
        return self._array(name, self._data([name]))

    def numbers(self, first: int, stop: int) -> dict[str, np.ndarray]:
        """All numeric features of the frames from `first` to `stop` (exclusive), by name.

        It needs memory for these frames and for their row groups.

        Raises:
            IndexError: if the release does not have these frames.
            ArtefactError: if a file is damaged.
        """
        import pyarrow as pa

        if not 0 <= first < stop <= len(self):
            raise IndexError(f"{self.root}: expected frames within [0, {len(self)}), got {first} to {stop}")
        starts = self._groups[0]
        groups = range(int(np.searchsorted(starts, first, side="right")) - 1, int(np.searchsorted(starts, stop)))
        pieces = [self._group_numbers(group) for group in groups]
        table = pa.concat_tables(pieces).slice(first - int(starts[groups[0]]), stop - first)
        return {name: self._array(name, table) for name in self._numbers}

    def table(self, name: Table) -> "pd.DataFrame":
        """One of our own tables with all batches: streams, worlds, switches, segments, keyframes or content.

        Raises:
            ArtefactError: if a file is damaged or of another schema.
        """
        return self.arrow_table(name).to_pandas()

    def arrow_table(self, name: Table) -> "pa.Table":
        """Like `table`, as an Arrow table."""
        import pyarrow as pa

        if name not in TABLES:
            raise KeyError(f"{self.root}: no table {name!r}; releases have {', '.join(TABLES)}")

        columns = table_schema(name, self.info["features"])
        found = [parquet.read(path, columns) for path in sorted(self.root.glob(f"meta/{name}/file-*.parquet"))]
        return self._whole(f"meta/{name}", pa.concat_tables([columns.empty_table(), *found]))

    def split(self, name: str) -> np.ndarray:
        """Frame numbers of the split `name` (`train` or `val`), int64, ascending; may be empty.

        Raises:
            KeyError: if releases have no split of that name.
        """
        if name not in SPLITS:
            raise KeyError(f"{self.root}: no split {name!r}; releases have {', '.join(SPLITS)}")
        chosen = self.episodes[self.episodes["split"] == name]
        spans = zip(chosen["dataset_from_index"], chosen["dataset_to_index"], strict=True)
        return np.concatenate(
            [np.empty(0, np.int64), *(np.arange(first, stop, dtype=np.int64) for first, stop in spans)]
        )

    def filter_episodes(self, condition: Callable[[dict[Any, Any]], bool]) -> np.ndarray:
        """Indices of the episodes whose row of `episodes` meets a condition, int64, ascending; reads no frames."""
        rows = self.episodes.to_dict("records")
        return np.array([row["episode_index"] for row in rows if condition(row)], dtype=np.int64)

    def iterate_episodes(self, indices: Sequence[int] | np.ndarray | None = None) -> Iterator[EpisodeData]:
        """Read the episodes `indices` (default all) one after the other; memory is that of one episode.

        Raises:
            IndexError: if an index is not an episode of this release.
            ArtefactError: if a file or an image is damaged.
        """
        total = len(self.episodes)
        for index in range(total) if indices is None else indices:
            if not 0 <= index < total:
                raise IndexError(f"{self.root}: expected an episode within [0, {total}), got {index}")
            row = self.episodes.iloc[index]
            first, stop = int(row["dataset_from_index"]), int(row["dataset_to_index"])
            frames = self.numbers(first, stop)
            actions = frames["action.index"][:-1]
            rewards = frames.get("reward.intrinsic", np.full(stop - first, np.nan, np.float32))[:-1]
            yield EpisodeData(int(index), self.images(range(first, stop)), actions, rewards, frames)

    def sample_episodes(
        self, n: int, rng: np.random.Generator, indices: Sequence[int] | np.ndarray | None = None
    ) -> Iterator[EpisodeData]:
        """Read `n` different episodes, drawn uniformly at random from `indices` (default all).

        Raises:
            UsageError: if there are fewer than `n`.
        """
        pool = np.arange(len(self.episodes)) if indices is None else np.asarray(indices)
        if not 0 <= n <= len(pool):
            raise UsageError(f"n: expected 0 to {len(pool)}, the number of episodes to draw from, got {n}")
        return self.iterate_episodes(rng.choice(pool, size=n, replace=False))

    def pngs(self, indices: Sequence[int] | np.ndarray) -> list[bytes]:
        """PNG files of the frames `indices`, in that order.

        Raises:
            IndexError: if an index is not a frame of this release.
            ArtefactError: if the release stores images as video, or a file is damaged.
        """
        if self._is_video:
            raise ArtefactError(f"{self.root}: stores its images as video and has no PNG files; use `images`")
        wanted = self._checked(indices)
        starts = self._groups[0]
        groups = np.searchsorted(starts, wanted, side="right") - 1
        return [self._group(int(g))[int(i - starts[g])].as_py() for g, i in zip(groups, wanted, strict=True)]

    def images(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        """Images of the frames `indices`, in that order: (n, 84, 84, 3) uint8 RGB, decoded in threads.

        Raises:
            IndexError: if an index is not a frame of this release.
            ArtefactError: if a file or an image is damaged.
        """
        wanted = self._checked(indices)
        out = np.empty((len(wanted), *self.info["features"][IMAGE]["shape"]), dtype=np.uint8)
        if self._is_video:
            self._decode_video(wanted, out)
            return out
        files = self.pngs(wanted)

        def fill(span: range) -> None:
            for i in span:
                try:
                    out[i] = decode_untrusted(files[i])
                except ValueError as error:
                    raise ArtefactError(
                        f"{self.root}: image of frame {wanted[i]}: {error}; get the release again"
                    ) from None

        step = 64
        with ThreadPoolExecutor(usable_cores()) as pool:
            list(pool.map(fill, [range(i, min(i + step, len(files))) for i in range(0, len(files), step)]))
        return out

    def image_pieces(self, count: int) -> Iterator[np.ndarray]:
        """All images in order, `count` at a time: (count, 84, 84, 3) uint8; the last piece may be shorter.

        Raises:
            ArtefactError: if a file or an image is damaged.
        """
        once = Release(self.root, self.digest, self.info, cached_groups=2)  # each group is read once, in order
        for start in range(0, len(self), count):
            yield once.images(np.arange(start, min(start + count, len(self))))

    @property
    def records(self) -> Path:
        """Folder with `manifest.json`, `meta/info.json` and the documents."""
        return self.root

    @staticmethod
    def opener(root: Path) -> "Release":
        """Open a release of this kind, for copies in other processes."""
        return open_release(root)

    @property
    def _is_video(self) -> bool:
        return self.info["features"][IMAGE]["dtype"] == "video"

    @functools.cached_property
    def _numbers(self) -> dict[str, Any]:
        """Description of every numeric feature."""
        return {name: feature for name, feature in self.info["features"].items() if name != IMAGE}

    @functools.cached_property
    def _schema(self) -> "pa.Schema":
        from gym_open.formats.releases.features import schema

        return schema(self.info["features"])

    def _checked(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        wanted = np.asarray(indices, dtype=np.int64)
        if wanted.size and (wanted.min() < 0 or wanted.max() >= len(self)):
            raise IndexError(
                f"{self.root}: frame numbers must be in [0, {len(self)}), got {wanted.min()}…{wanted.max()}"
            )
        return wanted

    def _decode_video(self, wanted: np.ndarray, out: np.ndarray) -> None:
        """Decode frames into `out`; each run of consecutive frames is decoded in one pass."""
        order = np.argsort(wanted, kind="stable")
        for path, start, stop in self._videos:
            inside = order[np.searchsorted(wanted[order], start) : np.searchsorted(wanted[order], stop)]
            numbers = np.unique(wanted[inside])
            for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if numbers.size else ():
                images = videos.decode(path, int(run[0]) - start, int(run[-1]) - start + 1)
                for number, image in zip(run, images, strict=True):
                    out[wanted == number] = image

    @functools.cached_property
    def _videos(self) -> list[tuple[Path, int, int]]:
        """Each video with its first frame and the frame after its last: those of the data file of the same number."""
        paths = sorted(self.root.glob(VIDEO_PATHS))
        sizes = [parquet.metadata(path).num_rows for path in self._files]
        if len(paths) != len(sizes):
            raise ArtefactError(f"{self.root}: {len(paths)} videos of {len(sizes)} data files; get the release again")
        ends = np.cumsum(sizes).tolist()
        return [(path, end - size, end) for path, size, end in zip(paths, sizes, ends, strict=True)]

    @functools.cached_property
    def _files(self) -> list[Path]:
        return sorted(self.root.glob(DATA_PATHS))

    @functools.cached_property
    def _groups(self) -> tuple[np.ndarray, list[tuple[Path, int]]]:
        """First frame of every row group, and the file and number of the group."""
        starts, places, total = [], [], 0
        for path in self._files:
            metadata = parquet.metadata(path)
            for group in range(metadata.num_row_groups):
                starts.append(total)
                places.append((path, group))
                total += metadata.row_group(group).num_rows
        if total != len(self):
            raise ArtefactError(
                f"{self.root}: {total:,} frames in data, meta/info.json says {len(self):,}; get the release again"
            )
        return np.asarray(starts, dtype=np.int64), places

    def _whole(self, name: str, table: "pa.Table") -> "pa.Table":
        """Return the table. Raises ArtefactError if a value is missing that must be there."""
        for column in set(table.column_names) - NULLABLE:
            values = table.column(column).combine_chunks()
            while values.null_count == 0 and values.type.num_fields:
                values = values.flatten()
            if values.null_count:
                raise ArtefactError(
                    f"{self.root / name}: values of column {column!r} are missing; get the release again"
                )
        return table

    def _read_numbers(self, number: int) -> "pa.Table":
        path, group = self._groups[1][number]
        return parquet.read(path, self._schema, list(self._numbers), [group])

    def _read_group(self, number: int) -> "pa.Array":
        path, group = self._groups[1][number]
        table = parquet.read(path, self._schema, [f"{IMAGE}.bytes"], [group])
        return table.column(0).combine_chunks().field("bytes")

    def _data(self, names: list[str]) -> "pa.Table":
        import pyarrow as pa

        return pa.concat_tables(parquet.read(path, self._schema, names) for path in self._files)

    def _array(self, name: str, table: "pa.Table") -> np.ndarray:
        """A column as an array. Raises ArtefactError if a value is missing."""
        column = table.column(name).combine_chunks()
        shape = self._numbers[name]["shape"]
        values = column if shape == [1] else column.flatten()
        if column.null_count or values.null_count or len(values) != len(column) * shape[0]:
            raise ArtefactError(f"{self.root}: values of feature {name!r} are missing; get the release again")
        array = values.to_numpy(zero_copy_only=False)
        return array if shape == [1] else array.reshape(-1, *shape)


def open_release(root: Path, *, check: Literal["records", "bytes"] = "records") -> Release:
    """Open the release at `root`.

    Args:
        root: folder of the release.
        check: `records` checks the names and sizes of all files and the bytes of all files except data and videos,
            which takes well under a second. `bytes` checks all bytes. Neither checks the content: `gym-open dataset
            verify` does.

    Raises:
        ArtefactError: if it is missing, damaged (names the file), not a release, or of another format version.
        MissingExtraError: if the packages that read releases are not installed.
    """
    extras.check("releases")
    if (root / artefacts.LINEAGE).is_file() and artefacts.lineage(root).kind == "compact":
        raise ArtefactError(f"{root}: a compact release; make a release of it first with `gym-open dataset restore`")
    digest = artefacts.verify(root, "release", hashed=lambda name: check == "bytes" or not name.startswith(_BULK))
    for name in artefacts.manifest(root):
        if not belongs(name):
            raise ArtefactError(f"{root / name}: no release of this format has such a file; do not use this release")
    return Release(root, digest, read_info(root))
