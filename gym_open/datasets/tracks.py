"""One split of a batch: its data files one after the other, and what `meta/` will say of their episodes."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from gym_open.datasets.lerobot_files import TASK, DataFile, frames_batch
from gym_open.datasets.parts import Part
from gym_open.datasets.sources import Episode, KeyframeAt, Share
from gym_open.datasets.statistics import Stats, feature_stats, picture_stats
from gym_open.errors import ArtefactError
from gym_open.formats.pictures import decode_png, encode_pngs
from gym_open.formats.releases.content import feature_digest
from gym_open.formats.releases.features import Features
from gym_open.formats.releases.layout import IMAGE, MAX_FILES, Split, data_path
from gym_open.formats.releases.schemas import STATS, content_features, episodes_schema, table_schema

CONTENT = "content/"
"""What stands before a feature's name where its digest waits in a part."""


class Prepared(msgspec.Struct, frozen=True, eq=False):
    """What threads make of an episode."""

    episode: Episode
    """Without pictures."""
    pngs: list[bytes]
    stats: dict[str, Stats]
    content: dict[str, str]


def prepare(episode: Episode) -> Prepared:
    """Code, hash and count an episode."""
    pngs, images = episode.pngs, episode.images
    if images is None:
        assert pngs is not None
        images = np.stack([decode_png(data) for data in pngs])
    stats = {name: feature_stats(values) for name, values in episode.numbers.items()}
    content = {name: feature_digest(values) for name, values in episode.numbers.items()}
    return Prepared(
        episode=msgspec.structs.replace(episode, images=None, pngs=None),
        pngs=encode_pngs(images) if pngs is None else pngs,
        stats={**stats, IMAGE: picture_stats(images)},
        content={**content, IMAGE: feature_digest(images)},
    )


class Place(msgspec.Struct, frozen=True):
    """Where a split of a batch stands in the release."""

    split: Split
    share: Share
    """What it will hold."""
    first: Share
    """What comes before it."""
    chunk: int
    """Folder of its data files."""
    batch: int


class Track:
    """Writes a split. Data files that were finished before a kill are found, and kept."""

    def __init__(self, folder: Path, place: Place, described: Features, limit_bytes: int) -> None:
        self.added = 0
        """Episodes that came, in this run."""
        self.parts: list[Part] = []
        """One for each data file that is done."""
        self.files: list[str] = []
        """Names of these."""
        self._folder, self._place, self._described, self._limit = folder, place, described, limit_bytes
        self._written = Share()
        self._file: DataFile | None = None
        self._part = self._next_part()
        while mark := self._part.mark():
            self.parts.append(self._part)
            self.files += mark.files
            self._written = self._written.plus(mark.episodes, mark.frames)
            self._part = self._next_part()
        self._done = self._written
        self.kept = self._written.episodes
        """Episodes that need not be written again."""

    def write(self, made: Prepared) -> None:
        """Write the next episode."""
        number, start = self._place.first.plus(*self._written)
        frames = len(made.pngs)
        rows = np.arange(frames)
        numbering = {"index": start + rows, "episode_index": np.full(frames, number), "task_index": np.zeros_like(rows)}
        batch = frames_batch(self._described, {**made.episode.numbers, **numbering}, made.pngs)
        if self._file and self._file.bytes + batch.nbytes > self._limit:
            self._finish_file()
        if self._file is None:
            self._begin_file()
        assert self._file is not None
        self._file.add(batch)
        stats = {**made.stats, **{name: feature_stats(values) for name, values in numbering.items()}}
        self._part.add("episodes", [self._episode_row(made, number, start, stats)])
        self._part.add("keyframes", [_keyframe_row(made.episode, number, state) for state in made.episode.keyframes])
        self._written = self._written.plus(1, frames)

    def close(self) -> None:
        """Finish the last file.

        Raises:
            ArtefactError: if other episodes came than were promised.
        """
        if self._file:
            self._finish_file()
        if self._written != self._place.share:
            raise ArtefactError(
                f"split {self._place.split}: {self._written.episodes} episodes of {self._written.frames} frames came, "
                f"expected {self._place.share.episodes} of {self._place.share.frames}: the log's switches do not fit "
                "its steps; see it with `gym-open log info`"
            )

    def _episode_row(self, made: Prepared, number: int, start: int, stats: dict[str, Stats]) -> dict[str, Any]:
        described = {f"{STATS}{name}/{key}": value for name in stats for key, value in stats[name].plain().items()}
        return {
            "episode_index": number,
            "tasks": [TASK],
            "length": len(made.pngs),
            "dataset_from_index": start,
            "dataset_to_index": start + len(made.pngs),
            "data/chunk_index": self._place.chunk,
            "data/file_index": len(self.parts),
            **made.episode.row,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": self._place.batch,
            **described,
            **{CONTENT + name: digest for name, digest in made.content.items()},
        }

    def _next_part(self) -> Part:
        return Part(self._folder, f"{self._place.split}-{len(self.parts):03d}")

    def _begin_file(self) -> None:
        if len(self.parts) == MAX_FILES:
            raise ArtefactError(
                f"split {self._place.split}: more than {MAX_FILES} data files; give a larger data_file_mb than "
                f"{self._limit // 2**20}"
            )
        self._file = DataFile(self._folder / data_path(self._place.chunk, len(self.parts)), self._described)
        digests = [pa.field(CONTENT + name, pa.string()) for name in content_features(self._described)]
        rows = pa.schema([*episodes_schema(self._described), *digests])
        self._part.begin({"episodes": rows, "keyframes": table_schema("keyframes", self._described)})

    def _finish_file(self) -> None:
        assert self._file is not None
        self._file.close()
        files = [data_path(self._place.chunk, len(self.parts))]
        before = self._done
        self._part.finish(self._written.episodes - before.episodes, self._written.frames - before.frames, files)
        self.parts.append(self._part)
        self.files += files
        self._done, self._file, self._part = self._written, None, self._next_part()


def _keyframe_row(episode: Episode, number: int, state: KeyframeAt) -> dict[str, Any]:
    places = {"stream": episode.row["stream"], "segment": episode.row["segment"], "episode_index": number}
    return {**places, **state._asdict()}
