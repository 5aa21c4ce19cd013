"""Event files for TensorBoard hold what the curve holds, and nothing is written unless asked for."""

import json
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from gym_open import artefacts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.curve import Board
from gym_open.train.encoder import train_encoder


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    found = EventAccumulator(str(folder)).Reload()
    return {name: [(one.step, one.value) for one in found.Scalars(name)] for name in found.Tags()["scalars"]}


def test_rows_come_back_and_what_is_no_number_is_left_out(tmp_path: Path) -> None:
    board = Board(tmp_path / "events")
    board.row(10, {"loss": 0.5, "held_out_loss": None})
    board.row(20, {"loss": 0.25, "held_out_loss": float("nan")})
    board.close()
    assert scalars(tmp_path / "events") == {"loss": [(10, 0.5), (20, 0.25)]}


def test_without_a_folder_nothing_happens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    board = Board(None)
    board.row(1, {"loss": 1.0})
    board.close()
    assert not list(tmp_path.iterdir())


def test_an_encoder_is_the_same_with_and_without(release: Path, tmp_path: Path) -> None:
    config = EncoderTrainConfig(
        updates=4, batch_size=4, report_every=2, encoder=EncoderConfig(features=16), curl=CurlConfig(latent=4),
        threads=1,
    )  # fmt: skip
    plain = train_encoder(config, release, tmp_path / "a").path
    watched = train_encoder(config, release, tmp_path / "b", tensorboard=tmp_path / "events").path
    assert artefacts.digest(plain) == artefacts.digest(watched)
    curve = json.loads((watched / "curve.json").read_text())
    found = scalars(tmp_path / "events")
    assert list(found) == curve["columns"][1:]
    for i, name in enumerate(curve["columns"][1:], 1):
        assert found[name] == [(row[0], pytest.approx(row[i], rel=1e-6)) for row in curve["rows"]]
