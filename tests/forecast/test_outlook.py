"""What a run prints before it starts: remaining stages, this machine, and free disk space."""

import os
from pathlib import Path

import msgspec
import pytest

from gym_open import artefacts
from gym_open.collect.config import CollectConfig
from gym_open.config import Config
from gym_open.forecast import outlook
from gym_open.forecast.outlook import PlannedStage
from gym_open.forecast.work import Work, learning
from gym_open.hardware import usable_cores
from gym_open.train.config import PolicyTrainConfig


def toy(root: Path, name: str, config: Config, *needs: PlannedStage) -> PlannedStage:
    return PlannedStage(name=name, folder=root / name, config=config, needs=needs, work=Work())


def make(stage: PlannedStage) -> None:
    artefacts.build(stage.folder, kind="toy", config=stage.config, parents=(), work=lambda _: {})


def test_a_stage_is_left_if_it_is_missing_or_has_another_configuration_or_needs_one_that_is_left(
    tmp_path: Path,
) -> None:
    """The configuration of exploration has tuples, which are lists on disk."""
    first, alone = toy(tmp_path, "first", CollectConfig()), toy(tmp_path, "alone", Config())
    second = toy(tmp_path, "second", PolicyTrainConfig(), first)
    third = toy(tmp_path, "third", Config(), second)
    stages = [first, second, third, alone]
    assert outlook.to_do(stages) == stages
    for stage in stages:
        make(stage)
    assert outlook.to_do(stages) == []
    changed = toy(tmp_path, "second", PolicyTrainConfig(seed=1), first)
    after = toy(tmp_path, "third", Config(), changed)
    assert outlook.to_do([first, changed, after, alone]) == [changed, after]
    (first.folder / artefacts.LINEAGE).write_text("{")
    assert outlook.to_do(stages) == [first, second, third]


def test_after_a_change_of_code_all_stages_are_left(tmp_path: Path) -> None:
    stage = toy(tmp_path, "first", Config())
    make(stage)
    path = stage.folder / artefacts.LINEAGE
    other = msgspec.structs.replace(artefacts.lineage(stage.folder), code="0.0.0+0")
    path.write_bytes(artefacts.canonical_json(other))
    assert outlook.to_do([stage]) == [stage]


def test_the_machine_is_described_as_far_as_it_matters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = PolicyTrainConfig(steps=128, num_envs=4, num_steps=16, mean_images=4, threads=1)
    ppo = msgspec.structs.replace(config.ppo, precision="fp32")
    work = learning(msgspec.structs.replace(config, ppo=ppo), encoder=False)
    stage = PlannedStage(name="policy", folder=tmp_path / "policy", config=config, work=work)
    monkeypatch.setattr(outlook, "usable_cores", lambda: 2)
    monkeypatch.setattr(os, "getloadavg", lambda: (2.9, 0.0, 0.0))
    cores, device, precision, free = outlook.found([stage], tmp_path).split(", ")
    assert cores == "2 cores"
    monkeypatch.setattr(os, "getloadavg", lambda: (7.4, 0.0, 0.0))
    assert outlook.found([stage], tmp_path).startswith("2 cores (busy: load 7), ")
    assert (device, precision) == ("no GPU in use", "fp32")
    assert free.endswith("B free")
    assert outlook.expected([stage]).startswith(("less than", "about"))
    assert [line for line in capsys.readouterr().err.splitlines() if line.endswith("…")] == [
        "loading PyTorch …", "loading PyTorch …", "getting ready …", "measuring this machine …",
    ]  # fmt: skip


def test_a_full_disk_is_a_warning(tmp_path: Path) -> None:
    assert outlook.too_full(tmp_path, 0) == ""
    assert outlook.too_full(tmp_path, 10**18).endswith("this run writes about 1000000000 GB: make room")


@pytest.mark.parametrize(
    ("count", "words"), [(2e7, "20 MB"), (4e8, "0.4 GB"), (9.94e9, "9.9 GB"), (9.96e9, "10 GB"), (6.3e10, "63 GB")]
)
def test_sizes_are_short(count: float, words: str) -> None:
    assert outlook.size(count) == words


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 64),
        ({"cpu.max": "max 100000"}, 64),
        ({"cpu.max": "250000 100000"}, 2),
        ({"cpu.max": "50000 100000"}, 1),
        ({"cpu.max": "nonsense"}, 64),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
        ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "0\n"}, 64),
    ],
)
def test_a_control_group_may_leave_fewer_cores(
    files: dict[str, str], cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)))
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert usable_cores(tmp_path) == cores
