"""Releases that are made from episodes of other releases: shared parts of `merge` and `filter`.

PNG files and numbers are copied unchanged. Streams and logs get new numbers, in their order. The rows of our tables
follow the streams that are kept.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from gym_open import artefacts, progress
from gym_open.datasets.compare.versions import latest_below
from gym_open.datasets.config import FilterConfig, MergeConfig
from gym_open.datasets.writing.sources import HELD, SourceEpisode, episodes_of_release, held_logs
from gym_open.datasets.writing.splits import Share, unit_of
from gym_open.datasets.writing.writer import ReleaseWriter, check_workers, complete
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.layout import PART, SPLITS, Split, Table

if TYPE_CHECKING:
    import pandas as pd


class KeptEpisodes(msgspec.Struct, frozen=True, eq=False):
    """The part of a release that goes into another release."""

    release: Release
    numbers: np.ndarray
    """Numbers of the episodes, ascending."""
    streams: Mapping[int, int]
    """New number of each kept stream."""
    logs: Mapping[int, int]
    """New number of the log of each stream, by the old number of the stream."""
    splits: Mapping[str, Split]
    """Split of each layout in the new release. Empty if splits go by stream, because those do not change."""
    lacking: Sequence[str]
    """Parts of the reward that only the other releases have."""
    left_out: Collection[str]
    """Features that the new release does not have."""
    held: Sequence[str]
    """Digests of the logs of the kept streams."""

    @property
    def rows(self) -> "pd.DataFrame":
        """Rows of `meta/episodes`, with the new splits."""
        rows = self.release.episodes.iloc[self.numbers]
        return rows.assign(split=rows["puzzle"].map(self.splits)) if self.splits else rows

    @property
    def shares(self) -> dict[Split, Share]:
        """Number of episodes and frames by split."""
        groups = self.rows.groupby("split")["length"]
        return {split: Share(int(groups.count().get(split, 0)), int(groups.sum().get(split, 0))) for split in SPLITS}

    def episodes(self) -> Iterator[SourceEpisode]:
        """The episodes, with their new numbers and splits."""
        for episode in episodes_of_release(self.release, self.numbers.tolist()):
            row = {**episode.row, "stream": self.streams[episode.row["stream"]]}
            row["split"] = self.splits.get(row["puzzle"], row["split"])
            nothing = np.full(len(episode.numbers["timestamp"]), np.nan, dtype=np.float32)
            numbers = {**episode.numbers, **dict.fromkeys(self.lacking, nothing)}
            kept = {name: values for name, values in numbers.items() if name not in self.left_out}
            yield msgspec.structs.replace(episode, row=row, numbers=kept)

    def table(self, name: Table) -> pa.Table:
        """Rows of `streams`, `worlds` or `switches` for the kept streams."""
        table = self.release.arrow_table(name)
        if name == "switches" and "world_model.loss" in self.left_out:
            table = table.drop_columns("world_losses")
        old = table["stream"].to_numpy()
        table = table.filter(pa.array(np.isin(old, list(self.streams))))
        old = table["stream"].to_pylist()
        columns: dict[str, list[Any]] = {"stream": [self.streams[stream] for stream in old]}
        if name == "streams":
            columns["log"] = [self.logs[stream] for stream in old]
        if name == "worlds" and self.splits:
            known = zip(table["puzzle"].to_pylist(), table["split"].to_pylist(), strict=True)
            columns["split"] = [split and self.splits.get(puzzle, split) for puzzle, split in known]
        for column, values in columns.items():
            place = table.schema.get_field_index(column)
            table = table.set_column(place, table.schema.field(place), pa.array(values, table.schema.field(place).type))
        return table


def derive(
    config: MergeConfig | FilterConfig, command: Literal["merge", "filter"], out: Path,
    chosen: Sequence[tuple[Release, np.ndarray]], *, left_out: Collection[str] = (), workers: int | None, replace: bool,
) -> artefacts.Outcome:  # fmt: skip
    """Make the release `out` from chosen episodes (numbers, ascending) of releases with the same model and rules.

    It has all features of the releases, except those in `left_out`.

    Raises:
        ArtefactError: if a release is damaged, or the version does not follow from what changed since the previous one.
        UsageError: if `out` was made from other inputs and `replace` is false.
    """
    check_workers(workers)
    releases = [release for release, _ in chosen]
    previous = latest_below(out, config.version)
    parents = [*(release.root for release in releases), *([previous] if previous else [])]

    def work(folder: Path) -> Mapping[str, Any]:
        sources = _kept(chosen, left_out)
        facts = _write(config, sources, folder, workers)
        complete(folder, config, command, open_release(previous) if previous else None, parents)
        return {**facts, HELD: [digest for source in sources for digest in source.held]}

    return artefacts.build(out, kind="release", config=config, parents=parents, work=work, replace=replace)


def _kept(chosen: Sequence[tuple[Release, np.ndarray]], left_out: Collection[str]) -> list[KeptEpisodes]:
    """Number streams and logs across all releases. A layout that is in val in one release is in val in the result."""
    splits: dict[str, Split] = {}
    if chosen[0][0].info["gym_open"]["split_by"] == "world":
        for release, _ in chosen:
            for puzzle, split in release.episodes[["puzzle", "split"]].drop_duplicates().itertuples(index=False):
                splits[puzzle] = "val" if "val" in {split, splits.get(puzzle)} else "train"
    parts = {name for release, _ in chosen for name in release.info["features"] if name.startswith(PART)}
    found: list[KeptEpisodes] = []
    streams, logs = 0, 0
    for release, numbers in chosen:
        rows = release.table("streams")
        gone = set(release.episodes["stream"]) - set(release.episodes["stream"].iloc[numbers])
        batches = dict(zip(release.episodes["stream"], release.episodes["meta/episodes/file_index"], strict=True))
        every = {row["stream"]: (batches.get(row["stream"], 0), row["log"]) for row in rows.to_dict("records")}
        kept = {stream: place for stream, place in every.items() if stream not in gone}
        order = {place: logs + i for i, place in enumerate(dict.fromkeys(kept.values()))}
        found.append(
            KeptEpisodes(
                release=release,
                numbers=numbers,
                streams={stream: streams + i for i, stream in enumerate(kept)},
                logs={stream: order[place] for stream, place in kept.items()},
                splits=splits,
                lacking=sorted(parts - set(release.info["features"])),
                left_out=left_out,
                held=_held(release, list(dict.fromkeys(every.values())), set(order)),
            )
        )
        streams, logs = streams + len(kept), logs + len(order)
    return found


def _held(release: Release, places: Sequence[tuple[int, int]], kept: set[tuple[int, int]]) -> list[str]:
    """Digests of the logs at the kept places (batch, log), or of all logs if the places do not fit the digests."""
    digests = held_logs(artefacts.lineage(release.root))
    if len(digests) != len(places):
        return digests
    return [digest for digest, place in zip(digests, places, strict=True) if place in kept]


def _write(
    config: MergeConfig | FilterConfig, sources: Sequence[KeptEpisodes], folder: Path, workers: int | None
) -> dict[str, Any]:
    """Write `data` and `meta` and return the facts."""
    info = sources[0].release.info
    every = {name: feature for source in sources for name, feature in source.release.info["features"].items()}
    described = {name: feature for name, feature in every.items() if name not in sources[0].left_out}
    split_by = info["gym_open"]["split_by"]
    shares: dict[Split, Share] = {split: Share() for split in SPLITS}
    val: set[str] = set()
    for source in sources:
        shares = {split: shares[split].plus(*source.shares[split]) for split in SPLITS}
        held = source.rows.query("split == 'val'")[["stream", "puzzle"]].drop_duplicates()
        val |= {unit_of(split_by, source.streams[stream], puzzle) for stream, puzzle in held.itertuples(index=False)}
    ours = {name: info["gym_open"][name] for name in ("split_by", "max_episode_steps", "pictures")}
    with (
        ReleaseWriter(
            folder, config, described, shares,
            ours={**ours, "val": sorted(val)}, data_file_mb=config.data_file_mb, workers=workers,
        ) as writer,
        progress.bar("dataset", sum(int(source.rows["steps"].sum()) for source in sources)) as bar,
    ):  # fmt: skip
        for source in sources:
            if writer.skip(source.shares):
                bar.advance(int(source.rows["steps"].sum()))
                continue
            for episode in source.episodes():
                writer.add(episode)
                bar.advance(episode.row["steps"])
        names: tuple[Table, ...] = ("streams", "worlds", "switches")
        return writer.close({name: pa.concat_tables(source.table(name) for source in sources) for name in names})
