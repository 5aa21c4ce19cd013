"""CURL from a release: repeatable, resumable, and plain about what it cannot do."""

import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.errors import ArtefactError
from gym_open.formats.models import load_encoder
from gym_open.formats.releases import open_release
from gym_open.formats.windows import Pictures
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.encoder import COLUMNS, train_encoder

TINY = EncoderTrainConfig(
    updates=6, batch_size=8, report_every=4, encoder=EncoderConfig(features=16), curl=CurlConfig(latent=8), threads=1
)


def curve(path: Path) -> list[list[float | None]]:
    found = json.loads((path / "curve.json").read_text())
    assert found["columns"] == list(COLUMNS)
    return found["rows"]


def test_twice_gives_the_same_bytes_and_a_second_time_nothing_is_done(release: Path, tmp_path: Path) -> None:
    first, second = (train_encoder(TINY, release, tmp_path / name) for name in ("a", "b"))
    assert first.made
    assert artefacts.digest(first.path) == artefacts.digest(second.path)
    assert not train_encoder(TINY, release, tmp_path / "a").made
    other = train_encoder(msgspec.structs.replace(TINY, seed=1), release, tmp_path / "c")
    a, c = (load_encoder(made.path).state_dict()["layers.0.weight"] for made in (first, other))
    assert not torch.equal(a, c)


def test_payload_curve_and_lineage(release: Path, tmp_path: Path) -> None:
    path = train_encoder(TINY, release, tmp_path / "e").path
    assert {item.name for item in path.iterdir()} == {
        "model.safetensors", "model.json", "curve.json", "config.json", "lineage.json", "manifest.json",
    }  # fmt: skip
    rows = curve(path)
    assert [row[0] for row in rows] == [4, 6]
    assert all(value is not None and np.isfinite(value) for row in rows for value in row)
    record = artefacts.lineage(path)
    assert record.kind == "encoder"
    assert [parent.digest for parent in record.parents] == [artefacts.digest(release)]
    assert record.facts == {"updates": 6, "frames": len(open_release(release).split("train"))}


def test_mean_picture_is_that_of_the_training_frames(release: Path, tmp_path: Path) -> None:
    encoder = load_encoder(train_encoder(TINY, release, tmp_path / "e").path)
    source = open_release(release)
    expected = source.images(source.split("train")).astype(np.float64).mean(axis=0).transpose(2, 0, 1)
    np.testing.assert_allclose(encoder.mean_image.numpy(), expected, rtol=1e-6)


def test_large_releases_give_the_same_without_decoding_all(
    release: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = train_encoder(TINY, release, tmp_path / "a")
    monkeypatch.setattr("gym_open.train.encoder.Pictures", functools.partial(Pictures, limit_bytes=0))
    second = train_encoder(TINY, release, tmp_path / "b")
    assert artefacts.digest(first.path) == artefacts.digest(second.path)


def test_killed_and_resumed_is_as_if_never_killed(
    release: Path, tmp_path: Path, kill_when: Callable[[str, Path], None]
) -> None:
    config = msgspec.structs.replace(TINY, updates=150, report_every=10)
    whole = train_encoder(config, release, tmp_path / "whole").path
    cut = tmp_path / "cut"
    settings = msgspec.json.encode(config).decode()
    code = (
        "import msgspec; from pathlib import Path; from gym_open.train.config import EncoderTrainConfig as C; "
        "from gym_open.train.encoder import train_encoder; "
        f"train_encoder(msgspec.json.decode({settings!r}, type=C), Path({str(release)!r}), Path({str(cut)!r}))"
    )
    kill_when(code, tmp_path / ".cut.partial" / "checkpoint" / "state.safetensors")
    assert not cut.exists()
    assert artefacts.digest(train_encoder(config, release, cut).path) == artefacts.digest(whole)


def test_no_validation_split_leaves_null(make_log: Callable[..., Path], tmp_path: Path) -> None:
    from gym_open.datasets.build import build_release
    from gym_open.datasets.config import ReleaseConfig

    made = build_release(ReleaseConfig(val_fraction=0.0), [make_log(lengths=((9,),))], tmp_path / "r")
    rows = curve(train_encoder(TINY, made.path, tmp_path / "e").path)
    assert all(row[3] is None and row[4] is None for row in rows)


def test_too_few_frames_is_said(release: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"split 'train' has \d+ frames, expected at least batch_size = 128"):
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
