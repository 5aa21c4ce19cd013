"""What is exported loads with NumPy and Minari alone, and says what the release says."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.export import export_minari, export_npz
from gym_open.errors import ArtefactError, UsageError

pytestmark = pytest.mark.usefixtures("no_figures")


@pytest.fixture(scope="module")
def release(make_log: Callable[..., Path], no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Release:
    log = make_log(lengths=((5, 9, 3), (4,)), reward_parts=("forward",))
    out = tmp_path_factory.mktemp("release") / "1.0.0"
    return open_release(build_release(ReleaseConfig(max_episode_steps=4), [log], out).path)


@pytest.mark.parametrize("split", ["train", "val"])
def test_numpy_holds_what_the_release_holds(release: Release, tmp_path: Path, split: str) -> None:
    out = export_npz(release.root, split, tmp_path / f"{split}.npz")
    frames = release.split(split)
    with np.load(out, allow_pickle=False) as loaded:
        episodes = release.episodes[release.episodes["split"] == split]
        assert set(loaded) == {*release.info["features"], "episode_starts", "episode_explorer", "episode_puzzle"}
        for name in loaded:
            if name == "observation.image":
                np.testing.assert_array_equal(loaded[name], release.images(frames))
            elif name in release.info["features"]:
                np.testing.assert_array_equal(loaded[name], release.column(name)[frames])
                assert loaded[name].dtype == release.info["features"][name]["dtype"]
        starts = loaded["episode_starts"]
        assert (starts[0], starts[-1]) == (0, len(frames))
        assert np.diff(starts).tolist() == episodes["length"].tolist()
        assert loaded["episode_puzzle"].tolist() == episodes["puzzle"].tolist()
        assert loaded["episode_explorer"].tolist() == episodes["explorer"].tolist()
        assert not loaded["transition.valid"][starts[1:] - 1].any()
    assert [item.name for item in tmp_path.iterdir()] == [out.name]
    again = export_npz(release.root, split, tmp_path / "again.npz")
    assert again.read_bytes() == out.read_bytes()


def test_minari_loads_it(release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import minari

    monkeypatch.chdir(tmp_path)
    assert export_minari(release.root, "val", Path("minari"), "open/explore-val-v1").is_dir()
    out = export_minari(release.root, "train", Path("minari"), "open/explore-v1")
    assert out == Path("minari/open/explore-v1")
    with pytest.raises(UsageError, match="open/explore-v1: exists"):
        export_minari(release.root, "train", Path("minari"), "open/explore-v1")
    monkeypatch.setenv("MINARI_DATASETS_PATH", "minari")
    dataset = minari.load_dataset("open/explore-v1")
    rows = release.episodes[release.episodes["split"] == "train"].to_dict("records")
    assert dataset.total_episodes == len(rows)
    assert dataset.total_steps == sum(row["steps"] for row in rows)
    assert dataset.spec.action_space == gymnasium.spaces.Discrete(9)
    for episode, row in zip(dataset.iterate_episodes(), rows, strict=True):
        frames = np.arange(row["dataset_from_index"], row["dataset_to_index"])
        steps = frames[:-1]
        assert len(episode) == row["steps"]
        np.testing.assert_array_equal(episode.observations["image"], release.images(frames))
        for name in ("state", "environment_state"):
            np.testing.assert_array_equal(episode.observations[name], release.column(f"observation.{name}")[frames])
        np.testing.assert_array_equal(episode.actions, release.column("action.index")[steps])
        assert not episode.rewards.any()
        assert not episode.terminations.any()
        assert episode.truncations.tolist() == [False] * (row["steps"] - 1) + [True]
        for name in ("reward.intrinsic", "reward_part.forward", "contact.count"):
            np.testing.assert_array_equal(episode.infos[name][1:], release.column(name)[steps])
        observation = {name: values[0] for name, values in episode.observations.items()}
        assert dataset.spec.observation_space.contains(observation)
    told = list(dataset.storage.get_episode_metadata(range(len(rows))))
    assert [item["puzzle"] for item in told] == [row["puzzle"] for row in rows]
    assert set(minari.list_local_datasets()) == {"open/explore-v1", "open/explore-val-v1"}


def test_what_cannot_be_exported_leaves_nothing(release: Release, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="no split 'test' there; it has train, val"):
        export_npz(release.root, "test", out)
    for dataset_id in ("../evil-v1", "no version", "/etc/passwd-v1"):
        with pytest.raises(UsageError, match="NAMESPACE/NAME-vN"):
            export_minari(release.root, "train", out, dataset_id)
    out.write_text("mine")
    for export in (
        lambda: export_npz(release.root, "train", out),
        lambda: export_minari(release.root, "val", out, "a-v1"),
    ):
        with pytest.raises(UsageError, match="exists"):
            export()
    assert out.read_text() == "mine"
    assert [item.name for item in tmp_path.iterdir()] == ["out"]


def test_an_interrupted_export_leaves_nothing(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Release, "images", killed)
    for export in (
        lambda: export_npz(release.root, "train", tmp_path / "out.npz"),
        lambda: export_minari(release.root, "train", tmp_path / "out", "a-v1"),
    ):
        with pytest.raises(KeyboardInterrupt):
            export()
        assert list(tmp_path.iterdir()) == []


def test_a_damaged_release_is_not_exported(release: Release, tmp_path: Path) -> None:
    import shutil

    root = Path(shutil.copytree(release.root, tmp_path / "1.0.0"))
    path = next(root.glob("data/*/*.parquet"))
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    with pytest.raises(ArtefactError, match=r"file-000\.parquet"):
        export_npz(root, "train", tmp_path / "out.npz")


def test_members_are_plain(release: Release, tmp_path: Path) -> None:
    with zipfile.ZipFile(export_npz(release.root, "val", tmp_path / "val.npz")) as file:
        assert file.testzip() is None
        assert {item.date_time for item in file.infolist()} == {(1980, 1, 1, 0, 0, 0)}
