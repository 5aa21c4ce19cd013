"""The reader for training: windows and batches compared with brute force, and caches that never return wrong data."""

import itertools
import pickle
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.releases import IMAGE, Release, open_release
from gym_open.formats.windows import Pictures, Windows

CONFIG = ReleaseConfig(val_fraction=0.34, max_episode_steps=7)
BLOCK_BYTES = 8 * 84 * 84 * 3
"""Size of a block: the tests' images are noise and do not compress."""


@pytest.fixture(scope="module")
def log(make_log: Callable[..., Path]) -> Path:
    return make_log(lengths=((9, 12, 3), (6, 7)), seed=11)


@pytest.fixture(scope="module")
def release(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, [log], tmp_path_factory.mktemp("r") / "release").path)


@pytest.fixture(scope="module")
def every(release: Release) -> np.ndarray:
    return release.images(range(len(release)))


@pytest.fixture(scope="module")
def pictures(release: Release) -> Pictures:
    return Pictures(release)


def brute_force(release: Release, split: str, length: int, stride: int) -> list[list[int]]:
    """Frame numbers of every window, found by brute force."""
    found = []
    for row in release.episodes.to_dict("records"):
        if row["split"] == split:
            first, stop = row["dataset_from_index"], row["dataset_to_index"]
            windows = [list(range(start, start + length * stride, stride)) for start in range(first, stop)]
            found += [window for window in windows if window[-1] < stop]
    return found


@given(split=st.sampled_from(["train", "val"]), length=st.integers(1, 8), stride=st.integers(1, 3))
def test_windows_are_all_that_lie_within_an_episode(pictures: Pictures, split: str, length: int, stride: int) -> None:
    expected = brute_force(pictures.release, split, length, stride)
    if not expected:
        with pytest.raises(
            ArtefactError, match=f"split '{split}' has no episode of {(length - 1) * stride + 1} frames"
        ):
            Windows(pictures, split, length, stride=stride)
        return
    windows = Windows(pictures, split, length, stride=stride)
    assert len(windows) == len(expected)
    assert windows.frames(np.arange(len(windows))).tolist() == expected


def test_values_are_those_of_the_release(pictures: Pictures, every: np.ndarray) -> None:
    release = pictures.release
    windows = Windows(pictures, "train", 4, stride=2, features=["observation.state", "reward.intrinsic"])
    numbers = np.random.default_rng(0).permutation(len(windows))
    batch, frames = windows.fetch(numbers), windows.frames(numbers)
    assert batch[IMAGE].dtype == np.uint8
    assert np.array_equal(batch[IMAGE], every[frames])
    assert batch["action.index"].dtype == np.int64
    for name in ("action.index", "observation.state", "reward.intrinsic"):
        assert np.array_equal(batch[name], release.column(name)[frames], equal_nan=True)
    assert {name: values.shape[1:] for name, values in batch.items()} == {
        IMAGE: (4, 84, 84, 3), "action.index": (4,), "observation.state": (4, 13), "reward.intrinsic": (4,),
    }  # fmt: skip


def test_an_episodes_last_frame_has_no_action(pictures: Pictures) -> None:
    windows = Windows(pictures, "train", 3)
    actions, frames = (
        get(np.arange(len(windows))) for get in (lambda n: windows.fetch(n)["action.index"], windows.frames)
    )
    last = set(pictures.release.episodes["dataset_to_index"] - 1)
    assert np.array_equal(actions == -1, np.isin(frames, list(last)))
    assert (actions[:, :-1] >= 0).all()


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_same_seed_same_batches_whatever_the_workers(pictures: Pictures, workers: int) -> None:
    windows = Windows(pictures, "train", 2)
    rng, drawn = np.random.default_rng(3), np.random.default_rng(3)
    for batch in itertools.islice(windows.batches(rng, 5, workers=workers), 12):
        expected = windows.fetch(drawn.choice(len(windows), size=5, replace=False))
        assert all(np.array_equal(batch[name], expected[name]) for name in expected)


def test_an_interrupted_run_continues_with_skip(pictures: Pictures) -> None:
    windows = Windows(pictures, "train", 2)
    whole = list(itertools.islice(windows.batches(np.random.default_rng(4), 3, workers=2), 9))
    rest = list(itertools.islice(windows.batches(np.random.default_rng(4), 3, skip=4), 5))
    assert all(np.array_equal(a[IMAGE], b[IMAGE]) for a, b in zip(whole[4:], rest, strict=True))


def test_prefetching_is_bounded_and_ends_with_the_reader(pictures: Pictures, monkeypatch: pytest.MonkeyPatch) -> None:
    windows, fetched = Windows(pictures, "train", 2), itertools.count()
    original = Windows.fetch
    monkeypatch.setattr(Windows, "fetch", lambda self, numbers: (next(fetched), original(self, numbers))[1])
    before = threading.active_count()
    batches = windows.batches(np.random.default_rng(0), 2, workers=2)
    for _ in range(3):
        next(batches)
    assert next(fetched) <= 3 + 2 * 2
    assert isinstance(batches, Iterator)
    batches.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before


@pytest.mark.parametrize("blocks", [0, 1, 3, 1000])
@pytest.mark.parametrize("disk", [False, True])
def test_any_limit_gives_the_same_images(
    release: Release, every: np.ndarray, tmp_path: Path, blocks: int, *, disk: bool
) -> None:
    limit = blocks * (BLOCK_BYTES + 100) + 100
    bounded = Pictures(release, cache=tmp_path / "cache" if disk else None, limit_bytes=limit)
    assert bounded.cached == min(blocks * 8, len(release))
    assert bounded.nbytes <= limit
    order = np.random.default_rng(0).permutation(len(release))[: len(release) // 2 * 2].reshape(2, -1)
    assert np.array_equal(bounded.take(order), every[order])
    assert bounded.take(np.empty((0, 3), dtype=np.int64)).shape == (0, 3, 84, 84, 3)
    if disk:
        assert sum(path.stat().st_size for path in (tmp_path / "cache").iterdir()) == bounded.nbytes


def test_the_limit_is_exact_to_the_byte(release: Release, pictures: Pictures) -> None:
    assert pictures.cached == len(release)
    assert Pictures(release, limit_bytes=pictures.nbytes).cached == len(release)
    less = Pictures(release, limit_bytes=pictures.nbytes - 1)
    assert less.cached < len(release)
    assert less.nbytes < pictures.nbytes


def test_the_cache_returns_images_of_a_video_as_decoded(log: Path, tmp_path: Path) -> None:
    config = msgspec.structs.replace(CONFIG, pictures="video")
    video = open_release(build_release(config, [log], tmp_path / "video").path)
    every = video.images(range(len(video)))
    assert np.array_equal(Pictures(video).take(np.arange(len(video))), every)
    windows = Windows(Pictures(video, limit_bytes=0), "val", 2)
    assert np.array_equal(windows[3][IMAGE], every[windows.frames(np.array([3]))[0]])


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of frames that are decoded from any release from now on."""
    counts: list[int] = []
    original = Release.images
    monkeypatch.setattr(Release, "images", lambda self, frames: (counts.append(len(frames)), original(self, frames))[1])
    return counts


def test_a_cache_is_made_once_per_release_and_limit(
    release: Release, every: np.ndarray, tmp_path: Path, decoded: list[int]
) -> None:
    Pictures(release, cache=tmp_path)
    assert sum(decoded) == len(release)
    again = Pictures(open_release(release.root), cache=tmp_path)
    assert np.array_equal(again.take(np.arange(len(release))), every)
    assert sum(decoded) == len(release)
    small = Pictures(release, cache=tmp_path, limit_bytes=2 * BLOCK_BYTES)
    assert small.cached == 8
    assert np.array_equal(again.take(np.arange(len(release))), every), "who reads the replaced file still has it"
    assert Pictures(release, cache=tmp_path).cached == len(release)
    assert [path.name for path in tmp_path.iterdir() if path.name[0] != "."] == [f"{release.digest}.frames"]


def test_another_release_at_the_same_path_never_gets_the_old_images(
    release: Release, make_log: Callable[..., Path], tmp_path: Path
) -> None:
    root, cache = tmp_path / "release", tmp_path / "cache"
    shutil.copytree(release.root, root)
    Pictures(open_release(root), cache=cache)
    shutil.rmtree(root)
    other = build_release(CONFIG, [make_log(lengths=((9, 12, 3), (6, 7)), seed=12)], root).path
    found = Pictures(open_release(other), cache=cache)
    assert np.array_equal(found.take(np.arange(9)), open_release(other).images(range(9)))


def test_a_release_that_changes_under_an_open_one_is_refused(
    release: Release, make_log: Callable[..., Path], tmp_path: Path
) -> None:
    root = Path(shutil.copytree(release.root, tmp_path / "release"))
    opened = open_release(root)
    sent = pickle.dumps(Pictures(opened, cache=tmp_path / "cache"))
    shutil.rmtree(root)
    build_release(CONFIG, [make_log(lengths=((9, 12, 3),), seed=12)], root)
    for use in (lambda: Pictures(opened), lambda: pickle.loads(sent)):
        with pytest.raises(ArtefactError, match="has changed since it was opened"):
            use()


def test_every_byte_is_checked_before_a_cache_is_made(release: Release, tmp_path: Path) -> None:
    root = Path(shutil.copytree(release.root, tmp_path / "release"))
    opened = open_release(root)
    file = next(root.glob("data/**/*.parquet"))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(ArtefactError, match=file.name):
        Pictures(opened, cache=tmp_path / "cache")
    assert [path.suffix for path in (tmp_path / "cache").iterdir()] == [".lock"]


def test_an_incomplete_cache_is_never_used(
    release: Release, every: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tmp_path / "whole"
    Pictures(release, cache=whole)
    data = (whole / f"{release.digest}.frames").read_bytes()
    cut = tmp_path / "cut"
    cut.mkdir()
    for length in (0, 10, len(data) // 2, len(data) - 1):
        (cut / f"{release.digest}.frames").write_bytes(data[:length])
        (cut / f".{release.digest}.partial").write_bytes(data[:length])
        found = Pictures(release, cache=cut)
        assert np.array_equal(found.take(np.arange(len(release))), every)

    class KilledError(Exception):
        pass

    def killed(*_: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(Release, "images", killed)
        with pytest.raises(KilledError):
            Pictures(release, cache=tmp_path / "none")
    assert [path.suffix for path in (tmp_path / "none").iterdir()] == [".lock"]


def test_a_byte_that_changes_in_the_cache_is_found(release: Release, every: np.ndarray, tmp_path: Path) -> None:
    Pictures(release, cache=tmp_path)
    path = tmp_path / f"{release.digest}.frames"
    good, rng = path.read_bytes(), np.random.default_rng(0)
    for at in rng.integers(0, len(good), size=20):
        bad = bytearray(good)
        bad[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        try:
            found = Pictures(release, cache=tmp_path).take(np.arange(len(release)))
        except ArtefactError as error:
            assert "remove this cache" in str(error)  # noqa: PT017
        else:
            assert np.array_equal(found, every)


def test_two_at_once_make_one_cache(release: Release, every: np.ndarray, tmp_path: Path, decoded: list[int]) -> None:
    start = threading.Barrier(3)

    def read() -> np.ndarray:
        own = open_release(release.root)
        start.wait()
        return Pictures(own, cache=tmp_path).take(np.arange(len(own)))

    with ThreadPoolExecutor(3) as pool:
        futures = [pool.submit(read) for _ in range(3)]
    assert all(np.array_equal(future.result(), every) for future in futures)
    assert sum(decoded) == len(release)


def test_a_full_disk_is_a_clear_error(release: Release, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtefactError, match="give another cache folder"):
        Pictures(release, cache=tmp_path / "file")


def test_windows_can_be_sent_to_other_processes_with_a_cache_on_disk(
    release: Release, pictures: Pictures, tmp_path: Path
) -> None:
    windows = Windows(Pictures(release, cache=tmp_path), "train", 3)
    copy = pickle.loads(pickle.dumps(windows))
    assert np.array_equal(copy[5][IMAGE], windows[5][IMAGE])
    assert len(pickle.dumps(windows)) < 10_000
    with pytest.raises(TypeError, match="cache folder"):
        pickle.dumps(Windows(pictures, "train", 3))


def test_wrong_use_is_refused(pictures: Pictures) -> None:
    windows = Windows(pictures, "train", 3)
    for number in (-1, len(windows)):
        with pytest.raises(IndexError, match=str(number)):
            windows[number]
    for frame in (-1, len(pictures)):
        with pytest.raises(IndexError, match=str(frame)):
            pictures.take(np.array([0, frame]))
    for size, workers in ((0, 1), (len(windows) + 1, 1), (1, 0)):
        with pytest.raises(UsageError, match=r"batch_size must be in \[1, "):
            windows.batches(np.random.default_rng(0), size, workers=workers)
    with pytest.raises(UsageError, match="at least 1, got 0 and 1"):
        Windows(pictures, "train", 0)
    with pytest.raises(ArtefactError, match="'test'"):
        Windows(pictures, "test", 1)
    with pytest.raises(KeyError, match="reward"):
        Windows(pictures, "train", 1, features=["rewards"])


def test_reading_leaves_the_release_as_it_was(pictures: Pictures) -> None:
    assert artefacts.verify(pictures.release.root, "release") == pictures.release.digest
