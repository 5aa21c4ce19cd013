"""Decode every frame once: check the episodes, and compute statistics and content digests again."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gym_open import progress
from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.datasets.writing.statistics import STATISTICS, Merger, Stats, feature_stats, image_stats, read_stats
from gym_open.errors import ArtefactError
from gym_open.formats.releases import content, parquet
from gym_open.formats.releases.features import STATE_FIELDS, fps, objects, schema
from gym_open.formats.releases.frames import NO_ACTION
from gym_open.formats.releases.info import read_json
from gym_open.formats.releases.layout import (
    BOOKKEEPING,
    DATA_PATHS,
    DIGESTS_PATH,
    EPISODES_PATHS,
    IMAGE,
    PART,
    STATS_PATH,
    TABLES,
    TASKS_PATH,
    data_path,
    video_path,
)
from gym_open.formats.releases.reader import Release
from gym_open.formats.releases.schemas import STATS, episodes_schema

_ROUNDING = 1e-9
"""Relative error of a mean or standard deviation that another order of addition may cause."""
_ROWS = 256
"""Number of episodes whose statistics are Python objects at the same time."""
_THOUGHT = ("reward.intrinsic", "policy.entropy", "policy.value")
"""Features with a finite value for every action."""
_PADDED = (
    *_THOUGHT,
    *("contact.count", "contact.agent", "contact.impulse"),
)
"""Features that are 0 on the last frame, which has no action."""


def check_contents(release: Release, findings: Findings) -> str:
    """Check all frames, their statistics and digests; return the content digest, computed from the frames."""
    _check_files(release, findings)
    episodes, stored = release.episodes, release.table("content")
    mergers = {name: Merger() for name in release.info["features"]}
    digests: list[str] = []
    pictures: list[str] = []
    rows = rows_of(episodes)
    with progress.bar("verifying", len(release)) as bar:
        for row, said in zip(rows, _statistics(release), strict=True):
            number, file = row["episode_index"], data_path(row["data/chunk_index"], row["data/file_index"])
            first, stop = row["dataset_from_index"], row["dataset_to_index"]
            try:
                values, images = release.numbers(first, stop), release.images(range(first, stop))
            except ArtefactError as error:
                findings.add(file, f"episode {number}: {error}")
                bar.advance(stop - first)
                continue
            for what in wrong_in(values, row, release.info["features"]):
                findings.add(file, f"episode {number}: {what}")
            found = {name: feature_stats(array) for name, array in values.items()} | {IMAGE: image_stats(images)}
            for name, merger in mergers.items():
                merger.add(said[name])
                if not _alike(found[name], said[name]):
                    findings.add("meta/episodes", f"episode {number}: statistics of {name} do not fit its frames")
            of_features = {name: content.feature_digest(array) for name, array in values.items()
                           if name not in BOOKKEEPING} | {IMAGE: content.feature_digest(images)}  # fmt: skip
            for name, digest in of_features.items():
                if stored[name].iloc[number] != digest:
                    findings.add(file, f"episode {number}: {name} does not match its content digest")
            digests.append(content.episode_digest(of_features, row))
            pictures.append(of_features[IMAGE])
            bar.advance(stop - first)
    if len(digests) < len(rows):
        return ""
    _check_stats(release, mergers, findings)
    return _check_digests(release, digests, pictures, findings)


def _check_files(release: Release, findings: Findings) -> None:
    """Check the parts of data files that readers ignore: images have no path, and the metadata fits the features."""
    columns = schema(release.info["features"])
    for path in sorted(release.root.glob(DATA_PATHS)):
        name = path.relative_to(release.root).as_posix()
        with parquet.opened(path) as file:
            found = file.schema_arrow
            plain = found.metadata == columns.metadata and not any(found.field(item).metadata for item in found.names)
        findings.expect(plain, name, "its metadata does not fit its features")
        if release.info["features"][IMAGE]["dtype"] == "image":
            paths = parquet.read(path, columns, [f"{IMAGE}.path"]).column(0).combine_chunks().field("path")
            findings.expect(paths.null_count == len(paths), name, f"{IMAGE} has a path in addition to its bytes")


def wrong_in(values: Mapping[str, np.ndarray], row: Mapping[str, Any], described: Mapping[str, Any]) -> Iterator[str]:
    """Find the faults in the numbers of one episode, in words.

    Args:
        values: all numeric features, `row["length"]` frames each.
        row: row of the episode in `meta/episodes`.
        described: features from `meta/info.json`.
    """
    played = np.arange(row["length"]) < row["steps"]
    for name, wanted in _places(row, played).items():
        if not np.array_equal(values[name], wanted):
            yield f"{name} does not fit its place in the episode"
    for good, what in (*_moves(values, played), *_states(values, described)):
        if not good:
            yield what
    padded, thought = ([name for name in names if name in values] for names in (_PADDED, _THOUGHT))
    yield from (f"{name} is not 0 on the last frame" for name in padded if values[name][~played].any())
    yield from (f"{name} is not finite" for name in thought if not np.isfinite(values[name][played]).all())
    parts = (name for name in values if name.startswith(PART))
    yield from (f"{name} is not NaN on the last frame" for name in parts if not np.isnan(values[name][~played]).all())
    loss = values.get("world_model.loss", np.zeros(len(played)))
    if not (loss[~played] == 0).all() and not np.isnan(loss).all():
        yield "world_model.loss is not 0 on the last frame"


def _places(row: Mapping[str, Any], played: np.ndarray) -> dict[str, np.ndarray]:
    """Features that follow from the place of a frame in its episode."""
    frames, steps = row["length"], row["steps"]
    number = np.arange(frames)
    return {
        "index": row["dataset_from_index"] + number,
        "frame_index": number,
        "episode_index": np.full(frames, row["episode_index"]),
        "task_index": np.zeros(frames),
        "timestamp": (number / fps()).astype(np.float32),
        "next.done": np.zeros(frames, bool),
        "next.reward": np.zeros(frames),
        "next.truncated": number >= steps - 1,
        "transition.valid": played,
    }


def _moves(values: Mapping[str, np.ndarray], played: np.ndarray) -> Iterator[tuple[bool, str]]:
    """Checks of actions and contacts: whether each holds, and the words if not."""
    actions, width = values["action.index"], values["action"].shape[1]
    known = bool(((actions >= 0) & (actions < width))[played].all() and (actions[~played] == NO_ACTION).all())
    yield known, f"action.index is not 0 to {width - 1}, and {NO_ACTION} on the last frame"
    one_hot = np.eye(width + 1, width, dtype=np.float32)  # -1 selects its last row, which is all zero
    yield (
        not known or np.array_equal(values["action"], one_hot[actions]),
        "action is not one-hot action.index",
    )
    count, agent, impulse = (values[f"contact.{name}"] for name in ("count", "agent", "impulse"))
    agree = np.isfinite(impulse) & (count >= agent) & (agent >= 0) & ((impulse == 0) | (count > 0))
    yield bool(agree.all()), "contact.count, contact.agent and contact.impulse do not agree"


def _states(values: Mapping[str, np.ndarray], described: Mapping[str, Any]) -> Iterator[tuple[bool, str]]:
    """Checks of states: whether each holds, and the words if not."""
    every = values["observation.environment_state"]
    state = every.reshape(len(every), -1, len(STATE_FIELDS))
    yield bool(np.isfinite(state).all()), "observation.environment_state is not finite"
    agent = state[:, objects(dict(described)).index("agent")]
    same = np.array_equal(values["observation.state"], agent)
    yield same, "observation.state is not the state of the agent in observation.environment_state"


def _statistics(release: Release) -> Iterator[dict[str, Stats]]:
    """Read the statistics of each episode from `meta/episodes`, one row group at a time."""
    described = release.info["features"]
    columns = episodes_schema(described)
    names = [name for name in columns.names if name.startswith(STATS)]
    for path in sorted(release.root.glob(EPISODES_PATHS)):
        for group in range(parquet.metadata(path).num_row_groups):
            for batch in parquet.read(path, columns, names, [group]).to_batches(_ROWS):
                yield from _read_statistics(path, batch.to_pylist(), described)


def _read_statistics(
    path: Path, rows: list[dict[str, Any]], described: Mapping[str, Any]
) -> Iterator[dict[str, Stats]]:
    try:
        for row in rows:
            yield {name: read_stats({key: row[f"{STATS}{name}/{key}"] for key in STATISTICS}) for name in described}
    except (TypeError, ValueError, IndexError) as error:
        raise ArtefactError(f"{path}: invalid statistics: {error}; get the release again") from None


def _alike(one: Stats, other: Stats) -> bool:
    """Whether statistics are equal, apart from rounding errors of means and standard deviations."""
    if any(getattr(one, name).shape != getattr(other, name).shape for name in STATISTICS[:-1]):
        return False
    exact = one.count == other.count and np.array_equal(one.min, other.min) and np.array_equal(one.max, other.max)
    scale = np.maximum(np.abs(one.max), np.abs(one.min)) + 1e-300
    near = (np.abs(getattr(one, name) - getattr(other, name)) <= _ROUNDING * scale for name in ("mean", "std"))
    return exact and all(bool(each.all()) for each in near)


def _check_stats(release: Release, mergers: Mapping[str, Merger], findings: Findings) -> None:
    """Check that `meta/stats.json` follows from all episodes."""
    said = read_json(release.root / STATS_PATH, dict[str, dict[str, Any]])
    for name in sorted(said.keys() | mergers.keys()):
        try:
            good = name in mergers and _alike(mergers[name].result(), read_stats(said[name]))
        except (KeyError, TypeError, ValueError, IndexError):
            good = False
        findings.expect(good, STATS_PATH, f"statistics of {name} do not follow from the episodes")


def _check_digests(release: Release, episodes: list[str], images: list[str], findings: Findings) -> str:
    """Check that `meta/digests.json` follows from the decoded content; return the digest of the release."""
    said = read_json(release.root / DIGESTS_PATH, dict[str, Any])
    files: dict[str, str] = {}
    rows = release.episodes
    places = zip(rows["data/chunk_index"].tolist(), rows["data/file_index"].tolist(), strict=True)
    first = 0
    for place, group in groupby(places):
        stop = first + len(list(group))
        files[data_path(*place)] = content.data_file_digest(episodes[first:stop])
        if release.info["features"][IMAGE]["dtype"] == "video":
            files[video_path(*place)] = content.data_file_digest(images[first:stop])
        first = stop
    for path in (*release.root.glob("meta/*/**/*.parquet"), release.root / TASKS_PATH):
        name = path.relative_to(release.root).as_posix()
        files[name] = content.table_digest(parquet.read(path, None))
    tables = {name: release.arrow_table(name) for name in TABLES}
    facts = pa.Table.from_pandas(rows[list(content.EPISODE_PLACES)], preserve_index=False)
    total = content.release_digest(release.info["features"], episodes, facts, tables)
    found = said.get("files")
    found = found if isinstance(found, dict) else {}
    for name in sorted(files.keys() | found.keys()):
        findings.expect(files.get(name) == found.get(name), name, f"its content does not match {DIGESTS_PATH}")
    findings.expect(said.get("release") == total, DIGESTS_PATH, "the content digest does not follow from its parts")
    findings.expect(set(said) == {"release", "files"}, DIGESTS_PATH, "holds other keys than release and files")
    return total
