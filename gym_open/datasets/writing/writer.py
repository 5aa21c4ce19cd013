"""Write episodes as the files of a release.

Threads prepare a few episodes at a time (encode images, compute digests and statistics). Episodes are written in the
order in which they were added, so that the number of threads changes no byte. A full data file is final: a later writer
in the same unfinished folder does not write its episodes again.
"""

import shutil
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from gym_open.artefacts import SCRATCH
from gym_open.datasets.compare.diff import check_version
from gym_open.datasets.config import Header
from gym_open.datasets.documents import Command, write_changelog, write_documents, write_provenance
from gym_open.datasets.writing.lerobot_files import write_table
from gym_open.datasets.writing.meta import write_meta
from gym_open.datasets.writing.parts import join
from gym_open.datasets.writing.prepare import Prepared, prepare
from gym_open.datasets.writing.sources import SourceEpisode
from gym_open.datasets.writing.splits import Share
from gym_open.datasets.writing.tracks import CONTENT, SplitPlace, Track
from gym_open.datasets.writing.video import EXACT, Coding
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.releases import Release
from gym_open.formats.releases.features import Features
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import (
    DATA_PATHS,
    EPISODES_PATHS,
    IMAGE,
    SPLITS,
    TABLES,
    VIDEO_PATHS,
    Split,
    Table,
    episodes_path,
    table_path,
)
from gym_open.formats.releases.schemas import EPISODE_ROW, episodes_schema, table_schema
from gym_open.formats.releases.segments import segments_of_episodes
from gym_open.hardware import usable_cores


class ReleaseWriter:
    """Writes one batch of episodes, and the records of the release with all batches.

    with ReleaseWriter(folder, header, described, shares, ours=…, data_file_mb=100) as writer:
        for episode in episodes:
            writer.add(episode)
        facts = writer.close(tables)
    """

    def __init__(
        self, folder: Path, header: Header, described: Features, shares: Mapping[Split, Share], *,
        ours: Mapping[str, Any], data_file_mb: int, after: Release | None = None, workers: int | None = None,
        check: Callable[[Prepared], None] | None = None, coding: Coding = EXACT,
    ) -> None:  # fmt: skip
        """Begin, or continue from an earlier writer like this one. All other files in `folder` are removed.

        Args:
            folder: folder of the unfinished artefact.
            header: name, version, licence, date of the release.
            described: its features, from `features.features`.
            shares: number of episodes and frames that each split will get, by which frames are numbered.
            ours: `split_by`, `val`, `max_episode_steps` and `pictures`, for `info.json`.
            data_file_mb: size in memory, in MiB, at which a new data file begins.
            after: release with the same features whose files come before this batch, copied byte for byte.
            workers: number of threads; by default one per processor.
            coding: how images become video, if they do.
            check: called with every prepared episode, in its thread; what it raises ends the writing.
        """
        self._check = check
        self._folder, self._header, self._described, self._ours = folder, header, described, ours
        self._mb, self._after = data_file_mb, after
        self._batch = after.info["gym_open"]["batches"] if after else 0
        first = Share(after.info["total_episodes"], after.info["total_frames"]) if after else Share()
        chunk = int(after.episodes["data/chunk_index"].max()) + 1 if after else 0
        self._tracks: dict[Split, Track] = {}
        for split in SPLITS:
            share = shares.get(split, Share())
            if share.episodes:
                place = SplitPlace(split, share, first, chunk, self._batch)
                self._tracks[split] = Track(folder, place, described, data_file_mb * 2**20)
                first, chunk = first.plus(*share), chunk + 1
        self._video = coding if described[IMAGE]["dtype"] == "video" else None
        self._tidy()
        threads = workers or usable_cores()
        self._pool = ThreadPoolExecutor(threads)
        self._ahead = threads + 1
        self._waiting: deque[Future[Prepared | None]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def skip(self, shares: Mapping[Split, Share]) -> bool:
        """Skip the next episodes, as many per split, if all were written before a kill. Return whether it did."""
        tracks = [(self._tracks[split], share) for split, share in shares.items() if share.episodes]
        if any(track.kept < track.added + share.episodes for track, share in tracks):
            return False
        for track, share in tracks:
            track.added += share.episodes
        return True

    def add(self, episode: SourceEpisode) -> None:
        """Add the next episode of its split."""
        self.add_later(episode.row["split"], lambda _: episode)

    def add_later(self, split: Split, make: Callable[[bool], SourceEpisode | None]) -> None:
        """Add the next episode of a split, which a thread makes: `make(True)`.

        If the episode was written before a kill, the thread calls `make(False)`, and its result is not used.
        """
        track = self._tracks[split]
        track.added += 1
        self._waiting.append(self._pool.submit(self._prepared, make, track.added > track.kept))
        while len(self._waiting) > self._ahead:
            self._write_next()

    def _prepared(self, make: Callable[[bool], SourceEpisode | None], wanted: bool) -> Prepared | None:
        episode = make(wanted)
        if not wanted or episode is None:
            return None
        made = prepare(episode, video=self._video)
        if self._check:
            self._check(made)
        return made

    def close(self, tables: Mapping[Table, pa.Table]) -> dict[str, Any]:
        """Finish the data files, then write everything under `meta/`.

        Args:
            tables: `streams`, `worlds` and `switches` of this batch. The other tables follow from its episodes.

        Returns:
            Facts: frames, episodes, steps, and the content digest of the release.

        Raises:
            ArtefactError: if the numbers of episodes and frames are not the announced ones, or are 0.
        """
        while self._waiting:
            self._write_next()
        for track in self._tracks.values():
            track.close()
        if not self._tracks:
            raise ArtefactError(f"{self._header.name}: no episode for a release; collect some steps first")
        self._take_over()
        self._join_parts()
        for name, table in tables.items():
            write_table(table, self._folder / table_path(name, self._batch))
        rows = pq.read_table(self._folder / episodes_path(self._batch), columns=[name for name, _ in EPISODE_ROW])
        write_table(segments_of_episodes(rows.to_pandas()), self._folder / table_path("segments", self._batch))
        return write_meta(self._folder, self._described, self._header, self._ours, self._mb)

    def _write_next(self) -> None:
        made = self._waiting.popleft().result()
        if made is not None:
            self._tracks[made.episode.row["split"]].write(made)

    def _tidy(self) -> None:
        """Remove files of an interrupted writer from which nothing can continue."""
        kept = {name for track in self._tracks.values() for name in track.files}
        for path in sorted(self._folder.rglob("*"), reverse=True):
            name = path.relative_to(self._folder).as_posix()
            if name.split("/")[0] == SCRATCH or name in kept:
                continue
            if not path.is_dir():
                path.unlink()
            elif not any(path.iterdir()):
                path.rmdir()

    def _take_over(self) -> None:
        if self._after is None:
            return
        patterns = (DATA_PATHS, VIDEO_PATHS, EPISODES_PATHS, *(f"meta/{name}/file-*.parquet" for name in TABLES))
        for path in chain.from_iterable(self._after.root.glob(pattern) for pattern in patterns):
            target = self._folder / path.relative_to(self._after.root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)

    def _join_parts(self) -> None:
        parts = [part for track in self._tracks.values() for part in track.parts]
        of_content = table_schema("content", self._described)
        for name, out, columns in (
            ("episodes", episodes_path(self._batch), episodes_schema(self._described)),
            ("episodes", table_path("content", self._batch), of_content),
            ("keyframes", table_path("keyframes", self._batch), table_schema("keyframes", self._described)),
        ):
            join([part.path(name) for part in parts], self._folder / out, columns, prefix=CONTENT)


def check_workers(workers: int | None) -> None:
    """Raise UsageError if the number of threads is below 1."""
    if workers is not None and workers < 1:
        raise UsageError(f"workers: expected 1 or more, got {workers}; leave it out for one per processor")


def complete(folder: Path, config: Header, command: Command, previous: Release | None, parents: Sequence[Path]) -> None:
    """Write the documents of a release next to the data and tables in `folder`, and check its version.

    Args:
        folder: folder of the unfinished artefact, after `ReleaseWriter.close`.
        config: everything that determines the release.
        command: the command that makes it.
        previous: the previous version, if there is one.
        parents: artefacts from which it is made, `previous` last.

    Raises:
        ArtefactError: if the version does not follow from what changed since `previous`.
    """
    release = Release(folder, "", read_info(folder))
    write_documents(release, config, command=command, previous=previous, parents=parents)
    write_changelog(release, config, previous, check_version(previous, release) if previous else None)
    write_provenance(folder, config, parents, command)
