"""An append adds a batch: old files stay byte for byte, and what is recorded of all is as if all had been read."""

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, MergeConfig, ReleaseConfig
from gym_open.datasets.derived import derive
from gym_open.datasets.merge import merge_releases
from gym_open.datasets.writing.sources import held_logs
from gym_open.errors import RefusedError, UsageError

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
FIRST = ReleaseConfig(max_episode_steps=5, val_fraction=0.34, data_file_mb=1)
SECOND = ReleaseConfig(max_episode_steps=5, val_fraction=0.34, data_file_mb=1, version="1.1.0")
RECORDS = ("data/**/*.parquet", "meta/*/**/*.parquet")


@pytest.fixture(scope="module")
def logs(make_log: MakeLog) -> list[Path]:
    return [make_log(), make_log(lengths=((6, 9, 2), (3, 3)), seed=1)]


@pytest.fixture(scope="module")
def first(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(FIRST, logs[:1], tmp_path_factory.mktemp("open") / "1.0.0").path)


@pytest.fixture(scope="module")
def second(logs: list[Path], first: Release) -> Release:
    """`first` is found beside it."""
    return open_release(build_release(SECOND, logs[1:], first.root.with_name("1.1.0"), append=True).path)


def files(release: Release) -> dict[str, bytes]:
    found = [path for pattern in RECORDS for path in release.root.glob(pattern)]
    return {path.relative_to(release.root).as_posix(): path.read_bytes() for path in found}


def test_old_files_stay_byte_for_byte(first: Release, second: Release) -> None:
    old, new = files(first), files(second)
    assert {name: new[name] for name in old} == old
    added = {name for name in set(new) - set(old) if name.startswith("meta")}
    tables = {"streams", "worlds", "switches", "segments", "keyframes", "content", "episodes/chunk-000"}
    assert added == {f"meta/{name}/file-001.parquet" for name in tables}
    assert second.info["gym_open"]["batches"] == 2


def test_numbers_go_on(first: Release, second: Release, logs: list[Path]) -> None:
    alone = open_release(build_release(FIRST, logs[1:], first.root.parent / "alone").path)
    assert len(second) == len(first) + len(alone)
    assert second.column("index").tolist() == list(range(len(second)))
    rows = second.episodes
    assert rows["episode_index"].tolist() == list(range(len(rows)))
    assert rows["dataset_from_index"].tolist() == [0, *rows["dataset_to_index"].tolist()[:-1]]
    assert sorted(rows["stream"].unique()) == sorted(second.table("streams")["stream"]) == [0, 1, 2, 3]
    assert np.array_equal(second.images(range(len(first))), first.images(range(len(first))))
    played = (rows["stream"] >= 2).to_numpy()
    theirs = alone.episodes.assign(stream=alone.episodes["stream"] + 2)
    key = ["stream", "segment", "piece", "first_step", "steps", "continued", "ended", "puzzle"]
    expected = theirs[key].sort_values(key).to_numpy().tolist()
    assert rows[played][key].sort_values(key).to_numpy().tolist() == expected


def test_splits_are_ranges_and_no_world_moves(first: Release, second: Release) -> None:
    covered: list[int] = []
    for name, text in second.info["splits"].items():
        for part in text.split(","):
            low, high = map(int, part.split(":"))
            assert set(second.episodes["split"].iloc[low:high]) == {name}
            covered += range(low, high)
    assert sorted(covered) == list(range(len(second.episodes)))
    assert sum("," in text for text in second.info["splits"].values()) >= 1
    of_world = second.episodes.groupby("puzzle")["split"].agg(set)
    assert all(len(splits) == 1 for splits in of_world)
    before = first.episodes.groupby("puzzle")["split"].first()
    assert {puzzle: next(iter(of_world[puzzle])) for puzzle in before.index} == before.to_dict()
    assert sorted(second.info["gym_open"]["val"]) == sorted(of_world.index[of_world == {"val"}])
    frames = np.sort(np.concatenate([second.split("train"), second.split("val")]))
    assert frames.tolist() == list(range(len(second)))


def test_statistics_are_numpys_over_both_batches(second: Release) -> None:
    stats = json.loads((second.root / "meta/stats.json").read_text())
    for name in ("observation.state", "reward.intrinsic", "index", "observation.image"):
        if name == "observation.image":
            values = second.images(range(len(second))).reshape(-1, 3) / 255
        else:
            values = second.column(name).astype(np.float64).reshape(len(second), -1)
        for statistic in ("min", "max", "mean", "std"):
            expected = getattr(np, statistic)(values, axis=0)
            assert np.allclose(np.ravel(stats[name][statistic]), expected, rtol=1e-9, atol=1e-12), (name, statistic)


def test_pandas_and_our_reader_agree_on_all_batches(second: Release) -> None:
    assert pd.read_parquet(second.root / "data")["index"].tolist() == list(range(len(second)))
    assert len(pd.read_parquet(second.root / "meta/streams")) == 4


def test_same_bytes_again_and_the_old_release_is_a_parent(
    first: Release, second: Release, logs: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "elsewhere"
    again = build_release(SECOND, logs[1:], out, previous=first.root, append=True, workers=1)
    assert artefacts.digest(again.path) == second.digest
    assert [parent.digest for parent in artefacts.lineage(out).parents][-1] == first.digest


@pytest.mark.parametrize(
    ("change", "named"),
    [({"max_episode_steps": 6}, "max_episode_steps"), ({"split_by": "stream"}, "split_by"), ({"name": "a/b"}, "name")],
)
def test_other_rules_are_not_appended(
    change: dict[str, object], named: str, first: Release, logs: list[Path], tmp_path: Path
) -> None:
    config = ReleaseConfig(**{"max_episode_steps": 5, "version": "1.1.0", **change})  # pyright: ignore[reportArgumentType]
    with pytest.raises(UsageError, match=named):
        build_release(config, logs[1:], tmp_path / "r", previous=first.root, append=True)


def test_a_new_part_of_the_reward_is_not_appended(first: Release, make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((3,),), reward_parts=("novelty",))
    with pytest.raises(UsageError, match=r"the part novelty.*it has none"):
        build_release(SECOND, [log], tmp_path / "r", previous=first.root, append=True)


def test_there_must_be_something_to_append_to(logs: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing to append to"):
        build_release(SECOND, logs, tmp_path / "1.1.0", append=True)


def test_no_log_is_in_a_release_twice(first: Release, logs: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="twice"):
        build_release(SECOND, logs[:1], tmp_path / "r", previous=first.root, append=True)
    with pytest.raises(UsageError, match="twice"):
        build_release(FIRST, [logs[0], logs[1], logs[0]], tmp_path / "r")


def test_a_log_of_a_version_that_was_only_compared_with_is_appended(
    first: Release, logs: list[Path], tmp_path: Path
) -> None:
    config = msgspec.structs.replace(FIRST, version="2.0.0")
    other = build_release(config, logs[1:], tmp_path / "2.0.0", previous=first.root).path
    config = msgspec.structs.replace(FIRST, version="2.1.0")
    both = open_release(build_release(config, logs[:1], tmp_path / "2.1.0", append=True).path)
    assert len(both.table("streams")) == 4
    assert held_logs(artefacts.lineage(both.root)) == [artefacts.digest(log) for log in logs[::-1]]
    assert held_logs(artefacts.lineage(other)) == [artefacts.digest(logs[1])]


def test_a_log_that_was_filtered_out_is_appended_and_one_that_was_merged_in_is_not(
    second: Release, logs: list[Path], tmp_path: Path
) -> None:
    late = np.flatnonzero(second.episodes["stream"] >= 2)
    some = FilterConfig(name=FIRST.name)
    part = derive(some, "filter", tmp_path / "1.0.0", [(second, late)], workers=1, replace=False).path
    merged = merge_releases(MergeConfig(name=FIRST.name), [second.root], tmp_path / "merged/1.0.0").path
    assert open_release(merged).table("streams")["log"].tolist() == [0, 0, 1, 1], "each append counts its own from 0"
    for root in (part, merged):
        with pytest.raises(UsageError, match="in the release already"):
            build_release(SECOND, logs[1:], tmp_path / "r", previous=root, append=True)
    again = open_release(build_release(SECOND, logs[:1], tmp_path / "1.1.0", append=True).path)
    assert held_logs(artefacts.lineage(again.root)) == [artefacts.digest(log) for log in logs[::-1]]


def test_an_append_is_no_patch(first: Release, logs: list[Path], tmp_path: Path) -> None:
    config = ReleaseConfig(max_episode_steps=5, val_fraction=0.34, version="1.0.1")
    with pytest.raises(UsageError, match=r"1\.1\.0"):
        build_release(config, logs[1:], tmp_path / "r", previous=first.root, append=True)


def test_of_a_version_that_lies_nothing_is_kept(first: Release, logs: list[Path], tmp_path: Path) -> None:
    config = ReleaseConfig(max_episode_steps=5, val_fraction=0.34, version="1.1.0")
    with pytest.raises(RefusedError, match=r"2\.0\.0"):
        build_release(config, logs[1:], tmp_path / "1.1.0", previous=first.root)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.stat().st_size]


def test_play_that_is_there_under_another_digest_is_refused(first: Release, make_log: MakeLog, tmp_path: Path) -> None:
    """The default log once more, by another threshold: another digest, the same steps."""
    same = make_log(threshold=0.5)
    with pytest.raises(UsageError, match="begins with the same steps as"):
        build_release(SECOND, [same], tmp_path / "r", previous=first.root, append=True)
    with pytest.raises(UsageError, match="begins with the same steps as"):
        build_release(FIRST, [make_log(), same], tmp_path / "r")
    assert not (tmp_path / "r").exists()
