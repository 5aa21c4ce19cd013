"""The reader of releases: what it refuses, and that it gives each frame by its number."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import ArtefactError
from gym_open.formats.releases import IMAGE, Release, open_release


@pytest.fixture(scope="module")
def root(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = make_log(lengths=((9, 4), (3,)), seed=5)
    return build_release(ReleaseConfig(max_episode_steps=4), log, tmp_path_factory.mktemp("r") / "release").path


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "copy"))


@pytest.fixture(scope="module")
def release(root: Path) -> Release:
    return open_release(root)


def test_images_come_in_the_order_asked_for(release: Release) -> None:
    every = release.images(range(len(release)))
    assert every.shape == (len(release), 84, 84, 3)
    assert every.dtype == np.uint8
    order = [5, 0, 5, len(release) - 1]
    assert np.array_equal(release.images(np.array(order)), every[order])
    assert release.images([]).shape == (0, 84, 84, 3)


def test_images_of_many_row_groups(release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut into groups of three rows, the same frames come back."""
    import pyarrow.parquet as pq

    every = release.images(range(len(release)))
    path = release.root / "data/chunk-000/file-000.parquet"
    other = release.root.parent / "data/chunk-000/file-000.parquet"
    other.parent.mkdir(parents=True)
    pq.write_table(pq.read_table(path), other, row_group_size=3)
    regrouped = Release(release.root.parent, "", release.info)
    order = np.random.default_rng(0).permutation(len(release))
    assert np.array_equal(regrouped.images(order), every[order])


@pytest.mark.parametrize("index", [-1, 10**6])
def test_a_frame_that_is_not_there_is_refused(release: Release, index: int) -> None:
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


def test_any_flipped_byte_is_found_and_named(copy: Path) -> None:
    rng = np.random.default_rng(0)
    files = [path for path in sorted(copy.rglob("*")) if path.is_file() and path.name != artefacts.MANIFEST]
    assert len(files) > 10
    for path in files:
        good = path.read_bytes()
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        with pytest.raises(ArtefactError, match=path.name):
            open_release(copy)
        path.write_bytes(good)
    open_release(copy)


def test_a_missing_and_an_extra_file_are_named(copy: Path) -> None:
    (copy / "data/chunk-000/file-001.parquet").write_bytes(b"x")
    with pytest.raises(ArtefactError, match=r"file-001\.parquet: not listed"):
        open_release(copy)
    (copy / "data/chunk-000/file-001.parquet").unlink()
    (copy / "meta/stats.json").unlink()
    with pytest.raises(ArtefactError, match=r"stats\.json: missing"):
        open_release(copy)


def test_another_kind_or_version_is_refused(copy: Path, make_log: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="'release', got 'log'"):
        open_release(make_log(lengths=((1,),)))
    with pytest.raises(ArtefactError, match="nowhere"):
        open_release(tmp_path / "nowhere")
    path = copy / "meta/info.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps({**info, "codebase_version": "v2.1"}))
    manifest = json.loads((copy / artefacts.MANIFEST).read_text())
    manifest["meta/info.json"] = {"sha256": artefacts.sha256_file(path), "bytes": path.stat().st_size}
    (copy / artefacts.MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(ArtefactError, match=r"must be 'v3\.0', got 'v2\.1'"):
        open_release(copy)
