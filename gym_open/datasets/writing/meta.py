"""Write the records of a whole release: statistics, digests, info. They are written again for every batch.

They need no frames: `meta/episodes` has the statistics of each episode, and `meta/content` the digests.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gym_open.datasets.config import Header
from gym_open.datasets.writing.lerobot_files import write_info, write_json, write_tasks
from gym_open.datasets.writing.statistics import Merger, read_stats
from gym_open.formats.releases import content
from gym_open.formats.releases.features import Features, objects
from gym_open.formats.releases.info import split_ranges
from gym_open.formats.releases.layout import (
    DIGESTS_PATH,
    EPISODES_PATHS,
    FORMAT,
    IMAGE,
    STATS_PATH,
    TABLES,
    TASKS_PATH,
    data_path,
    video_path,
)
from gym_open.formats.releases.schemas import STATISTICS, STATS, content_features

_ROWS = 128
"""Number of episodes whose statistics are Python objects at the same time: about 75 kB each."""


def write_meta(
    folder: Path, described: Features, header: Header, ours: Mapping[str, Any], data_file_mb: int
) -> dict[str, Any]:
    """Write `meta/{tasks.parquet,stats.json,digests.json,info.json}` from the other files in `folder`.

    Args:
        folder: folder of the release, with all batches of data and tables.
        described: of `features.features`.
        header: name, version, licence, date.
        ours: other values for the key `gym_open` of `info.json`.
        data_file_mb: size at which data files end.

    Returns:
        Facts: frames, episodes, steps, and the release's content digest.
    """
    write_tasks(folder)
    files = sorted(folder.glob(EPISODES_PATHS))
    wanted = [name for name in pq.read_schema(files[0]).names if not name.startswith(STATS)]
    episodes = pa.concat_tables(_read(path, wanted) for path in files)
    write_json(_statistics(files, described), folder / STATS_PATH)
    digests = _digests(folder, described, episodes)
    write_json(digests, folder / DIGESTS_PATH)
    about = {
        "format": FORMAT,
        "name": header.name,
        "version": header.version,
        "license": header.license,
        "published": header.published,
        "objects": objects(described),
        "batches": len(files),
        **ours,
    }
    if described[IMAGE]["dtype"] == "video":
        about["video_error"] = _video_error(episodes)
    frames = sum(episodes["length"].to_pylist())
    write_info(
        folder, described, episodes=len(episodes), frames=frames, splits=split_ranges(episodes["split"].to_pylist()),
        data_file_mb=data_file_mb, ours=about,
    )  # fmt: skip
    steps = sum(episodes["steps"].to_pylist())
    return {"frames": frames, "episodes": len(episodes), "steps": steps, "content": digests["release"]}


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    with pq.ParquetFile(path) as file:
        return file.read(columns=columns)


def _statistics(files: list[Path], described: Features) -> dict[str, Any]:
    mergers = {name: Merger() for name in described}
    columns = [f"{STATS}{name}/{statistic}" for name in described for statistic in STATISTICS]
    for path in files:
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(_ROWS, columns=columns):
                for row in batch.to_pylist():
                    for name, merger in mergers.items():
                        merger.add(read_stats({key: row[f"{STATS}{name}/{key}"] for key in STATISTICS}))
    return {name: merger.result().plain() for name, merger in mergers.items()}


def _digests(folder: Path, described: Features, episodes: pa.Table) -> dict[str, Any]:
    parts = {name: _tables(folder, f"meta/{name}/*.parquet") for name in TABLES}
    tables = {name: pa.concat_tables(found.values()) for name, found in parts.items()}
    of_pictures = tables["content"][IMAGE].to_pylist()
    facts = episodes.select(content.EPISODE_FACTS).to_pylist()
    hashes = tables["content"].select(content_features(described)).to_pylist()
    of_episodes = [content.episode_digest(*pair) for pair in zip(hashes, facts, strict=True)]
    files = {path: content.data_file_digest(of_episodes[span]) for path, span in _files(episodes, data_path)}
    if described[IMAGE]["dtype"] == "video":
        files |= {path: content.data_file_digest(of_pictures[span]) for path, span in _files(episodes, video_path)}
    files |= {path: content.table_digest(table) for found in parts.values() for path, table in found.items()}
    others = [TASKS_PATH, *(path.relative_to(folder).as_posix() for path in folder.glob(EPISODES_PATHS))]
    files |= {path: content.table_digest(_read(folder / path)) for path in others}
    release = content.release_digest(described, of_episodes, episodes.select(content.EPISODE_PLACES), tables)
    return {"release": release, "files": files}


def _tables(folder: Path, pattern: str) -> dict[str, pa.Table]:
    return {path.relative_to(folder).as_posix(): _read(path) for path in sorted(folder.glob(pattern))}


def _files(episodes: pa.Table, name: Callable[[int, int], str]) -> Iterator[tuple[str, slice]]:
    """Every data file, with the slice of its episodes."""
    places = zip(episodes["data/chunk_index"].to_pylist(), episodes["data/file_index"].to_pylist(), strict=True)
    first = 0
    for place, group in groupby(places):
        stop = first + len(list(group))
        yield name(*place), slice(first, stop)
        first = stop


def _video_error(episodes: pa.Table) -> dict[str, float | None]:
    """Mean and largest difference of all pixels from the logged ones, in levels of 255; PSNR in dB if finite."""
    import numpy as np

    weights = episodes["length"].to_numpy() / episodes["length"].to_numpy().sum()
    mse = float(weights @ episodes["pixel_error/mse"].to_numpy())
    return {
        "mean": float(weights @ episodes["pixel_error/mean"].to_numpy()),
        "max": float(np.max(episodes["pixel_error/max"].to_numpy())),
        "psnr": float(10 * np.log10(255**2 / mse)) if mse else None,
    }
