"""Logs become a release: `build_release(config, logs, out)`; or are appended to one that there is."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from gym_open import artefacts, progress
from gym_open.config import to_dict
from gym_open.datasets.compare.versions import implied, latest_below
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.repeats import check_distinct
from gym_open.datasets.writing.sources import (
    HELD,
    SourceStream,
    episodes_of_logs,
    held_logs,
    streams_of,
)
from gym_open.datasets.writing.splits import Unit, assign, shares_of, unit_of, units_of
from gym_open.datasets.writing.tables import tables_of_logs
from gym_open.datasets.writing.video import MAX_FRAMES
from gym_open.datasets.writing.writer import ReleaseWriter, check_workers, complete
from gym_open.errors import ArtefactError, ConfigError, UsageError
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.features import Features, features, objects
from gym_open.formats.releases.layout import PART, Split

_PART_NAME = re.compile(r"[A-Za-z0-9_.-]+")
"""What LeRobot has in a feature's name, less what is special in paths and patterns."""


class AppendConfig(ReleaseConfig, frozen=True):
    """What an appended release is sealed with."""

    append: Literal[True] = True
    """The episodes of the version before are in it, file by file."""


def build_release(
    config: ReleaseConfig, logs: Sequence[Path], out: Path, *, previous: Path | None = None, append: bool = False,
    workers: int | None = None, replace: bool = False,
) -> artefacts.Outcome:  # fmt: skip
    """Build the release `out` from log artefacts.

    The same logs, configuration and previous version give the same bytes in any folder, with any number of workers. A
    build that was interrupted goes on when it is run again.

    Args:
        config: all that decides the release.
        logs: folders of log artefacts; streams are numbered in their order.
        out: folder of the release; the versions of one release are siblings called X.Y.Z.
        previous: release to compare with; the highest lower version beside `out`, if not given and there is one.
        append: take over the episodes of `previous`, files byte for byte, and add those of `logs`.
        workers: threads; all processors if not given.
        replace: set aside what stands at `out` if it was made of other inputs, rather than refuse.

    Raises:
        ArtefactError: if a log is missing, damaged, empty, or not of free play in the sandbox (naming the file), or the
            version says other than what was changed; no release is left behind.
        UsageError: if `out` was made of other inputs and `replace` is false, there is nothing to append to, a log
            would be in the release twice, `workers` is below 1, or episodes could be longer than a video may be.
    """
    previous = previous or latest_below(out, config.version)
    _check_config(config)
    check_workers(workers)
    if append:
        _check_append(config, out, previous)
    held = _check_new(logs, previous if append else None)
    sealed = AppendConfig(**to_dict(config)) if append else config

    parents = [*logs, *([previous] if previous else [])]

    def work(folder: Path) -> Mapping[str, Any]:
        before = open_release(previous) if previous else None
        facts = _write(config, logs, folder, before if append else None, workers)
        complete(folder, sealed, "append" if append else "build", before, parents)
        return {**facts, HELD: held}

    return artefacts.build(out, kind="release", config=sealed, parents=parents, work=work, replace=replace)


def _check_append(config: ReleaseConfig, out: Path, previous: Path | None) -> None:
    """Raises UsageError if there is nothing to append to, or the version is not the one that follows."""
    if previous is None:
        raise UsageError(f"{out}: nothing to append to: no version below {config.version} beside it; give --previous")
    honest = implied(open_release(previous).version, "minor")
    if config.version != honest:
        raise UsageError(
            f"version {config.version}: what is appended to {previous} makes it {honest}; give --version {honest}"
        )


def _check_config(config: ReleaseConfig) -> None:
    """Raises ConfigError if an episode could be longer than a video may be."""
    if config.pictures == "video" and config.max_episode_steps >= MAX_FRAMES:
        raise ConfigError(
            f"max_episode_steps: {config.max_episode_steps} with pictures = 'video': an episode of T steps has T + 1 "
            f"frames, a video at most {MAX_FRAMES:,}; give {MAX_FRAMES - 1} or less, or pictures = 'png'"
        )


def _check_new(logs: Sequence[Path], after: Path | None) -> list[str]:
    """Digests of the logs, after which all logs that the release will hold are told apart.

    Raises:
        UsageError: if a log is given twice, or is in the release that is appended to: episodes would be twice.
    """
    known = held_logs(artefacts.lineage(after)) if after else []
    for log in logs:
        if (digest := artefacts.digest(log)) in known:
            raise UsageError(f"{log}: given twice, or in the release already: its episodes would be there twice")
        known.append(digest)
    return known


def _write(
    config: ReleaseConfig, logs: Sequence[Path], folder: Path, after: Release | None, workers: int | None
) -> dict[str, Any]:
    """Write data and meta of a release, or of one that goes on from `after`; return its facts."""
    streams = streams_of(logs, int(after.table("streams")["stream"].max()) + 1 if after else 0)
    described = _features(config, streams, after)
    check_distinct(streams, after)
    known = _known_units(config, after) if after else {}
    splits = assign(units_of(config, streams), config.val_fraction, config.seed, known)
    ours = {
        "split_by": config.split_by,
        "val": sorted(unit for unit, split in splits.items() if split == "val"),
        "max_episode_steps": config.max_episode_steps,
        "pictures": config.pictures,
    }
    with (
        ReleaseWriter(
            folder, config, described, shares_of(config, streams, splits),
            ours=ours, data_file_mb=config.data_file_mb, after=after, workers=workers,
        ) as writer,
        progress.bar("dataset build", sum(stream.log.n_steps for stream in streams)) as bar,
    ):  # fmt: skip
        for stream in streams:
            if writer.skip(shares_of(config, [stream], splits)):
                bar.advance(stream.log.n_steps)
                continue
            for episode in episodes_of_logs(config, [stream], splits, described):
                writer.add(episode)
                bar.advance(episode.row["steps"])
        return writer.close(tables_of_logs(config, streams, splits, described))


def _features(config: ReleaseConfig, streams: Sequence[SourceStream], after: Release | None) -> Features:
    """The features of all streams, or of the release that is appended to, which must have them.

    Raises:
        ArtefactError: if there is no play, or the streams are of different models.
        UsageError: if the release that is appended to is of other features or rules.
    """
    parts = sorted({part for stream in streams for part in stream.log.reward_parts})
    names: tuple[str, ...] = ()
    for stream in streams:
        first = next(stream.log.segments(1), None)
        if first is None:
            continue
        names = names or first.object_names
        if first.object_names != names:
            raise ArtefactError(
                f"{stream.log.path}: its objects are {first.object_names}, those of other logs {names}; logs of "
                "different models do not go into one release"
            )
    if odd := [part for part in parts if not _PART_NAME.fullmatch(part)]:
        raise ArtefactError(f"part {odd[0]!r} of a reward: expected letters, digits, '_', '-' and '.'; rename it")
    if not names:
        places = ", ".join(str(stream.log.path) for stream in streams) or "no log file"
        raise ArtefactError(f"{places}: no segment to make a release of; collect some steps first")
    if after is None:
        return features(names, parts, config.pictures)
    found = after.info["features"]
    settings = {name: getattr(config, name) for name in ("name", "split_by", "max_episode_steps", "pictures")}
    there = {name: after.info["gym_open"][name] for name in settings}
    settings["objects"], there["objects"] = list(names), objects(found)
    for field, value in settings.items():
        if value != there[field]:
            raise UsageError(
                f"{after.root}: cannot be appended to: its {field}: {there[field]!r}, now: {value!r}; give the "
                "same, or build a release of all logs"
            )
    if lacking := [part for part in parts if PART + part not in found]:
        own = ", ".join(name.removeprefix(PART) for name in found if name.startswith(PART)) or "none"
        raise UsageError(
            f"{after.root}: cannot be appended to: the logs' rewards have the part {', '.join(lacking)}, which is no "
            f"feature of it (it has {own}); build a release of these logs and merge the two"
        )
    return found


def _known_units(config: ReleaseConfig, after: Release) -> dict[Unit, Split]:
    rows = after.episodes
    return {
        unit_of(config.split_by, int(stream), puzzle): split
        for stream, puzzle, split in zip(rows["stream"], rows["puzzle"], rows["split"], strict=True)
    }
