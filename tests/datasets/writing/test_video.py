"""Video in LeRobot's layout: every frame where it is looked for, its error measured, the same bytes again."""

import os
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from av.container import InputContainer

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.video import VideoFile, decode_clip, encode_clip, pixel_error
from tests.children import run

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
CONFIG = ReleaseConfig(max_episode_steps=20, val_fraction=0.34, pictures="video")


def scene(frames: int, seed: int) -> np.ndarray:
    """A square that moves over a still ground, as in play."""
    rng = np.random.default_rng(seed)
    images = np.repeat(rng.integers(0, 256, (1, 84, 84, 3), dtype=np.uint8), frames, axis=0)
    for number, image in enumerate(images):
        image[number % 70 : number % 70 + 4, 10:14] = rng.integers(0, 256, 3)
    return images


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log(lengths=((30, 9, 4), (6,)))


@pytest.fixture(scope="module")
def release(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, [log], tmp_path_factory.mktemp("r") / "video").path)


@pytest.fixture(scope="module")
def plain(log: Path, release: Release) -> Release:
    config = ReleaseConfig(max_episode_steps=20, val_fraction=0.34)
    return open_release(build_release(config, [log], release.root.with_name("png")).path)


@pytest.mark.parametrize("frames", [1, 2, 40])
def test_a_clip_loses_nothing(frames: int) -> None:
    images = scene(frames, seed=frames)
    assert np.array_equal(decode_clip(encode_clip(images)), images)
    assert encode_clip(images) == encode_clip(images.copy())


def test_clips_are_joined_frame_by_frame(tmp_path: Path) -> None:
    clips = [scene(frames, seed) for seed, frames in enumerate((13, 1, 30, 12))]
    file = VideoFile(tmp_path / "a.mp4")
    for clip in clips:
        file.add(encode_clip(clip))
    file.close()
    assert file.frames == 56
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert isinstance(container, InputContainer)
        stream = container.streams.video[0]
        assert stream.frames == 56
        assert [frame.time for frame in container.decode(stream)] == pytest.approx(np.arange(56) / 25)
        assert stream.duration is not None
        assert stream.time_base is not None
        assert float(stream.duration * stream.time_base) == pytest.approx(56 / 25)
    assert np.array_equal(decode_clip((tmp_path / "a.mp4").read_bytes()), np.concatenate(clips))


def test_the_error_is_numpys() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 256, (2, 5, 84, 84, 3), dtype=np.uint8)
    difference = a.astype(float) - b.astype(float)
    error = pixel_error(a, b)
    assert error["mean"] == pytest.approx(np.abs(difference).mean())
    assert error["max"] == np.abs(difference).max()
    assert error["mse"] == pytest.approx((difference**2).mean())


def test_the_error_is_on_record(release: Release, monkeypatch: pytest.MonkeyPatch, log: Path, tmp_path: Path) -> None:
    assert release.info["gym_open"]["video_error"] == {"mean": 0.0, "max": 0.0, "psnr": None}
    monkeypatch.setattr(
        "gym_open.datasets.writing.prepare.encode_clip",
        lambda images, coding: encode_clip(images ^ np.uint8(8 if len(images) == 21 else 2), coding),
    )
    worse = open_release(build_release(CONFIG, [log], tmp_path / "worse").path)
    error, off = worse.info["gym_open"]["video_error"], np.where(worse.episodes["length"] == 21, 8, 2)
    weights = worse.episodes["length"] / worse.episodes["length"].sum()
    assert set(off) == {2, 8}
    assert error["mean"] == pytest.approx(weights @ off)
    assert error["max"] == 8
    assert error["psnr"] == pytest.approx(20 * np.log10(255) - 10 * np.log10(weights @ off**2))


def test_it_holds_what_the_png_release_holds(release: Release, plain: Release) -> None:
    everything = range(len(plain))
    assert np.array_equal(release.images(everything), plain.images(everything))
    assert np.array_equal(release.column("action"), plain.column("action"))
    assert release.table("content").equals(plain.table("content"))
    assert "observation.image" not in (release.root / "data/chunk-000/file-000.parquet").read_bytes().decode("latin1")
    ends = release.episodes["videos/observation.image/to_timestamp"]
    begins = release.episodes["videos/observation.image/from_timestamp"]
    assert np.allclose((ends - begins) * 25, release.episodes["length"])


@pytest.mark.parametrize("workers", [1, 4])
def test_same_bytes_again(workers: int, log: Path, release: Release, tmp_path: Path) -> None:
    again = build_release(CONFIG, [log], tmp_path / "again", workers=workers)
    assert artefacts.digest(again.path) == release.digest


def test_a_file_is_no_longer_than_times_are_exact(
    log: Path, release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.datasets.writing.tracks.MAX_FRAMES", 25)
    short = open_release(build_release(CONFIG, [log], tmp_path / "short").path)
    lengths = short.episodes.groupby(["data/chunk_index", "data/file_index"])["length"].sum()
    assert lengths.max() <= 25
    assert len(list(short.root.glob("videos/**/*.mp4"))) == len(lengths) > 2
    assert np.array_equal(short.images(range(len(short))), release.images(range(len(release))))


def test_an_append_takes_the_videos_over(release: Release, make_log: MakeLog, tmp_path: Path) -> None:
    config = ReleaseConfig(max_episode_steps=20, val_fraction=0.34, pictures="video", version="1.1.0")
    more = make_log(lengths=((8, 3),), seed=1)
    both = open_release(build_release(config, [more], tmp_path / "r", previous=release.root, append=True).path)
    old = sorted(release.root.glob("videos/**/*.mp4"))
    assert len(sorted(both.root.glob("videos/**/*.mp4"))) > len(old)
    for path in old:
        assert (both.root / path.relative_to(release.root)).read_bytes() == path.read_bytes()
    assert np.array_equal(both.images(range(len(release))), release.images(range(len(release))))
    assert len(both.images(range(len(release), len(both)))) == 13
    assert both.info["gym_open"]["video_error"]["max"] == 0


LEROBOT = """
import sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
root, out = sys.argv[1:]
dataset = LeRobotDataset(
    "open/explore", root=root, video_backend="pyav", delta_timestamps={"observation.image": [-0.04, 0.0]}
)
np.save(out, np.stack([dataset[i]["observation.image"].numpy() for i in range(len(dataset))]))
"""


@pytest.mark.slow
def test_plain_lerobot_decodes_the_logged_pixels(release: Release, tmp_path: Path) -> None:
    offline = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hub"), "HF_DATASETS_OFFLINE": "1"}
    script, out = tmp_path / "load.py", tmp_path / "loaded.npy"
    script.write_text(textwrap.dedent(LEROBOT))
    words = [sys.executable, script, release.root, out]
    done = run(words, env={**os.environ, **offline}, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = np.round(np.load(out) * 255).astype(np.uint8).transpose(0, 1, 3, 4, 2)
    images = release.images(range(len(release)))
    assert np.array_equal(loaded[:, 1], images)
    first = np.isin(np.arange(len(images)), release.episodes["dataset_from_index"])
    assert np.array_equal(loaded[~first, 0], images[np.flatnonzero(~first) - 1])
    artefacts.verify(release.root, "release")
