"""A release holds what the logs hold, to the bit; LeRobot, pandas and our reader agree on it."""

import json
import os
import sys
import textwrap
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.config import decode
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, MergeConfig, ReleaseConfig
from gym_open.datasets.filter import filter_release
from gym_open.datasets.merge import merge_releases
from gym_open.datasets.writing.prepare import Prepared, prepare
from gym_open.datasets.writing.sources import SourceEpisode
from gym_open.errors import ArtefactError, ConfigError, UsageError
from gym_open.formats.logs.reader import log_files, open_logs
from gym_open.formats.logs.schemas import Segment
from tests.children import run

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
CONFIG = ReleaseConfig(max_episode_steps=5, val_fraction=0.34)


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log()


@pytest.fixture(scope="module")
def release(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, [log], tmp_path_factory.mktemp("release") / "release").path)


def segments(log: Path) -> dict[tuple[int, int], Segment]:
    return {(item.stream, item.index): item for one in open_logs(log) for item in one.segments()}


def episodes(release: Release) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in release.episodes.to_dict("records")]


def test_every_frame_is_the_logs(log: Path, release: Release) -> None:
    expected, seen = segments(log), set()
    valid, actions = release.column("transition.valid"), release.column("action.index")
    one_hot, everything = release.column("action"), release.column("observation.environment_state")
    for row in episodes(release):
        segment = expected[row["stream"], row["segment"]]
        first = row["first_step"] - segment.first_step
        frames = np.arange(row["dataset_from_index"], row["dataset_to_index"])
        assert np.array_equal(release.images(frames), segment.images[first : first + len(frames)])
        assert valid[frames].tolist() == [True] * row["steps"] + [False]
        played = segment.actions[first : first + row["steps"]]
        assert np.array_equal(actions[frames[:-1]], played)
        assert np.array_equal(one_hot[frames[:-1]].argmax(axis=1), played)
        assert one_hot[frames].sum(axis=1).tolist() == [1.0] * row["steps"] + [0.0]
        state = segment.object_state[first : first + len(frames)].astype(np.float32)
        assert np.array_equal(everything[frames], state.reshape(len(frames), -1))
        assert np.array_equal(release.column("observation.state")[frames], state[:, 0])
        for name, values in (
            ("reward.intrinsic", segment.intrinsic_reward),
            ("world_model.loss", segment.world_model_loss),
            ("policy.entropy", segment.policy_entropy),
            ("policy.value", segment.value),
        ):
            assert np.array_equal(
                release.column(name)[frames[:-1]], values[first : first + row["steps"]].astype(np.float32)
            )
        counts = [len(contacts) for contacts in segment.contacts[first : first + row["steps"]]]
        assert release.column("contact.count")[frames].tolist() == [*counts, 0]
        seen.update((row["stream"], row["segment"], first + i) for i in range(row["steps"]))
    assert seen == {(*key, i) for key, segment in expected.items() for i in range(len(segment.actions))}


def test_episodes_say_how_they_begin_and_end(log: Path, release: Release) -> None:
    keyframes = release.table("keyframes").set_index(["stream", "segment", "segment_step"])["integration_state"]
    told = release.table("segments").set_index(["stream", "segment"])
    for key, segment in segments(log).items():
        rows = [row for row in episodes(release) if (row["stream"], row["segment"]) == key]
        assert sum(row["steps"] for row in rows) == len(segment.actions)
        assert [row["piece"] for row in rows] == list(range(len(rows)))
        assert [row["ended"] for row in rows] == ["length_cap"] * (len(rows) - 1) + [segment.ended]
        assert [row["continued"] for row in rows] == [segment.continued] + [True] * (len(rows) - 1)
        assert {row["puzzle"] for row in rows} == {segment.puzzle.digest}
        assert segment.integration_state is not None
        assert np.array_equal(keyframes[*key, 0], segment.integration_state)
        assert (told.loc[key, "steps"], told.loc[key, "ended"]) == (len(segment.actions), segment.ended)
        assert (told.loc[key, "first_step"], told.loc[key, "continued"]) == (segment.first_step, segment.continued)


def test_nothing_terminates_and_ends_are_truncated(release: Release) -> None:
    frames = release.frames
    assert not release.column("next.done").any()
    assert not release.column("next.reward").any()
    for _, episode in frames.groupby("episode_index"):
        steps = len(episode) - 1
        assert episode["next.truncated"].tolist() == [False] * (steps - 1) + [True, True]
        assert np.allclose(episode["timestamp"], np.arange(steps + 1) * 0.04)


def test_splits_share_no_world(release: Release) -> None:
    rows = episodes(release)
    worlds = {name: {row["puzzle"] for row in rows if row["split"] == name} for name in ("train", "val")}
    assert len(worlds["val"]) == 1
    assert not worlds["train"] & worlds["val"]
    frames = np.concatenate([release.split("train"), release.split("val")])
    assert frames.tolist() == list(range(len(release)))
    assert {rows[i]["split"] for i in release.column("episode_index")[release.split("val")]} == {"val"}
    with pytest.raises(KeyError, match="releases have train, val"):
        release.split("test")


def test_statistics_are_numpys(release: Release) -> None:
    stats = json.loads((release.root / "meta/stats.json").read_text())
    assert set(stats) == set(release.info["features"])
    for name, entry in stats.items():
        if name == "observation.image":
            values = release.images(range(len(release))).reshape(-1, 3) / 255
        else:
            values = release.column(name).astype(np.float64).reshape(len(release), -1)
        for statistic in ("min", "max", "mean", "std"):
            expected = getattr(np, statistic)(values, axis=0)
            assert np.allclose(np.ravel(entry[statistic]), expected, rtol=1e-9, atol=1e-12), (name, statistic)
        assert entry["count"] == [len(release)]


def test_pandas_reads_it(release: Release) -> None:
    table = pd.read_parquet(release.root / "data")
    assert table.shape[0] == len(release)
    assert list(table["index"]) == list(range(len(release)))
    assert table["observation.image"].iloc[0]["bytes"] == release.pngs([0])[0]
    assert np.stack(table["action"].to_list()).shape == (len(release), 9)


LEROBOT = """
import os, sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
root, out = sys.argv[1:]
dataset = LeRobotDataset("open/explore-mini", root=root)
window = LeRobotDataset(
    "open/explore-mini", root=root, delta_timestamps={"observation.image": [-0.04, 0.0, 0.04], "action": [0.0, 0.04]}
)
items = [dataset[i] for i in range(len(dataset))]
np.savez(
    out,
    image=np.stack([item["observation.image"].numpy() for item in items]),
    action=np.stack([item["action"].numpy() for item in items]),
    truncated=np.array([bool(item["next.truncated"]) for item in items]),
    episode=np.array([int(item["episode_index"]) for item in items]),
    task=np.array([item["task"] for item in items]),
    length=np.array(dataset.meta.episodes["length"]),
    ended=np.array(dataset.meta.episodes["ended"]),
    fps=dataset.fps,
    middle=window[1]["observation.image"].numpy(),
    edge=window[0]["observation.image_is_pad"].numpy(),
    shape=window[1]["action"].numpy().shape,
    one=LeRobotDataset("open/explore-mini", root=root, episodes=[1])[0]["observation.image"].numpy(),
    mean=dataset.meta.stats["observation.image"]["mean"],
)
"""


@pytest.mark.slow  # test_loading has the short one
def test_plain_lerobot_loads_it_offline(release: Release, tmp_path: Path) -> None:
    offline = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hub"), "HF_DATASETS_OFFLINE": "1"}
    script, out = tmp_path / "load.py", tmp_path / "loaded.npz"
    script.write_text(textwrap.dedent(LEROBOT))
    words = [sys.executable, script, release.root, out]
    done = run(words, env={**os.environ, **offline}, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = np.load(out)
    images = release.images(range(len(release)))
    assert np.array_equal(np.round(loaded["image"] * 255).astype(np.uint8).transpose(0, 2, 3, 1), images)
    assert np.array_equal(loaded["action"], release.column("action"))
    assert np.array_equal(loaded["truncated"], release.column("next.truncated"))
    assert np.array_equal(loaded["episode"], release.column("episode_index"))
    assert loaded["length"].tolist() == release.episodes["length"].tolist()
    assert loaded["ended"].tolist() == release.episodes["ended"].tolist()
    assert set(loaded["task"]) == {"explore the sandbox: no task, no reward"}
    assert loaded["fps"] == 25
    assert np.array_equal(np.round(loaded["middle"] * 255).astype(np.uint8).transpose(0, 2, 3, 1), images[:3])
    assert loaded["edge"].tolist() == [True, False, False]
    assert loaded["shape"].tolist() == [2, 9]
    start = release.episodes["dataset_from_index"][1]
    assert np.array_equal(np.round(loaded["one"] * 255).astype(np.uint8).transpose(1, 2, 0), images[start])
    assert loaded["mean"].shape == (3, 1, 1)
    artefacts.verify(release.root, "release")  # LeRobot left nothing behind in it


@pytest.mark.parametrize("workers", [1, 5])
def test_same_logs_give_the_same_bytes_anywhere(workers: int, log: Path, release: Release, tmp_path: Path) -> None:
    again = build_release(CONFIG, [log], tmp_path / "deep" / "er" / "other", workers=workers)
    assert again.made
    assert artefacts.digest(again.path) == release.digest
    assert not build_release(CONFIG, [log], again.path).made
    text = b"".join(path.read_bytes() for path in again.path.rglob("*") if path.is_file())
    assert str(tmp_path).encode() not in text


def test_episodes_that_are_done_in_another_order_give_the_same_bytes(
    log: Path, release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[int] = []
    another_is_done = threading.Event()

    def first_after_another(episode: SourceEpisode, *, video: bool) -> Prepared:
        made, first_step = prepare(episode), episode.row["first_step"]
        if first_step == 0:
            another_is_done.wait()
        order.append(first_step)
        another_is_done.set()
        return made

    monkeypatch.setattr("gym_open.datasets.writing.writer.prepare", first_after_another)
    again = build_release(CONFIG, [log], tmp_path / "r", workers=4)
    assert order != sorted(order)
    assert artefacts.digest(again.path) == release.digest


def test_data_files_roll_at_a_size(make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((40, 35, 25),))  # 2.2 MB: noise does not compress
    config = ReleaseConfig(data_file_mb=1, max_episode_steps=10)
    rolled = open_release(build_release(config, [log], tmp_path / "r").path)
    files = sorted(rolled.root.glob("data/chunk-*/file-*.parquet"))
    assert [path.parent.name[-1] + path.stem[-1] for path in files] == ["00", "01", "10"]
    for path in files:
        chunk, file = int(path.parent.name[-3:]), int(path.stem[-3:])
        rows = [row for row in episodes(rolled) if (row["data/chunk_index"], row["data/file_index"]) == (chunk, file)]
        assert {row["split"] for row in rows} == {("train", "val")[chunk]}
        numbers = pd.read_parquet(path, columns=["index", "episode_index"])
        assert len(numbers) == sum(row["length"] for row in rows)
        assert sorted(set(numbers["episode_index"])) == [row["episode_index"] for row in rows]
    assert rolled.column("index").tolist() == list(range(len(rolled)))


def test_several_logs_are_one_release(make_log: MakeLog, tmp_path: Path) -> None:
    curl = make_log(explorer={"world_model": "curl", "reward": "ride"}, reward_parts=("error", "novelty"))
    plain = make_log(lengths=((7,),), seed=1, explorer={"world_model": "none", "reward": "none"})
    release = open_release(build_release(CONFIG, [plain, curl], tmp_path / "r").path)
    streams = release.table("streams")
    assert streams["stream"].tolist() == [0, 1, 2]
    assert streams["log"].tolist() == [0, 1, 1]
    assert streams["log_stream"].tolist() == [0, 0, 1]
    assert streams["explorer"].tolist() == ["random", "curl+ride", "curl+ride"]
    assert streams["seed"].tolist() == ["1", "0", "0"]
    assert streams["steps"].tolist() == [7, 24, 6]
    assert {row["explorer"] for row in episodes(release) if row["stream"] == 0} == {"random"}
    novelty, valid = release.column("reward_part.novelty"), release.column("transition.valid")
    for row in episodes(release):
        frames = np.arange(row["dataset_from_index"], row["dataset_to_index"])
        steps = np.arange(row["first_step"], row["first_step"] + row["steps"])
        expected = steps + 1.0 if row["stream"] else np.full(len(steps), np.nan)
        assert np.array_equal(novelty[frames][valid[frames]], expected.astype(np.float32), equal_nan=True)
        assert np.isnan(novelty[frames[-1]])


def test_a_part_of_a_reward_that_is_no_name_is_refused(make_log: MakeLog, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"'\.\./x' of a reward"):
        build_release(CONFIG, [make_log(lengths=((3,),), reward_parts=("../x",))], tmp_path / "r")


def test_every_keyframe_of_the_log_is_in_one_episode(make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((12, 5, 8),), keyframe_every=4)
    release = open_release(build_release(ReleaseConfig(max_episode_steps=8), [log], tmp_path / "r").path)
    table = release.table("keyframes")
    expected = {(s.index, k.segment_step): k.integration_state for s in segments(log).values() for k in s.keyframes}
    assert len(table) == len(expected) == 3 + 2 + 2
    for row in table.to_dict("records"):
        assert np.array_equal(row["integration_state"], expected[row["segment"], row["segment_step"]])
        episode = episodes(release)[row["episode_index"]]
        assert (episode["stream"], episode["segment"]) == (row["stream"], row["segment"])
        assert episode["piece"] * 8 + row["frame_index"] == row["segment_step"]
        assert 0 <= row["frame_index"] < episode["steps"]  # that of the cut is the first of the second piece
    assert (table["frame_index"] == 0).sum() == len(release.episodes)


def test_a_version_is_never_changed(log: Path, make_log: MakeLog, tmp_path: Path) -> None:
    out = build_release(CONFIG, [log], tmp_path / "1.0.0").path
    before = artefacts.digest(out)
    other = make_log(lengths=((3,),))
    with pytest.raises(UsageError, match="higher --version"):
        build_release(CONFIG, [other], out)
    assert artefacts.digest(out) == before
    replaced = build_release(CONFIG, [other], out, replace=True)
    assert replaced.earlier is not None
    assert artefacts.digest(replaced.earlier) == before


def test_without_a_world_model_its_loss_is_no_number_and_left_out(make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((4, 7),), world_model=False)
    random = open_release(build_release(CONFIG, [log], tmp_path / "r").path)
    assert np.isnan(random.column("world_model.loss")).all()
    stats = json.loads((random.root / "meta/stats.json").read_text())
    assert stats["world_model.loss"] == {"min": [0], "max": [0], "mean": [0], "std": [0], "count": [0]}
    assert stats["reward.intrinsic"]["count"] == [len(random)]
    assert all(np.isnan(losses).all() for losses in random.table("switches")["world_losses"][1:])


def test_a_cut_log_leaves_no_release(make_log: MakeLog, tmp_path: Path) -> None:
    log = make_log(lengths=((4, 3),), seed=3)
    ((file,),) = log_files(log)
    data = file.read_bytes()
    for at in np.random.default_rng(0).integers(0, len(data), size=10):
        file.write_bytes(data[:at])
        with pytest.raises(ArtefactError, match=r"stream-000-000\.mcap"):
            build_release(CONFIG, [log], tmp_path / "release")
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("workers", [0, -1])
def test_threads_are_one_or_more(workers: int, log: Path, release: Release, tmp_path: Path) -> None:
    for make in (
        lambda: build_release(CONFIG, [log], tmp_path / "r", workers=workers),
        lambda: merge_releases(MergeConfig(), [release.root], tmp_path / "r", workers=workers),
        lambda: filter_release(FilterConfig(), release.root, tmp_path / "r", workers=workers),
    ):
        with pytest.raises(UsageError, match=f"workers: expected 1 or more, got {workers}"):
            make()
    assert list(tmp_path.iterdir()) == []


def test_no_episode_is_longer_than_a_video_may_be(log: Path, tmp_path: Path) -> None:
    """An episode of T steps has T + 1 frames."""
    for steps in (25_000, 51_199):
        config = ReleaseConfig(pictures="video", max_episode_steps=steps)
        with pytest.raises(ConfigError, match="give 24999 or less"):
            build_release(config, [log], tmp_path / "r")
    assert list(tmp_path.iterdir()) == []
    build_release(ReleaseConfig(pictures="video", max_episode_steps=24_999), [log], tmp_path / "r")
    build_release(ReleaseConfig(pictures="png", max_episode_steps=51_199), [log], tmp_path / "p")


@pytest.mark.parametrize("field", ["name", "version", "published"])
@pytest.mark.parametrize("place", ["before", "within", "after"])
def test_no_control_character_passes_in_a_header(field: str, place: str) -> None:
    good = {"name": "open/explore", "version": "1.0.0", "published": "2026-11-21"}[field]
    at = {"before": 0, "within": 3, "after": len(good)}[place]
    assert decode({field: good}, ReleaseConfig, source="options")
    for character in [*map(chr, range(33)), "\x7f", "\x85", "\u2028", "\u202e", "'", '"', "$", "`", ";"]:
        with pytest.raises(ConfigError, match=field):
            decode({field: good[:at] + character + good[at:]}, ReleaseConfig, source="options")
