"""Write one split of a batch: its data files one after the other, and the rows for `meta/` about their episodes."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from gym_open.datasets.writing.lerobot_files import TASK, DataFile, frames_batch
from gym_open.datasets.writing.parts import Part
from gym_open.datasets.writing.prepare import Prepared
from gym_open.datasets.writing.sources import KeyframeAt, SourceEpisode
from gym_open.datasets.writing.splits import Share
from gym_open.datasets.writing.statistics import Stats, feature_stats
from gym_open.datasets.writing.video import MAX_FRAMES, VideoFile
from gym_open.errors import ArtefactError
from gym_open.formats.releases.features import Features, fps
from gym_open.formats.releases.layout import IMAGE, MAX_FILES, Split, data_path, video_path
from gym_open.formats.releases.schemas import STATS, content_features, episodes_schema, table_schema

CONTENT = "content/"
"""Prefix of a feature's name in a part, for the column with its digest."""


class SplitPlace(msgspec.Struct, frozen=True):
    """Place of a split of a batch in the release."""

    split: Split
    share: Share
    """Number of its episodes and frames."""
    first: Share
    """Number of episodes and frames before it."""
    chunk: int
    """Number of the folder of its data files."""
    batch: int


class Track:
    """Writes a split. It keeps the data files that were finished before a kill."""

    def __init__(self, folder: Path, place: SplitPlace, described: Features, limit_bytes: int) -> None:
        self.added = 0
        """Number of episodes added in this run."""
        self.parts: list[Part] = []
        """One part per finished data file."""
        self.files: list[str] = []
        """Names of the finished files."""
        self._folder, self._place, self._described, self._limit = folder, place, described, limit_bytes
        self._written = Share()
        self._file: DataFile | None = None
        self._video: VideoFile | None = None
        self._part = self._next_part()
        while mark := self._part.mark():
            self.parts.append(self._part)
            self.files += mark.files
            self._written = self._written.plus(mark.episodes, mark.frames)
            self._part = self._next_part()
        self._done = self._written
        self.kept = self._written.episodes
        """Number of episodes in finished files, which are not written again."""

    def write(self, made: Prepared) -> None:
        """Write the next episode."""
        number, start = self._place.first.plus(*self._written)
        index = start + np.arange(made.frames)
        numbering = {"index": index, "episode_index": np.full_like(index, number), "task_index": np.zeros_like(index)}
        batch = frames_batch(self._described, {**made.episode.numbers, **numbering}, made.pngs)
        if self._is_full(batch.nbytes, made.frames):
            self._finish_file()
        if self._file is None:
            self._begin_file(has_video=made.clip is not None)
        assert self._file is not None
        self._file.add(batch)
        row = self._episode_row(made, number, start)
        if self._video and made.clip:
            self._video.add(made.clip)
        for name, values in numbering.items():
            row |= _stats_row(name, feature_stats(values))
        self._part.add("episodes", [row])
        self._part.add("keyframes", [_keyframe_row(made.episode, number, state) for state in made.episode.keyframes])
        self._written = self._written.plus(1, made.frames)

    def _is_full(self, n_bytes: int, frames: int) -> bool:
        if self._file is None:
            return False
        too_long = self._video is not None and self._video.frames + frames > MAX_FRAMES
        return too_long or self._file.bytes + n_bytes > self._limit

    def close(self) -> None:
        """Finish the last file.

        Raises:
            ArtefactError: if the number of episodes or frames is not the announced one.
        """
        if self._file:
            self._finish_file()
        if self._written != self._place.share:
            raise ArtefactError(
                f"split {self._place.split}: {self._written.episodes} episodes of {self._written.frames} frames, "
                f"expected {self._place.share.episodes} of {self._place.share.frames}: the log's switches do not fit "
                "its steps; check it with `gym-open log info`"
            )

    def _episode_row(self, made: Prepared, number: int, start: int) -> dict[str, Any]:
        described: dict[str, Any] = {}
        for name, stats in made.stats.items():
            described |= _stats_row(name, stats)
        if self._video:
            described |= {
                f"videos/{IMAGE}/chunk_index": self._place.chunk,
                f"videos/{IMAGE}/file_index": len(self.parts),
                f"videos/{IMAGE}/from_timestamp": self._video.frames / fps(),
                f"videos/{IMAGE}/to_timestamp": (self._video.frames + made.frames) / fps(),
            }
        return {
            "episode_index": number,
            "tasks": [TASK],
            "length": made.frames,
            "dataset_from_index": start,
            "dataset_to_index": start + made.frames,
            "data/chunk_index": self._place.chunk,
            "data/file_index": len(self.parts),
            **made.episode.row,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": self._place.batch,
            **described,
            **made.measured,
            **{CONTENT + name: digest for name, digest in made.content.items()},
        }

    def _next_part(self) -> Part:
        return Part(self._folder, f"{self._place.split}-{len(self.parts):03d}")

    def _begin_file(self, *, has_video: bool) -> None:
        if len(self.parts) == MAX_FILES:
            raise ArtefactError(
                f"split {self._place.split}: more than {MAX_FILES} data files; give a larger data_file_mb than "
                f"{self._limit // 2**20}"
            )
        self._file = DataFile(self._folder / data_path(self._place.chunk, len(self.parts)), self._described)
        self._video = VideoFile(self._folder / video_path(self._place.chunk, len(self.parts))) if has_video else None
        digests = [pa.field(CONTENT + name, pa.string()) for name in content_features(self._described)]
        rows = pa.schema([*episodes_schema(self._described), *digests])
        self._part.begin({"episodes": rows, "keyframes": table_schema("keyframes", self._described)})

    def _finish_file(self) -> None:
        assert self._file is not None
        self._file.close()
        files = [data_path(self._place.chunk, len(self.parts))]
        if self._video:
            self._video.close()
            files.append(video_path(self._place.chunk, len(self.parts)))
        before = self._done
        self._part.finish(self._written.episodes - before.episodes, self._written.frames - before.frames, files)
        self.parts.append(self._part)
        self.files += files
        self._done, self._file, self._video, self._part = self._written, None, None, self._next_part()


def _stats_row(feature: str, stats: Stats) -> dict[str, Any]:
    return {f"{STATS}{feature}/{name}": value for name, value in stats.plain().items()}


def _keyframe_row(episode: SourceEpisode, number: int, state: KeyframeAt) -> dict[str, Any]:
    places = {"stream": episode.row["stream"], "segment": episode.row["segment"], "episode_index": number}
    return {**places, **state._asdict()}
