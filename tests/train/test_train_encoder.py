"""World models from a release: repeatable, resumable, and plain about what they cannot do."""

import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import CurlConfig, EncoderConfig, IcmConfig, RndConfig
from gym_open.agents.curl import Curl
from gym_open.config import load
from gym_open.errors import ArtefactError, ConfigError, DivergedError
from gym_open.formats.models import load_encoder
from gym_open.formats.releases import open_release
from gym_open.formats.windows import Pictures
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.curve import Board
from gym_open.train.encoder import _EncoderTrainer, train_encoder
from tests.children import killed_at

pytestmark = pytest.mark.learning
TINY = EncoderTrainConfig(
    updates=6, batch_size=8, report_every=4, encoder=EncoderConfig(features=16), icm=IcmConfig(hidden=8),
    rnd=RndConfig(hidden=8, outputs=8), curl=CurlConfig(latent=8), threads=1,
)  # fmt: skip
MODELS = [msgspec.structs.replace(TINY, world_model=name) for name in ("icm", "rnd", "curl")]
FIGURES = {
    "icm": ["loss", "forward", "inverse", "inverse_accuracy"],
    "rnd": ["loss"],
    "curl": ["loss", "accuracy"],
}
each_model = pytest.mark.parametrize("config", MODELS, ids=[config.world_model for config in MODELS])


def curve(path: Path) -> dict[str, list[float | None]]:
    found = json.loads((path / "curve.json").read_text())
    return {name: [row[i] for row in found["rows"]] for i, name in enumerate(found["columns"])}


@pytest.mark.parametrize("name", get_args(EncoderTrainConfig.__annotations__["world_model"]))
def test_each_world_model_has_a_file(name: str) -> None:
    found = load(Path(__file__).parents[2] / f"train/encoder-{name}.toml", EncoderTrainConfig)
    assert found.world_model == name


@each_model
def test_twice_gives_the_same_bytes_and_a_second_time_nothing_is_done(
    config: EncoderTrainConfig, release: Path, tmp_path: Path
) -> None:
    first, second = (train_encoder(config, release, tmp_path / name) for name in ("a", "b"))
    assert first.made
    assert artefacts.digest(first.path) == artefacts.digest(second.path)
    assert not train_encoder(config, release, tmp_path / "a").made
    other = train_encoder(msgspec.structs.replace(config, seed=1), release, tmp_path / "c")
    a, c = (load_encoder(made.path).state_dict()["layers.0.weight"] for made in (first, other))
    assert not torch.equal(a, c)


@each_model
def test_payload_curve_and_lineage(config: EncoderTrainConfig, release: Path, tmp_path: Path) -> None:
    path = train_encoder(config, release, tmp_path / "e").path
    assert {item.name for item in path.iterdir()} == {
        "model.safetensors", "model.json", "curve.json", "config.json", "lineage.json", "manifest.json",
    }  # fmt: skip
    found = curve(path)
    figures = FIGURES[config.world_model]
    assert list(found) == ["update", *figures, *(f"held_out_{name}" for name in figures)]
    assert found["update"] == [4, 6]
    assert all(value is not None and np.isfinite(value) for column in found.values() for value in column)
    record = artefacts.lineage(path)
    assert record.kind == "encoder"
    assert [parent.digest for parent in record.parents] == [artefacts.digest(release)]
    facts = {"world_model": config.world_model, "updates": 6, "frames": len(open_release(release).split("train"))}
    assert facts.items() <= record.facts.items()


def test_looking_at_held_out_steps_changes_nothing(release: Path, tmp_path: Path) -> None:
    often, once = (
        train_encoder(msgspec.structs.replace(TINY, report_every=n), release, tmp_path / str(n)).path for n in (1, 6)
    )
    assert len(curve(often)["update"]) == 6
    assert (often / "model.safetensors").read_bytes() == (once / "model.safetensors").read_bytes()
    assert curve(often)["held_out_loss"][-1] == curve(once)["held_out_loss"][-1]


def test_the_network_that_makes_curls_keys_follows(release: Path, tmp_path: Path) -> None:
    trainer = _EncoderTrainer(TINY, Pictures(open_release(release), cache=tmp_path), tmp_path / "state")
    model = trainer.model
    assert isinstance(model, Curl)
    before = [parameter.clone() for parameter in model.key.parameters()]
    trainer.run(Board(None))
    assert all(not torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))


def test_mean_picture_is_that_of_the_training_frames(release: Path, tmp_path: Path) -> None:
    encoder = load_encoder(train_encoder(TINY, release, tmp_path / "e").path)
    source = open_release(release)
    expected = source.images(source.split("train")).astype(np.float64).mean(axis=0).transpose(2, 0, 1)
    np.testing.assert_allclose(encoder.mean_image.numpy(), expected, rtol=1e-6)


def test_pictures_that_were_kept_for_the_next_run_change_nothing(release: Path, tmp_path: Path) -> None:
    kept = tmp_path / "cache"
    first, second, third = (
        train_encoder(TINY, release, tmp_path / name, cache=cache).path
        for name, cache in (("a", None), ("b", kept), ("c", kept))
    )
    assert artefacts.digest(first) == artefacts.digest(second) == artefacts.digest(third)
    assert (kept / f"{artefacts.digest(release)}.frames").is_file()


def test_large_releases_give_the_same_without_decoding_all(
    release: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = train_encoder(TINY, release, tmp_path / "a")
    monkeypatch.setattr("gym_open.train.encoder.Pictures", functools.partial(Pictures, limit_bytes=0))
    second = train_encoder(TINY, release, tmp_path / "b")
    assert artefacts.digest(first.path) == artefacts.digest(second.path)


@pytest.mark.parametrize(
    "config",
    [pytest.param(one, marks=pytest.mark.slow if one.world_model != "icm" else ()) for one in MODELS],
    ids=[one.world_model for one in MODELS],
)
def test_killed_and_resumed_is_as_if_never_killed(config: EncoderTrainConfig, release: Path, tmp_path: Path) -> None:
    config = msgspec.structs.replace(config, updates=9, report_every=3)
    whole = train_encoder(config, release, tmp_path / "whole").path
    cut = tmp_path / "cut"
    settings = msgspec.json.encode(config).decode()
    code = (
        "import msgspec; from pathlib import Path; from gym_open.train.config import EncoderTrainConfig as C; "
        "from gym_open.train.encoder import train_encoder; "
        f"train_encoder(msgspec.json.decode({settings!r}, type=C), Path({str(release)!r}), Path({str(cut)!r}))"
    )
    killed_at(tmp_path / ".cut.partial" / "checkpoint", "state.safetensors", code)
    assert not cut.exists()
    assert artefacts.digest(train_encoder(config, release, cut).path) == artefacts.digest(whole)


def test_no_validation_split_leaves_null(make_log: Callable[..., Path], tmp_path: Path) -> None:
    from gym_open.datasets.build import build_release
    from gym_open.datasets.config import ReleaseConfig

    made = build_release(ReleaseConfig(val_fraction=0.0), [make_log(lengths=((9,),))], tmp_path / "r")
    found = curve(train_encoder(TINY, made.path, tmp_path / "e").path)
    assert found["held_out_loss"] == found["held_out_accuracy"] == [None, None]
    assert None not in found["loss"]


def test_too_few_steps_is_said(release: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"split 'train' has \d+ steps, expected at least batch_size = 128"):
        train_encoder(msgspec.structs.replace(TINY, batch_size=128), release, tmp_path / "e")
    assert not (tmp_path / "e").exists()


def test_a_flipped_byte_stops_it_before_any_work(release: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "release"
    shutil.copytree(release, damaged)
    file = next(damaged.glob("data/**/*.parquet"))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(ArtefactError, match=file.name):
        train_encoder(TINY, damaged, tmp_path / "e")
    assert [item.name for item in tmp_path.iterdir()] == ["release"]


def test_a_loss_that_is_not_finite_is_said_with_update_and_configuration(release: Path, tmp_path: Path) -> None:
    config = msgspec.structs.replace(TINY, learning_rate=1e30, world_model="rnd", precision="fp32")
    with pytest.raises(DivergedError, match=r"not finite in update \d.*`learning_rate`, got 1e\+30"):
        train_encoder(config, release, tmp_path / "e")
    assert not (tmp_path / "e").exists()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_said(release: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="key `device`: 'cuda'"):
        train_encoder(msgspec.structs.replace(TINY, device="cuda"), release, tmp_path / "e")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
@each_model
def test_a_gpu_learns_the_same(config: EncoderTrainConfig, release: Path, tmp_path: Path) -> None:
    config = msgspec.structs.replace(config, precision="fp32")
    there = msgspec.structs.replace(config, device="cuda")
    here, gpu = (curve(train_encoder(one, release, tmp_path / one.device).path) for one in (config, there))
    assert gpu["loss"] == pytest.approx(here["loss"], rel=0.05)
