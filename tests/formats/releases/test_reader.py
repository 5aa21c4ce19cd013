"""The reader of releases: what it refuses, and that it returns each frame by its number."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.datasets import documents
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing import lerobot_files
from gym_open.datasets.writing.video import encode_clip
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import sha256_file
from gym_open.formats.releases import IMAGE, EpisodeData, Release, open_release, videos
from gym_open.formats.releases.layout import TABLES


@pytest.fixture(scope="module", params=["png", "video"])
def root(
    request: pytest.FixtureRequest, make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Two batches, in data files of one episode each."""
    out = tmp_path_factory.mktemp("r")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})  # figures take longer than all else
        patch.setattr(lerobot_files, "GROUP_ROWS", 3)
        for version, seed in (("1.0.0", 5), ("1.1.0", 6)):
            config = ReleaseConfig(version=version, max_episode_steps=4, pictures=request.param)
            log = make_log(lengths=((9, 4), (3,)), seed=seed, reward_parts=("forward",))
            build_release(config, [log], out / version, append=version == "1.1.0")
    return out / "1.1.0"


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "copy"))


@pytest.fixture(scope="module")
def release(root: Path) -> Release:
    return open_release(root)


def test_images_come_in_the_requested_order(release: Release) -> None:
    every = release.images(range(len(release)))
    assert every.shape == (len(release), 84, 84, 3)
    assert every.dtype == np.uint8
    order = [5, 0, 5, len(release) - 1]
    assert np.array_equal(release.images(np.array(order)), every[order])
    assert release.images([]).shape == (0, 84, 84, 3)


def test_single_frames_equal_those_read_together(release: Release) -> None:
    """In any row group, file and group of video frames."""
    every = release.images(range(len(release)))
    for index in np.random.default_rng(0).permutation(len(release)).tolist():
        assert np.array_equal(Release(release.root, "", release.info).images([index])[0], every[index])


def test_numbers_are_slices_of_the_columns(release: Release) -> None:
    columns = {name: release.column(name) for name in release.info["features"] if name != IMAGE}
    bounds = np.random.default_rng(1).integers(0, len(release), (20, 2))
    for first, last in np.sort(bounds, axis=1).tolist():
        found = release.numbers(first, last + 1)
        assert found.keys() == columns.keys()
        for name, array in found.items():
            assert np.array_equal(array, columns[name][first : last + 1], equal_nan=True), name
    with pytest.raises(IndexError, match=r"expected frames within \[0"):
        release.numbers(0, len(release) + 1)


def test_tables_of_all_batches_equal_those_of_pandas(release: Release) -> None:
    """pandas reads a folder of files by itself."""
    for name in TABLES:
        theirs = pd.read_parquet(release.root / f"meta/{name}")
        ours = release.table(name)
        assert len(ours) == len(theirs) > 0
        for column in theirs.columns:
            assert [str(value) for value in ours[column]] == [str(value) for value in theirs[column]], (name, column)
    theirs = pd.read_parquet(release.root / "meta/episodes")
    assert release.episodes["dataset_to_index"].tolist() == theirs["dataset_to_index"].tolist()
    assert not any(name.startswith("stats/") for name in release.episodes.columns)


def test_a_split_is_the_frames_of_its_episodes(release: Release) -> None:
    frames = release.frames
    for name in ("train", "val"):
        episodes = release.episodes.loc[release.episodes["split"] == name, "episode_index"]
        assert release.split(name).tolist() == np.flatnonzero(frames["episode_index"].isin(episodes)).tolist()
    both = np.concatenate([release.split("train"), release.split("val")])
    assert sorted(both.tolist()) == list(range(len(release)))
    with pytest.raises(KeyError, match="no split 'test'; releases have train, val"):
        release.split("test")
    with pytest.raises(KeyError, match="no table 'rewards'; releases have streams"):
        release.table("rewards")  # pyright: ignore[reportArgumentType]


def test_episodes_are_found_drawn_and_read(release: Release) -> None:
    every, table = release.images(range(len(release))), release.episodes
    train = release.filter_episodes(lambda row: row["split"] == "train")
    assert train.tolist() == table.loc[table["split"] == "train", "episode_index"].tolist()
    for episode, row in zip(release.iterate_episodes(), table.to_dict("records"), strict=True):
        span = slice(row["dataset_from_index"], row["dataset_to_index"])
        assert np.array_equal(episode.observations, every[span])
        assert episode.actions.tolist() == release.column("action.index")[span][:-1].tolist()
        assert episode.rewards.tolist() == release.column("reward.intrinsic")[span][:-1].tolist()
        assert (episode.id, len(episode.actions)) == (row["episode_index"], row["steps"])
    drawn = [[one.id for one in release.sample_episodes(2, np.random.default_rng(3), train)] for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert len({*drawn[0]} & {*train.tolist()}) == 2
    with pytest.raises(UsageError, match=f"n: expected 0 to {len(table)}, the number of episodes to draw from"):
        release.sample_episodes(len(table) + 1, np.random.default_rng(0))
    with pytest.raises(IndexError, match=rf"expected an episode within \[0, {len(table)}\), got {len(table)}"):
        next(release.iterate_episodes([len(table)]))


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ((5, 5, 5, 6), "expected one more observation than actions: got 5 observations and 5 actions"),
        ((6, 5, 6, 6), "expected one reward per action: got 6 rewards and 5 actions"),
        ((6, 5, 5, 5), "expected 6 rows of every feature: index has 5"),
    ],
)
def test_an_episode_whose_arrays_do_not_fit_is_refused(counts: tuple[int, int, int, int], said: str) -> None:
    observations, actions, rewards, rows = (np.zeros(count) for count in counts)
    with pytest.raises(ValueError, match=said):
        EpisodeData(0, observations, actions, rewards, {"index": rows})


def test_name_and_version(release: Release) -> None:
    assert (release.name, release.version) == ("open/explore", "1.1.0")


def test_png_files_exist_unless_images_are_video(release: Release) -> None:
    if release.info["gym_open"]["pictures"] == "video":
        with pytest.raises(ArtefactError, match="stores its images as video"):
            release.pngs([0])
    else:
        assert [data[:4] for data in release.pngs([3, 0])] == [b"\x89PNG"] * 2


@pytest.mark.parametrize("index", [-1, 10**6])
def test_a_frame_that_does_not_exist_is_refused(release: Release, index: int) -> None:
    with pytest.raises(IndexError, match=str(index)):
        release.images([0, index])


@pytest.mark.parametrize("name", ["reward", IMAGE])
def test_an_unknown_feature_is_refused_by_name(release: Release, name: str) -> None:
    with pytest.raises(KeyError, match=r"action\.index"):
        release.column(name)


def test_frames_hold_every_scalar(release: Release) -> None:
    assert len(release.frames) == len(release)
    assert {"action.index", "transition.valid", "next.truncated"} <= set(release.frames.columns)
    assert IMAGE not in release.frames.columns


def test_a_changed_record_is_found_and_named(copy: Path) -> None:
    """All files except data and videos, which `check="bytes"` reads."""
    rng = np.random.default_rng(0)
    files = [path for path in sorted(copy.rglob("*")) if path.is_file() and path.name != artefacts.MANIFEST]
    assert len(files) > 20
    for path in files:
        good = path.read_bytes()
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        bulk = path.relative_to(copy).parts[0] in {"data", "videos"}
        with pytest.raises(ArtefactError, match=path.name):
            open_release(copy, check="bytes" if bulk else "records")
        path.write_bytes(good)
    open_release(copy)


def test_a_missing_an_extra_and_a_shortened_file_are_named(copy: Path) -> None:
    stray = copy / "data/chunk-000/file-009.parquet"
    stray.write_bytes(b"x")
    with pytest.raises(ArtefactError, match=r"file-009\.parquet: not listed"):
        open_release(copy)
    stray.unlink()
    data = copy / "data/chunk-000/file-000.parquet"
    data.write_bytes(data.read_bytes()[:-1])
    with pytest.raises(ArtefactError, match=r"data/chunk-000/file-000\.parquet: .* bytes, manifest\.json says"):
        open_release(copy)
    (copy / "meta/stats.json").unlink()
    with pytest.raises(ArtefactError, match="data/chunk-000"):  # the first by name
        open_release(copy)


def test_another_kind_or_version_is_refused(copy: Path, make_log: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="'release', got 'log'"):
        open_release(make_log(lengths=((1,),)))
    with pytest.raises(ArtefactError, match="nowhere"):
        open_release(tmp_path / "nowhere")
    path = copy / "meta/info.json"
    info = json.loads(path.read_text())
    for change, words in (
        ({"codebase_version": "v2.1"}, r"must be 'v3\.0', got 'v2\.1'"),
        ({"gym_open": {}}, r"gym_open\.format must be 'gym-open-release/2', got 'None'"),
        ({"gym_open": 3}, r"gym_open\.format must be"),
    ):
        path.write_text(json.dumps({**info, **change}))
        manifest = json.loads((copy / artefacts.MANIFEST).read_text())
        manifest["meta/info.json"] = {"sha256": sha256_file(path), "bytes": path.stat().st_size}
        (copy / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(manifest))
        with pytest.raises(ArtefactError, match=words):
            open_release(copy)


@pytest.mark.parametrize("damage", ["cut", "other", "none", "short"])
def test_a_damaged_video_is_an_error_with_its_name(tmp_path: Path, damage: str) -> None:
    images = np.random.default_rng(0).integers(0, 256, (30, 84, 84, 3), dtype=np.uint8)
    path = tmp_path / "x.mp4"
    data = encode_clip(images)
    path.write_bytes(data)
    for first, stop in ((0, 30), (11, 14), (29, 30)):
        assert np.array_equal(list(videos.decode(path, first, stop)), images[first:stop])
    path.write_bytes({"cut": data[: len(data) // 2], "other": b"RIFF" + data[4:], "none": b"", "short": data}[damage])
    with pytest.raises(ArtefactError, match=r"x\.mp4: (cannot be decoded|ends after frame 30, expected 31)"):
        list(videos.decode(path, 0, 31))


def test_a_video_of_another_size_is_not_decoded(tmp_path: Path) -> None:
    import av
    from av.video.stream import VideoStream

    path = tmp_path / "x.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width, stream.pix_fmt = 128, 96, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((128, 96, 3), np.uint8), format="rgb24")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(ArtefactError, match=r"expected h264 of 84×84 pixels \(gbrp\), got h264 of 96×128"):
        next(videos.decode(path, 0, 1))
