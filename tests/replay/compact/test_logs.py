"""A log that was packed comes back in every byte."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from gym_open.agents.config import ExplorerConfig
from gym_open.collect import explore
from gym_open.collect.config import CollectConfig, CurriculumConfig, LogConfig
from gym_open.collect.explore import collect
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.compact.files import NumberReader, NumberWriter, read_rows, write_rows
from gym_open.formats.compact.logs import ACTIONS, EVENTS, HEADS, EventRow, HeadRow, open_packed_log
from gym_open.replay.compact.logs import pack_log, restore_log
from tests.conftest import MakeLog
from tests.datasets.compact.test_forgeries import seal
from tests.datasets.compact.test_pack import all_bytes

RANDOM = ExplorerConfig(world_model="none", reward="none")
LEARNED = ExplorerConfig(world_model="icm", reward="ride", share_encoder=True)


def play(out: Path, explorer: ExplorerConfig, log: LogConfig, steps: int) -> Path:
    config = CollectConfig(
        steps=steps, streams=2, rollout=8, pool=3, probe=16, checkpoint_every=8, threads=1, seed=4,
        explorer=explorer, curriculum=CurriculumConfig(rule="interval", interval=16), log=log,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explore, "draw_summary", lambda *_: b"")
        return collect(config, out).path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return play(tmp_path_factory.mktemp("play") / "log", LEARNED, LogConfig(keyframe_every=8), 128)


@pytest.fixture(scope="module")
def packed(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_log(log, tmp_path_factory.mktemp("packed") / "packed").path


def test_every_byte_comes_back(log: Path, packed: Path, tmp_path: Path) -> None:
    assert restore_log(packed, tmp_path / "back")
    assert all_bytes(tmp_path / "back") == all_bytes(log)
    assert not restore_log(packed, tmp_path / "back")
    assert all_bytes(pack_log(log, tmp_path / "again").path) == all_bytes(packed)


def test_depth_segmentation_and_several_files_come_back(tmp_path: Path) -> None:
    log = play(tmp_path / "log", RANDOM, LogConfig(keyframe_every=8, depth=True, segmentation=True, roll_mb=1), 512)
    assert len(list(log.glob("stream-000-*.mcap"))) > 1 or (log / "stream-000-000.mcap").stat().st_size < 2**20
    restore_log(pack_log(log, tmp_path / "packed").path, tmp_path / "back")
    assert all_bytes(tmp_path / "back") == all_bytes(log)


def test_made_up_play_cannot_be_packed(make_log: MakeLog, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"do not give its bytes|cannot be simulated"):
        pack_log(make_log(seed=3), tmp_path / "packed")


def _action(root: Path) -> None:
    total = open_packed_log(root).info.steps
    with NumberReader(root / ACTIONS, np.uint8, total) as reader:
        values = reader.take(total).copy()
    values[5] = (values[5] + 1) % 9
    with NumberWriter(root / ACTIONS, np.uint8) as writer:
        writer.add(values)


def _head(root: Path) -> None:
    rows = list(read_rows(root / HEADS, HeadRow))
    write_rows(root / HEADS, rows[:1])


def _event(root: Path) -> None:
    rows = list(read_rows(root / EVENTS, EventRow))
    write_rows(root / EVENTS, rows[1:])


@pytest.mark.parametrize("change", [_action, _head, _event])
def test_changes_are_refused(packed: Path, tmp_path: Path, change: object) -> None:
    copy = Path(shutil.copytree(packed, tmp_path / "copy"))
    assert callable(change)
    change(copy)
    seal(copy)
    with pytest.raises(ArtefactError):
        restore_log(copy, tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_something_else_at_the_place_is_kept(packed: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match="exists"):
        restore_log(packed, tmp_path / "mine")
