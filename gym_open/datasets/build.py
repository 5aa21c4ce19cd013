"""Build a release from logs, or append logs to a release: `build_release(config, logs, out)`."""

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
    shares_of,
    streams_of,
    units_of,
)
from gym_open.datasets.writing.splits import Unit, assign, unit_of
from gym_open.datasets.writing.tables import tables_of_logs
from gym_open.datasets.writing.video import MAX_FRAMES
from gym_open.datasets.writing.writer import ReleaseWriter, check_workers, complete
from gym_open.errors import ArtefactError, ConfigError, UsageError
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.features import Features, features, objects
from gym_open.formats.releases.layout import PART, Split

_PART_NAME = re.compile(r"[A-Za-z0-9_.-]+")
"""Characters that LeRobot allows in the name of a feature, without those special in paths and patterns."""


class AppendConfig(ReleaseConfig, frozen=True):
    """The configuration recorded in an appended release."""

    append: Literal[True] = True
    """The release contains the episodes of the previous version, file by file."""


def build_release(
    config: ReleaseConfig, logs: Sequence[Path], out: Path, *, previous: Path | None = None, append: bool = False,
    workers: int | None = None, replace: bool = False,
) -> artefacts.Outcome:  # fmt: skip
    """Build the release `out` from log artefacts.

    The same logs, configuration and previous version give the same bytes in any folder, with any number of workers. An
    interrupted build continues when it is run again.

    Args:
        config: everything that determines the release.
        logs: folders of log artefacts. Streams are numbered in this order.
        out: folder of the release. The versions of a release are sibling folders named X.Y.Z.
        previous: release to compare with; by default the highest lower version next to `out`, if there is one.
        append: copy the files of `previous` byte for byte, and add the episodes of `logs`.
        workers: number of threads; by default one per processor.
        replace: set aside an artefact of other inputs at `out`; otherwise refuse.

    Raises:
        ArtefactError: if a log is missing, damaged, empty, or not of exploration in the sandbox (naming the file), or
            the version does not follow from what changed. No release is left behind.
        UsageError: if `out` was made from other inputs and `replace` is false, there is nothing to append to, a log
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
    """Raise UsageError if there is nothing to append to, or the version is not the next one."""
    if previous is None:
        raise UsageError(f"{out}: nothing to append to: no version below {config.version} next to it; give --previous")
    honest = implied(open_release(previous).version, "minor")
    if config.version != honest:
        raise UsageError(
            f"version {config.version}: appending to {previous} makes it {honest}; give --version {honest}"
        )


def _check_config(config: ReleaseConfig) -> None:
    """Raise ConfigError if an episode could be longer than a video may be."""
    if config.pictures == "video" and config.max_episode_steps >= MAX_FRAMES:
        raise ConfigError(
            f"max_episode_steps: {config.max_episode_steps} with pictures = 'video': an episode of T steps has T + 1 "
            f"frames, a video at most {MAX_FRAMES:,}; give {MAX_FRAMES - 1} or less, or pictures = 'png'"
        )


def _check_new(logs: Sequence[Path], after: Path | None) -> list[str]:
    """Return the digests of all logs that the release will hold, each once.

    Raises:
        UsageError: if a log is given twice or is in the release already, so that it would hold episodes twice.
    """
    known = held_logs(artefacts.lineage(after)) if after else []
    for log in logs:
        if (digest := artefacts.digest(log)) in known:
            raise UsageError(f"{log}: given twice, or in the release already: leave it out")
        known.append(digest)
    return known


def _write(
    config: ReleaseConfig, logs: Sequence[Path], folder: Path, after: Release | None, workers: int | None
) -> dict[str, Any]:
    """Write `data` and `meta` of a new release, or of one that appends to `after`, and return its facts."""
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
    """The features of all streams, or those of the release to append to, which must include them.

    Raises:
        ArtefactError: if there is no segment, or the streams have different models.
        UsageError: if the release to append to has other features or rules.
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
                f"{stream.log.path}: its objects are {first.object_names}, those of other logs {names}; build one "
                "release per model"
            )
    if odd := [part for part in parts if not _PART_NAME.fullmatch(part)]:
        raise ArtefactError(f"part {odd[0]!r} of a reward: expected letters, digits, '_', '-' and '.'; rename it")
    if not names:
        places = ", ".join(str(stream.log.path) for stream in streams) or "no log file"
        raise ArtefactError(f"{places}: no segment for a release; collect some steps first")
    if after is None:
        return features(names, parts, config.pictures)
    found = after.info["features"]
    settings = {name: getattr(config, name) for name in ("name", "split_by", "max_episode_steps", "pictures")}
    there = {name: after.info["gym_open"][name] for name in settings}
    settings["objects"], there["objects"] = list(names), objects(found)
    for field, value in settings.items():
        if value != there[field]:
            raise UsageError(
                f"{after.root}: cannot be appended to: its {field} is {there[field]!r}, got {value!r}; give the "
                "same, or build a release of all logs"
            )
    if lacking := [part for part in parts if PART + part not in found]:
        own = ", ".join(name.removeprefix(PART) for name in found if name.startswith(PART)) or "none"
        raise UsageError(
            f"{after.root}: cannot be appended to: the logs' rewards have the part {', '.join(lacking)}, which it "
            f"does not have (it has {own}); build a release of these logs and merge the two"
        )
    return found


def _known_units(config: ReleaseConfig, after: Release) -> dict[Unit, Split]:
    rows = after.episodes
    return {
        unit_of(config.split_by, int(stream), puzzle): split
        for stream, puzzle, split in zip(rows["stream"], rows["puzzle"], rows["split"], strict=True)
    }
