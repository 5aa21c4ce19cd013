"""A merge holds what its parents hold, episode by episode, to the byte; nothing that was held out is trained on."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import MergeConfig, ReleaseConfig
from gym_open.datasets.merge import merge_releases
from gym_open.datasets.verify import verify_release
from gym_open.errors import ArtefactError, UsageError

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
CONFIG = ReleaseConfig(name="open/one", max_episode_steps=4, val_fraction=0.34)
MERGED = MergeConfig(name="open/both")


class Parents(NamedTuple):
    one: Path
    other: Path
    """Of the same layouts as `one` (the same seed), other pixels and splits."""


@pytest.fixture(scope="module")
def parents(make_log: MakeLog, no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Parents:
    folder = tmp_path_factory.mktemp("parents")
    logs = [make_log(lengths=((5, 9, 3), (6, 2, 4)), explorer={"world_model": "curl", "reward": "ride"})]
    logs += [make_log(lengths=((2, 3, 5),), threshold=0.5)]
    one = build_release(CONFIG, logs, folder / "one/1.0.0").path
    more = make_log(lengths=((7, 2, 6),), seed=0, keyframe_every=2)
    other = build_release(
        ReleaseConfig(**{**_plain(CONFIG), "name": "open/other", "seed": 7}), [more], folder / "o/1.0.0"
    )
    return Parents(one, other.path)


def _plain(config: ReleaseConfig) -> dict[str, Any]:
    return {name: getattr(config, name) for name in config.__struct_fields__}


@pytest.fixture(scope="module")
def merged(parents: Parents, tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(merge_releases(MERGED, parents, tmp_path_factory.mktemp("merged") / "1.0.0").path)


def rows(release: Release) -> list[dict[str, Any]]:
    return cast("list[dict[str, Any]]", release.episodes.to_dict("records"))


def pngs(release: Release, row: dict[str, Any]) -> list[bytes]:
    return release.pngs(np.arange(row["dataset_from_index"], row["dataset_to_index"]))


def test_every_episode_of_the_parents_is_there_to_the_byte(parents: Parents, merged: Release) -> None:
    opened = [open_release(path) for path in parents]
    streams = [0, len(opened[0].table("streams"))]
    expected = {
        (row["stream"] + first, row["segment"], row["piece"]): (parent, row)
        for parent, first in zip(opened, streams, strict=True)
        for row in rows(parent)
    }
    assert len(merged.episodes) == len(expected)
    for row in rows(merged):
        parent, source = expected.pop((row["stream"], row["segment"], row["piece"]))
        assert pngs(merged, row) == pngs(parent, source)
        here, there = (
            release.numbers(item["dataset_from_index"], item["dataset_to_index"])
            for release, item in ((merged, row), (parent, source))
        )
        for name in set(here) - {"index", "episode_index"}:
            np.testing.assert_array_equal(here[name], there[name], err_msg=name)
        for name in ("puzzle", "world", "explorer", "first_step", "steps", "continued", "ended"):
            assert row[name] == source[name]
    assert expected == {}
    assert merged.column("index").tolist() == list(range(len(merged)))


def test_what_any_parent_held_out_stays_held_out(parents: Parents, merged: Release) -> None:
    held = {row["puzzle"] for path in parents for row in rows(open_release(path)) if row["split"] == "val"}
    trained = {row["puzzle"] for path in parents for row in rows(open_release(path)) if row["split"] == "train"}
    assert held & trained  # the parents disagree
    assert {row["puzzle"] for row in rows(merged) if row["split"] == "val"} == held
    assert {row["puzzle"] for row in rows(merged) if row["split"] == "train"} == trained - held
    assert set(merged.info["gym_open"]["val"]) == held
    worlds = merged.table("worlds").dropna(subset=["split"])
    assert {puzzle for puzzle, split in zip(worlds["puzzle"], worlds["split"], strict=True) if split == "val"} == held


def test_tables_come_along(parents: Parents, merged: Release) -> None:
    one, other = (open_release(path) for path in parents)
    streams = merged.table("streams")
    assert streams["stream"].tolist() == [0, 1, 2, 3]
    assert streams["log"].tolist() == [0, 0, 1, 2]
    for name in ("log_stream", "explorer", "steps", "seed", "config"):
        assert streams[name].tolist() == [*one.table("streams")[name], *other.table("streams")[name]]
    for name in ("switches", "worlds", "segments", "keyframes"):
        parts = [one.table(name), other.table(name)]
        parts[1]["stream"] += 3
        keys = [key for key in ("stream", "step", "world", "segment", "segment_step") if key in parts[0]]
        columns = [key for key in parts[0] if key not in {"split", "episode_index"}]
        expected = [row for part in parts for row in part[columns].to_dict("records")]
        found = merged.table(name).sort_values(keys, kind="stable")[columns].to_dict("records")
        expected.sort(key=lambda row: [row[key] for key in keys])
        np.testing.assert_equal(found, expected)


def test_it_verifies_and_knows_its_parents(parents: Parents, merged: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    assert verify_release(merged.root, replay=False).problems == []
    lineage = artefacts.lineage(merged.root)
    assert [parent.digest for parent in lineage.parents] == [artefacts.digest(path) for path in parents]
    assert all(parent.is_consistent() for parent in lineage.parents)
    assert (merged.name, merged.version) == ("open/both", "1.0.0")


def test_a_merge_of_one_has_its_content(parents: Parents, tmp_path: Path) -> None:
    alone = merge_releases(MERGED, [parents.one], tmp_path / "1.0.0", workers=1).path
    content = [artefacts.lineage(path).facts["content"] for path in (alone, parents.one)]
    assert content[0] == content[1]


def test_the_same_parents_give_the_same_bytes(parents: Parents, merged: Release, tmp_path: Path) -> None:
    again = merge_releases(MERGED, parents, tmp_path / "deep/er/1.0.0", workers=3)
    assert artefacts.digest(again.path) == merged.digest
    assert not merge_releases(MERGED, parents, again.path).made


@pytest.mark.slow
def test_an_interrupted_merge_goes_on(
    parents: Parents, merged: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "1.0.0"
    with monkeypatch.context() as patch:
        patch.setattr("gym_open.datasets.derived.complete", killed)
        with pytest.raises(KeyboardInterrupt):
            merge_releases(MERGED, parents, out)
    assert not out.exists()
    assert artefacts.digest(merge_releases(MERGED, parents, out).path) == merged.digest


def test_what_does_not_go_together_is_named(parents: Parents, make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((3, 4),), seed=8)
    video = build_release(
        ReleaseConfig(**{**_plain(CONFIG), "pictures": "video"}), [log], tmp_path / "video/1.0.0"
    ).path
    with pytest.raises(UsageError, match=r"differ in the feature 'observation\.image'"):
        merge_releases(MERGED, [parents.one, video], tmp_path / "out/1.0.0")
    longer = build_release(
        ReleaseConfig(**{**_plain(CONFIG), "max_episode_steps": 5}), [make_log(lengths=((3,),))], tmp_path / "l/1.0.0"
    )
    with pytest.raises(UsageError, match="max_episode_steps 4"):
        merge_releases(MERGED, [parents.one, longer.path], tmp_path / "out/1.0.0")
    with pytest.raises(UsageError, match="its episode 0 is episode 0 of"):
        merge_releases(MERGED, [parents.one, parents.one], tmp_path / "out/1.0.0")
    with pytest.raises(UsageError, match="got none"):
        merge_releases(MERGED, [], tmp_path / "out/1.0.0")
    with pytest.raises(ArtefactError, match="kind 'release'"):
        merge_releases(MERGED, [log], tmp_path / "out/1.0.0")
    assert not (tmp_path / "out").exists()


def test_a_version_is_not_changed(parents: Parents, merged: Release) -> None:
    with pytest.raises(UsageError, match="never changed"):
        merge_releases(MERGED, [parents.one], merged.root)


@pytest.mark.slow
def test_appended_releases_are_merged_each_split_in_one_piece(
    make_log: MakeLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    logs = [make_log(lengths=((5, 9, 3), (6, 2, 4)), seed=seed) for seed in (1, 2)]
    build_release(CONFIG, logs[:1], tmp_path / "one/1.0.0")
    minor = ReleaseConfig(**{**_plain(CONFIG), "version": "1.1.0"})
    appended = open_release(build_release(minor, logs[1:], tmp_path / "one/1.1.0", append=True).path)
    merged = open_release(merge_releases(MERGED, [appended.root], tmp_path / "both/1.0.0").path)
    assert verify_release(merged.root, replay=False).problems == []
    assert appended.table("streams")["log"].tolist() == [0, 0, 0, 0]  # each batch has its own
    assert merged.table("streams")["log"].tolist() == [0, 0, 1, 1]
    order = np.argsort(appended.episodes["split"].to_numpy() == "val", kind="stable")
    keys = ["stream", "segment", "piece", "split"]
    assert merged.episodes[keys].to_numpy().tolist() == appended.episodes[keys].to_numpy()[order].tolist()


@pytest.mark.slow
def test_streams_that_were_held_out_are_found_under_their_new_numbers(
    make_log: MakeLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    made = []
    for seed in (1, 2):
        config = ReleaseConfig(**{**_plain(CONFIG), "split_by": "stream", "seed": seed})
        log = make_log(lengths=((5, 3), (6, 2), (4,)), seed=seed)
        made.append(open_release(build_release(config, [log], tmp_path / f"{seed}/1.0.0").path))
    merged = open_release(merge_releases(MERGED, [one.root for one in made], tmp_path / "both/1.0.0").path)
    held = [int(stream) + 3 * i for i, one in enumerate(made) for stream in one.info["gym_open"]["val"]]
    assert merged.info["gym_open"]["val"] == sorted(map(str, held))
    assert {row["stream"] for row in rows(merged) if row["split"] == "val"} == set(held)
    assert verify_release(merged.root, replay=False).problems == []


@pytest.mark.slow
def test_parts_of_rewards_are_not_a_number_where_another_played(
    parents: Parents, make_log: MakeLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    log = make_log(lengths=((3, 4),), seed=8, reward_parts=("forward",))
    parts = open_release(build_release(CONFIG, [log], tmp_path / "parts/1.0.0").path)
    merged = open_release(merge_releases(MERGED, [parents.one, parts.root], tmp_path / "both/1.0.0").path)
    theirs = np.isin(merged.column("episode_index"), np.flatnonzero(merged.episodes["stream"] == 3))
    assert theirs.sum() == len(parts)
    found = merged.column("reward_part.forward")
    assert np.isnan(found[~theirs]).all()
    np.testing.assert_array_equal(found[theirs], parts.column("reward_part.forward"))
    assert verify_release(merged.root, replay=False).problems == []


@pytest.mark.slow
def test_video_stays_as_it_was(make_log: MakeLog, tmp_path: Path) -> None:
    config = ReleaseConfig(**{**_plain(CONFIG), "pictures": "video"})
    video = open_release(build_release(config, [make_log()], tmp_path / "video/1.0.0").path)
    merged = open_release(merge_releases(MERGED, [video.root], tmp_path / "both/1.0.0").path)
    np.testing.assert_array_equal(merged.images(range(len(merged))), video.images(range(len(video))))
    assert merged.info["gym_open"]["video_error"] == video.info["gym_open"]["video_error"]


@pytest.mark.slow
def test_a_version_that_lies_is_refused(parents: Parents, tmp_path: Path) -> None:
    merge_releases(MERGED, [parents.one], tmp_path / "1.0.0")
    with pytest.raises(ArtefactError, match=r"makes it \d+\.\d+\.\d+"):
        merge_releases(MergeConfig(name="open/both", version="7.0.0"), parents, tmp_path / "7.0.0")
