"""A release that was packed comes back in every byte."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.compact import restore
from gym_open.datasets.compact.overview import compact_table, sizes_of
from gym_open.datasets.compact.pack import pack_release
from gym_open.datasets.compact.restore import restore_release
from gym_open.datasets.config import FilterConfig, MergeConfig, ReleaseConfig
from gym_open.datasets.filter import filter_release
from gym_open.datasets.merge import merge_releases
from gym_open.datasets.verify import run, verify_release
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.compact import open_compact
from gym_open.formats.releases import open_release
from gym_open.formats.releases.features import learned
from tests.conftest import MakeLog


def all_bytes(root: Path) -> dict[str, bytes]:
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def round_trip(release: Path, folder: Path, workers: int = 2) -> Path:
    packed = pack_release(release, folder / "compact").path
    found = restore_release(packed, folder / "back", workers=workers)
    assert (found.made, found.different) == (True, [])
    assert all_bytes(found.path) == all_bytes(release)
    return packed


@pytest.mark.parametrize("workers", [1, 3])
def test_all_bytes_come_back(release: Path, packed: Path, tmp_path: Path, workers: int) -> None:
    found = restore_release(packed, tmp_path / "back", workers=workers)
    assert (found.made, found.different) == (True, [])
    assert all_bytes(found.path) == all_bytes(release)
    assert not restore_release(packed, tmp_path / "back").made
    assert sorted(path.name for path in tmp_path.iterdir()) == ["back"]


def test_it_begins_episodes_in_every_way_that_needs_no_state(packed: Path) -> None:
    compact = open_compact(packed)
    assert {row.start for row in compact.episodes} == {"layout", "episode", "world"}
    assert not compact.states
    assert {"reward.intrinsic", "world_model.loss"} < set(compact.columns)


def test_packing_twice_gives_the_same_bytes(release: Path, packed: Path, tmp_path: Path) -> None:
    again = pack_release(release, tmp_path / "again", workers=1).path
    assert all_bytes(again) == all_bytes(packed)


def test_appended_batches_come_back(random_log: Path, learned_log: Path, tmp_path: Path) -> None:
    config = ReleaseConfig(name="open/grown", max_episode_steps=16, val_fraction=0.4)
    with_parts = build_release(config, [learned_log], tmp_path / "grown" / "1.0.0").path
    later = ReleaseConfig(name="open/grown", version="1.1.0", max_episode_steps=16, val_fraction=0.4)
    grown = build_release(later, [random_log], tmp_path / "grown" / "1.1.0", append=True, previous=with_parts).path
    packed = round_trip(grown, tmp_path)
    assert {row.batch for row in open_compact(packed).streams} == {0, 1}


def test_merged_video_and_smaller_releases_come_back(
    release: Path, learned_log: Path, random_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = (
        build_release(ReleaseConfig(name=f"open/{name}", max_episode_steps=12), [log], tmp_path / name).path
        for name, log in (("one", learned_log), ("other", random_log))
    )
    round_trip(merge_releases(MergeConfig(name="open/merged"), [one, other], tmp_path / "m").path, tmp_path / "a")
    film = ReleaseConfig(name="open/film", max_episode_steps=12, pictures="video")
    round_trip(build_release(film, [random_log], tmp_path / "film").path, tmp_path / "b")
    smaller = FilterConfig(name="open/small", explorer=("icm+ride",), leave_out=("explorer",))
    small = filter_release(smaller, release, tmp_path / "small").path
    opened = open_release(small)
    assert not learned(opened.info["features"])
    assert "world_losses" not in opened.table("switches")
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)  # a process that takes seconds to start
    assert verify_release(small, replay=False).problems == []
    assert not list((round_trip(small, tmp_path / "c") / "columns").glob("*"))


def test_gaps_begin_with_stored_states(release: Path, tmp_path: Path) -> None:
    """Of a segment's pieces at steps 0 and 12, with states at 0 and 8, the second needs the first."""
    config = FilterConfig(name="open/gaps", split=("val",))
    round_trip(filter_release(config, release, tmp_path / "val").path, tmp_path / "a")
    chosen = FilterConfig(name="open/gaps", min_contact=0.3)
    with pytest.raises(ArtefactError, match="begins in a state that the release does not have"):
        pack_release(filter_release(chosen, release, tmp_path / "gaps").path, tmp_path / "b")


def test_episodes_without_those_before_them_begin_with_a_state(random_log: Path, tmp_path: Path) -> None:
    whole = build_release(ReleaseConfig(name="open/whole", max_episode_steps=8), [random_log], tmp_path / "whole").path
    touching = FilterConfig(name="open/touching", min_contact=0.2)
    packed = round_trip(filter_release(touching, whole, tmp_path / "touching").path, tmp_path)
    assert open_compact(packed).states


def test_made_up_play_cannot_be_packed(make_log: MakeLog, tmp_path: Path) -> None:
    made_up = build_release(ReleaseConfig(), [make_log(seed=3)], tmp_path / "made-up").path
    with pytest.raises(ArtefactError, match=r"cannot be simulated|not what was packed"):
        pack_release(made_up, tmp_path / "compact")
    assert not (tmp_path / "compact").exists()


def test_a_killed_restoration_continues(packed: Path, release: Path, tmp_path: Path) -> None:
    words = ["-m", "gym_open.cli", "dataset", "restore", str(packed), "--out", str(tmp_path / "back"), "--workers", "1"]
    process = subprocess.Popen([sys.executable, *words], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while process.poll() is None and not list(tmp_path.rglob("*.parquet")):
        pass
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert restore_release(packed, tmp_path / "back").different == []
    assert all_bytes(tmp_path / "back") == all_bytes(release)


def test_finished_files_are_not_made_again(packed: Path, release: Path, tmp_path: Path) -> None:
    """The writer ends after the first split; its file is kept, and its episodes are only simulated, not drawn."""
    drawn: list[bool] = []

    def broken(*given: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(restore, "_different", broken)
        with pytest.raises(KeyboardInterrupt):
            restore_release(packed, tmp_path / "back")
    real = restore.CompactPlayer.play

    def play(self: restore.CompactPlayer, stored: restore.Stored, *, images: bool = True) -> object:
        drawn.append(images)
        return real(self, stored, images=images)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(restore.CompactPlayer, "play", play)
        restore_release(packed, tmp_path / "back")
    assert not any(drawn)
    assert all_bytes(tmp_path / "back") == all_bytes(release)


def test_other_packages_give_the_same_content_and_records_of_their_own(
    packed: Path, release: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gym_open.datasets.writing import prepare
    from gym_open.formats.pngs import encode_pngs

    def other(images: np.ndarray) -> list[bytes]:
        return [png[:-12] + b"\x00\x00\x00\x05tEXta\x00b\x00c" + b"\x00" * 4 + png[-12:] for png in encode_pngs(images)]

    monkeypatch.setattr(prepare, "encode_pngs", other)
    found = restore_release(packed, tmp_path / "back")
    assert any(name.startswith("data/") for name in found.different)
    lineage = artefacts.lineage(found.path)
    assert [parent.digest for parent in lineage.parents] == [artefacts.digest(packed)]
    assert lineage.facts["content"] == open_compact(packed).info.content
    assert artefacts.digest(found.path) != artefacts.digest(release)
    assert restore_release(packed, tmp_path / "back").made is False


def test_something_else_at_the_place_is_kept(packed: Path, release: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match="not a whole release"):
        restore_release(packed, tmp_path / "mine")
    other = filter_release(FilterConfig(name="open/x", split=("train",)), release, tmp_path / "x").path
    with pytest.raises(UsageError, match="another release"):
        restore_release(packed, other)


def test_the_table_counts_every_byte(packed: Path) -> None:
    compact = open_compact(packed)
    counted = sum(sizes_of(compact).values())
    assert counted + (packed / "manifest.json").stat().st_size == sum(len(data) for data in all_bytes(packed).values())
    assert compact_table(packed).row_count == 4
