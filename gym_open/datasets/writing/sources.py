"""Sources of a new release: episodes that are cut from logs, or read from other releases."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.agents.config import ExplorerConfig
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.splits import Share, Unit, unit_of
from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release, parquet
from gym_open.formats.releases.features import Features, objects, schema
from gym_open.formats.releases.frames import LENGTH_CAP, numbers
from gym_open.formats.releases.layout import IMAGE, PART, SPLITS, Split, data_path
from gym_open.formats.releases.schemas import EPISODE_ROW, content_features

if TYPE_CHECKING:
    import pyarrow as pa

    from gym_open.formats.logs.reader import Log
    from gym_open.formats.logs.schemas import Segment


HELD = "logs"
"""Fact in the lineage of a release: digests of the logs whose steps it holds, in their order."""


class KeyframeAt(NamedTuple):
    """A keyframe: a state of the simulation within an episode."""

    segment_step: int
    frame_index: int
    integration_state: np.ndarray
    """(S,) float64."""


class SourceEpisode(msgspec.Struct, frozen=True, eq=False):
    """An episode for a release: T actions in T + 1 frames."""

    numbers: dict[str, np.ndarray]
    """All features except image and bookkeeping, with T + 1 rows each."""
    row: dict[str, Any]
    """The columns `EPISODE_ROW` of `meta/episodes`."""
    keyframes: list[KeyframeAt]
    images: np.ndarray | None = None
    """(T + 1, 84, 84, 3) uint8 RGB; may be missing if `pngs` is given."""
    pngs: list[bytes] | None = None
    """PNG files that are copied unchanged."""


class SourceStream(NamedTuple):
    """A stream of a log, with its number in the release."""

    log: "Log"
    stream: int
    """Number in the release."""
    parent: int
    """Number of its log artefact, in the order in which they were given."""
    explorer: str


def units_of(config: ReleaseConfig, streams: Iterable[SourceStream]) -> set[Unit]:
    """All visited worlds, or all streams, depending on `config.split_by`."""
    return {
        unit_of(config.split_by, stream.stream, stream.log.puzzles[switch.to_world].digest)
        for stream in streams
        for switch in stream.log.switches
        if switch.to_world >= 0
    }


def shares_of(
    config: ReleaseConfig, streams: Iterable[SourceStream], splits: Mapping[Unit, Split]
) -> dict[Split, Share]:
    """Number of episodes and frames of the streams by split. Only the switches are read for it."""
    shares: dict[Split, Share] = {split: Share() for split in SPLITS}
    for stream in streams:
        for entered, left in zip(stream.log.switches, stream.log.switches[1:], strict=False):
            steps = left.step - entered.step
            pieces = max(1, -(-steps // config.max_episode_steps))
            puzzle = stream.log.puzzles[entered.to_world].digest
            split = splits[unit_of(config.split_by, stream.stream, puzzle)]
            shares[split] = shares[split].plus(pieces, steps + pieces)
    return shares


def streams_of(logs: Sequence[Path], first_stream: int = 0) -> list[SourceStream]:
    """Open all streams of the log artefacts `logs`, numbered from `first_stream`.

    Raises:
        ArtefactError: if one of them is not a log, is damaged, or is not of exploration in the sandbox.
    """
    from gym_open.formats.logs.reader import open_logs

    streams: list[SourceStream] = []
    for parent, artefact in enumerate(logs):
        if (kind := artefacts.lineage(artefact).kind) != "log":
            raise ArtefactError(
                f"{artefact}: expected an artefact of kind 'log', got {kind!r}; give one of `gym-open collect`"
            )
        for log in open_logs(artefact):
            _check_task_free(log)
            streams.append(SourceStream(log, first_stream + len(streams), parent, explorer_of(log.config)))
    return streams


def held_logs(lineage: artefacts.Lineage) -> list[str]:
    """Digests of the logs whose steps a release holds, in the order of its streams.

    It may not hold all logs among its ancestors: a previous version may only have been compared.
    """
    facts = lineage.facts.get(HELD)
    if isinstance(facts, list):
        return [str(digest) for digest in facts]
    return [parent.digest for parent in lineage.parents if parent.lineage.kind == "log"]  # older


def _check_task_free(log: "Log") -> None:
    """Refuse logs of tasks: a log of a person on test puzzles must never train an encoder."""
    if tasks := {puzzle.task for puzzle in log.puzzles} - {"sandbox"}:
        raise ArtefactError(
            f"{log.path}: holds puzzles of {', '.join(sorted(tasks))}; a release holds only the sandbox; leave it out"
        )


def explorer_of(config: Mapping[str, Any]) -> str:
    """Name of the explorer in a log's configuration, such as `icm` or `curl+ride`; `unknown` if it is none of ours."""
    try:
        return msgspec.convert(config["explorer"], ExplorerConfig).name
    except (KeyError, msgspec.ValidationError):
        return "unknown"


def episodes_of_logs(
    config: ReleaseConfig, streams: Iterable[SourceStream], splits: Mapping[Unit, Split], described: Features
) -> Iterator[SourceEpisode]:
    """Read the episodes of all streams in order, one at a time.

    Args:
        config: gives the largest length of an episode.
        streams: from `streams_of`.
        splits: split of every unit.
        described: features of the release.

    Raises:
        ArtefactError: if a log has another model than `described`, or is damaged.
    """
    parts = [name.removeprefix(PART) for name in described if name.startswith(PART)]
    for stream in streams:
        for segment in stream.log.segments(config.max_episode_steps):
            if list(segment.object_names) != objects(described):
                raise ArtefactError(
                    f"{stream.log.path}: segment {segment.index} has the objects {segment.object_names}, the release "
                    f"{objects(described)}; build one release per model"
                )
            split = splits[unit_of(config.split_by, stream.stream, segment.puzzle.digest)]
            row = _row(stream, segment, split, segment.segment_step // config.max_episode_steps)
            keyframes = [
                KeyframeAt(item.segment_step, item.segment_step - segment.segment_step, item.integration_state)
                for item in segment.keyframes
            ]
            yield SourceEpisode(numbers(segment, parts), row, keyframes, images=segment.images)


def _row(stream: SourceStream, segment: "Segment", split: Split, piece: int) -> dict[str, Any]:
    return {
        "stream": stream.stream,
        "explorer": stream.explorer,
        "segment": segment.index,
        "piece": piece,
        "world": segment.world,
        "puzzle": segment.puzzle.digest,
        "first_step": segment.first_step,
        "steps": len(segment.actions),
        "continued": segment.continued or segment.segment_step > 0,
        "ended": segment.ended or LENGTH_CAP,
        "split": split,
    }


def episodes_of_release(release: Release, numbers: Iterable[int]) -> Iterator[SourceEpisode]:
    """Read episodes of a release by their numbers. PNG files are not decoded; video is.

    Args:
        release: an opened release.
        numbers: numbers of the episodes; ascending order is fastest.

    Raises:
        ArtefactError: if frames are not where the release says, or values are missing.
    """
    described = release.info["features"]
    keyframes = release.table("keyframes").groupby("episode_index")
    rows = _FrameReader(release)
    for number in numbers:
        row = release.episodes.iloc[number]
        first, stop = int(row["dataset_from_index"]), int(row["dataset_to_index"])
        table = rows.of_episode(number, (int(row["data/chunk_index"]), int(row["data/file_index"])), first, stop)
        names = [name for name in content_features(described) if name != IMAGE]
        values = {name: _values(table.column(name), described[name]) for name in names}
        if described[IMAGE]["dtype"] == "image":
            pngs, images = table.column(IMAGE).combine_chunks().field("bytes").to_pylist(), None
        else:
            pngs, images = None, release.images(np.arange(first, stop))
        group = keyframes.get_group(number) if number in keyframes.groups else None
        states = [
            KeyframeAt(item["segment_step"], item["frame_index"], item["integration_state"])
            for _, item in (() if group is None else group.iterrows())
        ]
        plain = {name: getattr(row[name], "item", lambda value=row[name]: value)() for name, _ in EPISODE_ROW}
        yield SourceEpisode(values, plain, states, images=images, pngs=pngs)


def _values(column: "pa.ChunkedArray", feature: Mapping[str, Any]) -> np.ndarray:
    array = column.combine_chunks()
    if feature["shape"] == [1]:
        return array.to_numpy(zero_copy_only=False)
    return array.flatten().to_numpy().reshape(-1, *feature["shape"])


class _FrameReader:
    """Reads rows of data files. It keeps the latest row groups, since neighbouring episodes are read together."""

    def __init__(self, release: Release) -> None:
        self._root, self._schema = release.root, schema(release.info["features"])
        self._first: dict[tuple[int, int], int] = {}
        """First frame of each data file."""
        places = ("data/chunk_index", "data/file_index", "dataset_from_index")
        for chunk, file, first in zip(*(release.episodes[name].tolist() for name in places), strict=True):
            self._first.setdefault((chunk, file), first)
        self._starts: tuple[Path, np.ndarray] | None = None
        self._read: tuple[tuple[Path, int, int], pa.Table] | None = None

    def of_episode(self, number: int, file: tuple[int, int], first: int, stop: int) -> "pa.Table":
        """Read frames `first` to `stop` of the release, those of one episode, from the data file with these numbers.

        Raises:
            ArtefactError: if the file does not hold them, or a value is missing.
        """
        path = self._root / data_path(*file)
        starts = self._group_starts(path) + self._first[file]
        low = int(np.searchsorted(starts, first, side="right")) - 1
        key = (path, low, int(np.searchsorted(starts, stop, side="left")))
        if low < 0 or stop <= first:
            raise self._not_there(path, number, first, stop)
        if self._read is None or self._read[0] != key:
            self._read = (key, parquet.read(path, self._schema, groups=range(*key[1:])))
        table = self._read[1].slice(first - int(starts[low]), stop - first)
        if (
            table.column("index").to_pylist() != list(range(first, stop))
            or set(table.column("episode_index").to_pylist()) != {number}
            or any(_missing(column) for column in table.columns)
        ):
            raise self._not_there(path, number, first, stop)
        return table

    @staticmethod
    def _not_there(path: Path, number: int, first: int, stop: int) -> ArtefactError:
        return ArtefactError(
            f"{path}: expected the frames {first} to {stop - 1}, all of episode {number} and whole, as meta/episodes "
            "says; the release is damaged: get it again"
        )

    def _group_starts(self, path: Path) -> np.ndarray:
        """Number, within the file, of the first row of each row group."""
        if self._starts is None or self._starts[0] != path:
            found = parquet.metadata(path)
            rows = [found.row_group(group).num_rows for group in range(found.num_row_groups)]
            self._starts = (path, np.cumsum([0, *rows[:-1]]))
        return self._starts[1]


def _missing(column: "pa.ChunkedArray") -> bool:
    """Whether a required value is null. For images, `path` is always null."""
    values = column.combine_chunks()
    if values.null_count or not values.type.num_fields:
        return values.null_count > 0
    return values.field("bytes").null_count > 0 if hasattr(values, "field") else values.flatten().null_count > 0
