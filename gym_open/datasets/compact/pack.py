"""Pack a release as its actions: `pack_release(release, out)`."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.artefacts import canonical_json
from gym_open.config import Config
from gym_open.datasets.compact.check import check_frames
from gym_open.datasets.compact.documents import compact_card
from gym_open.datasets.compare import payload
from gym_open.errors import ArtefactError
from gym_open.formats.compact import Compact
from gym_open.formats.compact.before import visits_before
from gym_open.formats.compact.files import NumberWriter, write_rows
from gym_open.formats.compact.layout import (
    ACTIONS,
    CARD,
    EPISODES,
    FORMAT,
    INFO,
    LOSSES,
    RELEASE,
    STATES,
    STREAMS,
    SWITCHES,
    WORLDS,
    CompactInfo,
    EpisodeRow,
    Start,
    StateRow,
    StreamRow,
    SwitchRow,
    WorldPlace,
    WorldRow,
    column_path,
)
from gym_open.formats.releases import Release, open_release, parquet
from gym_open.formats.releases.content import episode_digest, payload_digest
from gym_open.formats.releases.features import learned
from gym_open.formats.releases.frames import LENGTH_CAP
from gym_open.formats.releases.layout import TABLES
from gym_open.formats.releases.schemas import EPISODE_ROW, content_features, table_schema

_REMADE = ("data/", "videos/", "meta/episodes/", *(f"meta/{name}/" for name in TABLES))
"""Folders of a release that `restore` makes again; all else is stored byte for byte."""


class PackConfig(Config, frozen=True):
    """Configuration of a compact release: the release determines all of it."""

    format: str = FORMAT


def pack_release(release: Path, out: Path, *, workers: int | None = None, replace: bool = False) -> artefacts.Outcome:
    """Pack the release at `release` as the compact release `out`, and simulate it to check every frame.

    Args:
        release: folder of a release. Every byte of it is checked.
        out: folder of the compact release.
        workers: number of threads; by default one per core.
        replace: set aside an artefact of other inputs at `out`; otherwise refuse.

    Raises:
        ArtefactError: if the release is damaged, or its frames do not follow from its actions, or some of its episodes
            begin in a state that nothing in the release leads to.
        UsageError: if `out` was made from other inputs and `replace` is false.
    """

    def work(folder: Path) -> Mapping[str, Any]:
        opened = open_release(release)
        for path in [*folder.iterdir()]:
            if path.name != artefacts.SCRATCH:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        info = _write(opened, folder)
        compact = Compact(folder, "", info)
        check_frames(compact, workers)
        (folder / CARD).write_text(compact_card(compact), encoding="utf-8")
        return {"steps": info.steps, "episodes": info.episodes, "content": info.content, "release": info.release}

    return artefacts.build(out, kind="compact", config=PackConfig(), parents=[release], work=work, replace=replace)


def _write(release: Release, folder: Path) -> CompactInfo:
    """Write all files of the compact release except its card."""
    for name in [*artefacts.manifest(release.root), artefacts.MANIFEST, artefacts.SIGNATURE]:
        if not name.startswith(_REMADE) and (release.root / name).exists():
            target = folder / RELEASE / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(release.root / name, target)
    streams = list(_streams(release))
    write_rows(folder / STREAMS, streams)
    write_rows(folder / WORLDS, _worlds(release))
    _write_switches(release, folder)
    rows, states = _episodes(release, streams)
    write_rows(folder / EPISODES, [row for _, row in rows])
    if states:
        write_rows(folder / STATES, [StateRow(values) for values in states])
    columns = learned(release.info["features"])
    _write_steps(release, folder, rows, columns)
    info = CompactInfo(
        format=FORMAT,
        name=release.name,
        version=release.version,
        release=release.digest,
        payload=payload_digest(artefacts.manifest(release.root)),
        content=payload.digests(release.root).release,
        episodes=len(rows),
        steps=sum(row.steps for _, row in rows),
        columns=columns,
    )
    (folder / INFO).write_bytes(canonical_json(info))
    return info


def _streams(release: Release) -> Iterator[StreamRow]:
    schema = table_schema("streams", release.info["features"])
    for batch, path in enumerate(sorted(release.root.glob("meta/streams/file-*.parquet"))):
        for row in parquet.read(path, schema).to_pylist():
            yield StreamRow(batch=batch, **row)


def _worlds(release: Release) -> list[WorldRow]:
    """The distinct layouts, each with its places, in the order of their first places."""
    found: dict[str, list[WorldPlace]] = {}
    for row in release.arrow_table("worlds").to_pylist():
        found.setdefault(row["json"], []).append(WorldPlace(row["stream"], row["world"], row["split"]))
    return [WorldRow(text, places) for text, places in found.items()]


def _write_switches(release: Release, folder: Path) -> None:
    rows = release.arrow_table("switches").to_pylist()
    losses = [row.pop("world_losses", ()) for row in rows]
    switches = [SwitchRow(**row, losses=len(own)) for row, own in zip(rows, losses, strict=True)]
    write_rows(folder / SWITCHES, switches)
    if "world_model.loss" in release.info["features"]:
        with NumberWriter(folder / LOSSES, np.float64) as file:
            for own in losses:
                file.add(np.array(own, np.float64))


def _episodes(
    release: Release, streams: Sequence[StreamRow]
) -> tuple[list[tuple[dict[str, Any], EpisodeRow]], list[list[float]]]:
    """Rows of all episodes in the order in which they were played, and the states with which some of them begin."""
    frames = release.arrow_table("keyframes").select(["episode_index", "frame_index"]).to_pandas()
    keyframes = frames.groupby("episode_index")["frame_index"].apply(list).to_dict()
    contents = release.arrow_table("content").to_pylist()
    features = content_features(release.info["features"])
    played = sorted(
        ({str(name): value for name, value in row.items()} for row in release.episodes.to_dict("records")),
        key=lambda row: (row["meta/episodes/file_index"], row["stream"], row["first_step"], row["piece"]),
    )
    batches = {row.stream: row.batch for row in streams}
    starts = _Starts(release, streams, {number for number, own in keyframes.items() if own[0] == 0})
    found: list[tuple[dict[str, Any], EpisodeRow]] = []
    for row in played:
        number = row["episode_index"]
        stored = EpisodeRow(
            **{name: row[name] for name, _ in EPISODE_ROW if name not in {"puzzle", "explorer"}},
            batch=batches[row["stream"]],
            start=starts.of(row),
            keyframes=keyframes.get(number, []),
            digest=episode_digest({name: contents[number][name] for name in features}, row),
        )
        found.append((row, stored))
    return found, starts.states()


class _Starts:
    """Finds out how episodes begin."""

    def __init__(self, release: Release, streams: Sequence[StreamRow], kept: set[int]) -> None:
        self._release, self._kept = release, kept
        """Numbers of the episodes whose first state is in the release."""
        rows = release.episodes
        places = zip(rows["stream"], rows["segment"], rows["piece"], rows["ended"], strict=True)
        self._ended = {(stream, segment, piece): ended for stream, segment, piece, ended in places}
        table = release.arrow_table("switches").select(["stream", "step", "from_world", "to_world"])
        whole = _whole_logs(streams)
        of_whole = [(row.stream, (row.batch, row.log), row.log_stream) for row in streams if row.stream in whole]
        switches = zip(*(column.to_pylist() for column in table.columns), strict=True)
        self._left = visits_before(of_whole, list(switches))
        self._ends = {place[:2]: ended for place, ended in sorted(self._ended.items())}
        """How the last piece of each segment in the release ended."""
        self._stored: list[int] = []

    def of(self, row: Mapping[str, Any]) -> Start:
        """How an episode begins; to be called in the order in which they are stored.

        Raises:
            ArtefactError: if nothing in the release leads to its first state.
        """
        found = self._of(row)
        if found == "state":
            if row["episode_index"] not in self._kept:
                raise ArtefactError(
                    f"{self._release.root}: episode {row['episode_index']} begins in a state that the release does not "
                    "have, and the episodes before it were filtered out; pack the release that it was made from"
                )
            self._stored.append(row["episode_index"])
        return found

    def _of(self, row: Mapping[str, Any]) -> Start:
        stream, segment, piece = row["stream"], row["segment"], row["piece"]
        if piece:
            return "episode" if (stream, segment, piece - 1) in self._ended else "state"
        if not row["continued"]:
            return "layout"
        ended = self._ends.get(self._left.get((stream, segment), (-1, -1)), LENGTH_CAP)
        return "state" if ended == LENGTH_CAP else "world"

    def states(self) -> list[list[float]]:
        """The states of the episodes that begin with one, in their order."""
        table = self._release.arrow_table("keyframes")
        places = zip(table["episode_index"].to_pylist(), table["frame_index"].to_pylist(), strict=True)
        rows = {episode: i for i, (episode, frame) in enumerate(places) if frame == 0}
        return [table["integration_state"][rows[number]].as_py() for number in self._stored]


def _whole_logs(streams: Sequence[StreamRow]) -> set[int]:
    """The streams of logs of which the release has all streams: in others, who left a world may be missing."""
    logs: dict[tuple[int, int], list[StreamRow]] = {}
    for row in streams:
        logs.setdefault((row.batch, row.log), []).append(row)
    return {
        row.stream
        for rows in logs.values()
        for row in rows
        if len(rows) == msgspec.json.decode(row.config, type=dict[str, Any]).get("streams", len(rows))
        and [one.log_stream for one in rows] == list(range(len(rows)))
    }


def _write_steps(
    release: Release, folder: Path, rows: Sequence[tuple[dict[str, Any], EpisodeRow]], columns: Sequence[str]
) -> None:
    """Write what is stored of every step."""
    with ExitStack() as files, progress.bar("packing", len(rows)) as bar:
        actions = files.enter_context(NumberWriter(folder / ACTIONS, np.uint8))
        learned_files = {
            name: files.enter_context(NumberWriter(folder / column_path(name), np.float32)) for name in columns
        }
        for row, _ in rows:
            values = release.numbers(row["dataset_from_index"], row["dataset_to_index"])
            actions.add(values["action.index"][:-1])
            for name, file in learned_files.items():
                file.add(values[name][:-1])
            bar.advance(1)
