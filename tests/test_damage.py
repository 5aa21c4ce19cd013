"""A changed bit in an unfinished folder is noticed, or does no harm: the run ends with the same bytes or not at all."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig, ExplorerConfig, PPOConfig
from gym_open.collect import checkpoint, explore
from gym_open.collect.config import CollectConfig, CurriculumConfig
from gym_open.collect.explore import collect
from gym_open.datasets import documents
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing import writer
from gym_open.errors import GymOpenError
from gym_open.train import encoder as encoders
from gym_open.train import policy as policies
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.policy import train_policy

FLIPS = 4
PLAY = CollectConfig(
    steps=256, streams=2, rollout=8, pool=3, probe=16, checkpoint_every=2, threads=1, seed=1,
    explorer=ExplorerConfig(world_model="none", reward="none"),
    curriculum=CurriculumConfig(rule="interval", interval=16),
)  # fmt: skip
POLICY = PolicyTrainConfig(
    task="goal-seeking", steps=64, num_envs=2, num_steps=8, threads=1, checkpoints=(16,),
    ppo=PPOConfig(minibatch_size=8, update_epochs=1), encoder=EncoderConfig(architecture="state"), trunk=(8,),
)  # fmt: skip
ENCODER = EncoderTrainConfig(updates=12, batch_size=4, report_every=2, threads=1, precision="fp32")
Make = Callable[[Path], Path]


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explore, "draw_summary", lambda *_: b"")
    monkeypatch.setattr(documents, "draw", lambda _: {})


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explore, "draw_summary", lambda *_: b"")
        return collect(PLAY, tmp_path_factory.mktemp("play") / "log").path


@pytest.fixture(scope="module")
def release(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})
        return build_release(ReleaseConfig(), [log], tmp_path_factory.mktemp("release") / "1.0.0").path


def interrupted(make: Make, out: Path, where: Any, name: str, after: int) -> None:
    """Run `make`, and interrupt it after the call number `after` of a function."""
    real, calls = getattr(where, name), 0

    def call(*given: Any, **named: Any) -> Any:
        nonlocal calls
        calls += 1
        found = real(*given, **named)
        if calls == after:
            raise KeyboardInterrupt
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(where, name, call)
        with pytest.raises(KeyboardInterrupt):
            make(out)
    assert not out.exists()


def flipped(folder: Path, rng: np.random.Generator) -> str:
    """Change a random bit of a random file, and say which."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size)
    path = files[rng.integers(len(files))]
    data = bytearray(path.read_bytes())
    place, bit = int(rng.integers(len(data))), int(rng.integers(8))
    data[place] ^= 1 << bit
    path.write_bytes(data)
    return f"{path.relative_to(folder)}, byte {place}, bit {bit}"


def survives(make: Make, folder: Path, where: Any, name: str, after: int, *, flips: int, seed: int) -> None:
    whole = artefacts.digest(make(folder / "whole"))
    (folder / "cut").mkdir()
    interrupted(make, folder / "cut/out", where, name, after)
    recovered = 0
    for number in range(flips):
        copy = folder / f"copy-{number}"
        shutil.copytree(folder / "cut", copy)
        what = flipped(copy / ".out.partial", np.random.default_rng([seed, number]))
        try:
            made = make(copy / "out")
        except GymOpenError:
            assert not (copy / "out").exists(), what
        else:
            assert artefacts.digest(made) == whole, what
            recovered += 1
        shutil.rmtree(copy)
    assert recovered


STAGES = ("collect", "policy", "encoder", "build")


def _survives(stage: str, log: Path, release: Path, folder: Path, flips: int) -> None:
    if stage == "collect":
        survives(lambda out: collect(PLAY, out).path, folder, checkpoint, "save", 4, flips=flips, seed=1)
    elif stage == "policy":
        trainer = policies._PolicyTrainer
        survives(lambda out: train_policy(POLICY, None, out).path, folder, trainer, "save", 3, flips=flips, seed=2)
    elif stage == "encoder":
        trainer = encoders._EncoderTrainer
        survives(lambda out: train_encoder(ENCODER, release, out).path, folder, trainer, "save", 3, flips=flips, seed=3)
    else:
        config = ReleaseConfig(max_episode_steps=16)
        survives(
            lambda out: build_release(config, [log], out).path, folder, writer.ReleaseWriter, "_take_over", 1,
            flips=flips, seed=4,
        )  # fmt: skip


@pytest.mark.parametrize("stage", STAGES)
def test_flips_in_unfinished_folders_do_no_harm(stage: str, log: Path, release: Path, tmp_path: Path) -> None:
    _survives(stage, log, release, tmp_path, FLIPS)


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
def test_many_flips_do_no_harm(stage: str, log: Path, release: Path, tmp_path: Path) -> None:
    _survives(stage, log, release, tmp_path, 60)


def test_the_checkpoint_before_a_damaged_one_is_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every bit of a checkpoint counts; without a whole one, the run starts again. The bytes are the same."""
    make = lambda out: collect(PLAY, out).path  # noqa: E731
    whole = artefacts.digest(make(tmp_path / "whole"))
    for damaged, said in (
        (("state.safetensors",), "continues from the checkpoint before it"),
        (("state.safetensors", "before-state.safetensors"), "the run starts again"),
    ):
        out = tmp_path / str(len(damaged)) / "out"
        interrupted(make, out, checkpoint, "save", 4)
        for name in damaged:
            path = out.parent / ".out.partial/checkpoint" / name
            data = bytearray(path.read_bytes())
            data[-100] ^= 64
            path.write_bytes(data)
        assert artefacts.digest(make(out)) == whole
        assert said in " ".join(capsys.readouterr().err.split())
