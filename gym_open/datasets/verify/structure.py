"""Check that files, `info.json` and episodes of a release fit together. No frame is read."""

from itertools import groupby
from typing import TYPE_CHECKING, Any

from gym_open import artefacts
from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.datasets.writing.lerobot_files import TASK
from gym_open.datasets.writing.splits import unit_of
from gym_open.formats.releases import parquet, videos
from gym_open.formats.releases.frames import LENGTH_CAP
from gym_open.formats.releases.info import split_ranges
from gym_open.formats.releases.layout import (
    DIGESTS_PATH,
    IMAGE,
    INFO_PATH,
    MAX_EPISODE_STEPS,
    SPLITS,
    STATS_PATH,
    TABLES,
    TASKS_PATH,
    data_path,
    episodes_path,
    table_path,
    video_path,
)
from gym_open.formats.releases.reader import Release
from gym_open.formats.releases.schemas import PIXEL_ERROR

if TYPE_CHECKING:
    import pandas as pd

EPISODES = "meta/episodes"
_RECORDS = (DIGESTS_PATH, INFO_PATH, STATS_PATH, TASKS_PATH)


def check_files(release: Release, names: set[str], findings: Findings) -> None:
    """Check that exactly the files for the format, the batches and the episodes exist."""
    batches: int = release.info["gym_open"]["batches"]
    expected = {*_RECORDS, *(episodes_path(batch) for batch in range(batches))}
    expected |= {table_path(table, batch) for table in TABLES for batch in range(batches)}
    for place in {(row[0], row[1]) for row in _places(release.episodes)}:
        expected.add(data_path(*place))
        if release.info["features"][IMAGE]["dtype"] == "video":
            expected.add(video_path(*place))
    for name in sorted(expected - names):
        findings.add(name, "missing: a release of this format, or its episodes, must have it")
    for name in sorted(names - expected):
        if name.startswith(("data/", "videos/", "meta/")):
            findings.add(name, "belongs to no episode and no batch; remove it, or get the release again")


def check_info(release: Release, findings: Findings) -> None:
    """Check that `meta/info.json` agrees with the episodes."""
    info, episodes = release.info, release.episodes
    ours = info["gym_open"]
    findings.expect(
        int(episodes["length"].sum()) == info["total_frames"], INFO_PATH,
        f"total_frames is {info['total_frames']}, the episodes have {episodes['length'].sum()}",
    )  # fmt: skip
    splits = split_ranges(episodes["split"].tolist())
    findings.expect(
        info["splits"] == splits, INFO_PATH, f"splits are {str(info['splits'])[:100]}, those of the episodes {splits}"
    )
    if "video_error" in ours:
        weights = episodes["length"] / episodes["length"].sum()
        mean, most = (weights * episodes[f"{PIXEL_ERROR}mean"]).sum(), episodes[f"{PIXEL_ERROR}max"].max()
        good = abs(mean - ours["video_error"]["mean"]) < 1e-9 and most == ours["video_error"]["max"]
        findings.expect(good, INFO_PATH, "gym_open.video_error does not follow from the episodes")
    units: dict[str, set[str]] = {split: set() for split in SPLITS}
    for row in rows_of(episodes[["split", "stream", "puzzle"]].drop_duplicates()):
        units.setdefault(row["split"], set()).add(unit_of(ours["split_by"], row["stream"], row["puzzle"]))
    findings.expect(set(units) == set(SPLITS), EPISODES, f"splits {sorted(units)}, expected {list(SPLITS)}")
    for unit in sorted(units["train"] & units["val"]):
        findings.add(EPISODES, f"{ours['split_by']} {unit} is in train and in val: the splits must share none")
    if strange := units["val"] ^ (set(ours["val"]) & (units["val"] | units["train"])):
        findings.add(INFO_PATH, f"gym_open.val does not fit the episodes: {', '.join(sorted(strange)[:3])}")


def check_episodes(release: Release, findings: Findings) -> None:
    """Check numbers, lengths, facts and places of the episodes."""
    import numpy as np

    episodes = release.episodes
    count = len(episodes)

    def expect(good: Any, what: str) -> None:
        bad = np.flatnonzero(~np.asarray(good))
        if len(bad):
            findings.add(EPISODES, f"{what}: episode {', '.join(map(str, bad[:3]))}{' …' if len(bad) > 3 else ''}")

    frames, steps = episodes["length"].to_numpy(), episodes["steps"].to_numpy()
    first, stop = episodes["dataset_from_index"].to_numpy(), episodes["dataset_to_index"].to_numpy()
    expect(episodes["episode_index"].to_numpy() == np.arange(count), "episode_index does not follow the one before")
    expect(first == np.append(0, stop[:-1]), "its frames do not follow those of the episode before")
    expect(stop - first == frames, "length is not the number of its frames")
    expect((frames == steps + 1) & (steps >= 0), "length is not steps + 1")
    expect(steps <= release.info["gym_open"]["max_episode_steps"], "has more steps than an episode may have")
    expect(frames <= MAX_EPISODE_STEPS + 1, "has more frames than timestamps in float32 can distinguish")
    expect([list(tasks) == [TASK] for tasks in episodes["tasks"]], "has another task")
    expect(episodes["split"].isin(SPLITS).to_numpy(), "is in an unknown split")
    expect((episodes[["stream", "segment", "piece", "world", "first_step"]] >= 0).all(axis=1).to_numpy(),
           "stream, segment, piece, world or first_step is negative")  # fmt: skip
    expect(~episodes.duplicated(["stream", "segment", "piece"]).to_numpy(), "is there twice")
    _check_pieces(release, findings)
    _check_batches(release, findings)
    _check_places(release, findings)


def _check_pieces(release: Release, findings: Findings) -> None:
    """Check that each piece of a segment begins where the one before it was cut for its length."""
    ordered = release.episodes.sort_values(["stream", "segment", "piece"])
    if not _is_chosen(release):
        place = ordered.groupby(["stream", "segment"]).cumcount()
        for number in ordered.loc[ordered["piece"] != place, "episode_index"].tolist()[:3]:
            findings.add(EPISODES, f"episode {number}: the piece before it is missing")
    following = ordered.shift(-1)
    same = (ordered["stream"] == following["stream"]) & (ordered["segment"] == following["segment"])
    neighbours = same & (ordered["piece"] + 1 == following["piece"])
    joined = (
        (ordered["ended"] == LENGTH_CAP)
        & (ordered["first_step"] + ordered["steps"] == following["first_step"])
        & (ordered["world"] == following["world"])
        & (ordered["puzzle"] == following["puzzle"])
        & (ordered["split"] == following["split"])
        & following["continued"].astype(bool)
    )
    for number in ordered.loc[neighbours & ~joined, "episode_index"].tolist()[:3]:
        findings.add(EPISODES, f"episode {number} does not continue in the next piece of its segment")
    apart = same & ~neighbours & (ordered["first_step"] + ordered["steps"] > following["first_step"])
    for number in ordered.loc[apart, "episode_index"].tolist()[:3]:
        findings.add(EPISODES, f"episode {number} overlaps the next piece of its segment")


def _is_chosen(release: Release) -> bool:
    """Whether pieces of segments may be missing: by its lineage, it holds selected episodes of another release."""
    built = "split_by" in (config := artefacts.config_of(release.root)) and not config.get("append")
    return not built and any(parent.lineage.kind == "release" for parent in artefacts.lineage(release.root).parents)


def _check_batches(release: Release, findings: Findings) -> None:
    """Check that rows name their file, and that a chunk of data holds one split of one batch."""
    expected: list[int] = []
    for batch in range(release.info["gym_open"]["batches"]):
        if (release.root / episodes_path(batch)).exists():
            expected += [batch] * parquet.metadata(release.root / episodes_path(batch)).num_rows
    episodes = release.episodes
    said = episodes["meta/episodes/file_index"].tolist()
    findings.expect(
        said == expected and not episodes["meta/episodes/chunk_index"].any(), EPISODES,
        "meta/episodes/chunk_index or file_index is not the file of the row",
    )  # fmt: skip
    groups = episodes.groupby("data/chunk_index")[["split", "meta/episodes/file_index"]].nunique()
    for chunk in groups.index[(groups > 1).any(axis=1)].tolist()[:3]:
        findings.add(EPISODES, f"data/chunk-{chunk:03d} holds more than one split of one batch")


def _places(episodes: "pd.DataFrame") -> list[tuple[int, int]]:
    return list(zip(episodes["data/chunk_index"].astype(int), episodes["data/file_index"].astype(int), strict=True))


def _check_places(release: Release, findings: Findings) -> None:
    """Check that files are in the order of the episodes, and that each holds their frames."""
    places = _places(release.episodes)
    if places != sorted(places):
        findings.add(EPISODES, "episodes are not in data files in their order")
        return
    video = release.info["features"][IMAGE]["dtype"] == "video"
    first = 0
    for place, group in groupby(places):
        stop = first + len(list(group))
        frames = int(release.episodes["length"].iloc[first:stop].sum())
        found = parquet.metadata(release.root / data_path(*place)).num_rows
        findings.expect(found == frames, data_path(*place), f"{found} frames, the episodes in it have {frames}")
        if video:
            found = videos.n_frames(release.root / video_path(*place))
            findings.expect(found == frames, video_path(*place), f"{found} frames, the episodes in it have {frames}")
            _check_times(release, place, first, stop, findings)
        first = stop


def _check_times(release: Release, place: tuple[int, int], first: int, stop: int, findings: Findings) -> None:
    """Check where LeRobot looks for the images of the episodes of a file."""
    import numpy as np

    rows = release.episodes.iloc[first:stop]
    starts = (rows["dataset_from_index"] - rows["dataset_from_index"].iloc[0]).to_numpy() / release.info["fps"]
    ends = starts + rows["length"].to_numpy() / release.info["fps"]
    prefix = f"videos/{IMAGE}/"
    good = np.allclose(rows[f"{prefix}from_timestamp"], starts, atol=1e-4, rtol=0)
    good &= np.allclose(rows[f"{prefix}to_timestamp"], ends, atol=1e-4, rtol=0)
    good &= bool((rows[f"{prefix}chunk_index"] == place[0]).all() and (rows[f"{prefix}file_index"] == place[1]).all())
    findings.expect(good, EPISODES, f"the place of the images of episodes {first} to {stop - 1} is wrong")
