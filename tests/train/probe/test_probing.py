"""The linear probe: fresh worlds, and scores that tell knowing from guessing."""

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch
from rich.console import Console

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.envs.constants import MOVES as DIRECTIONS
from gym_open.envs.constants import PITCH, cell_centre
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.formats.models import save_encoder
from gym_open.seeding import generator
from gym_open.summary import probe_table
from gym_open.train.config import EncoderTrainConfig, ProbeConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.probe.probing import TARGETS, logged_puzzles, probe, score
from gym_open.train.probe.worlds import BODIES, MOVES, ONE_OF_EACH, ProbeSample, draw_samples

TINY = ProbeConfig(train_worlds=12, validation_worlds=6, test_worlds=6, moves=2, pixels=False, threads=1)
POSITIONS = {"agent", "yellow", "green", "heavy", "light", "to_yellow"}


@pytest.fixture(scope="module")
def real() -> dict[str, ProbeSample]:
    return draw_samples({"train": 220, "validation": 40, "test": 70}, 2, set(), 0)


def painted(size: int, rng: np.random.Generator) -> ProbeSample:
    """Plain pictures: red and green are the agent's position, blue says that its next move is blocked."""
    positions = torch.from_numpy(rng.uniform(-0.5, 0.5, size=(size, 2, len(BODIES), 2)))
    blocked = torch.from_numpy(rng.random((size, 1)) < 0.2)
    moves = torch.from_numpy(rng.integers(MOVES, size=(size, 1)))
    way = torch.tensor(DIRECTIONS[1:])[moves[:, 0]] * PITCH
    positions[:, 1, 0] = positions[:, 0, 0] + torch.where(blocked, 0.0, way)
    images = torch.zeros(size, 2, 84, 84, 3, dtype=torch.uint8)
    images[..., :2] = ((positions[:, :, 0] + 0.7) * 180).round().to(torch.uint8)[:, :, None, None]
    images[:, 0, ..., 2] = (blocked * 200).to(torch.uint8)[:, None]
    return ProbeSample(images, positions, moves, blocked)


def coder(images: torch.Tensor, architecture: str = "cnn", features: int = 64) -> Encoder:
    config = msgspec.convert({"architecture": architecture, "features": features}, EncoderConfig)
    encoder = Encoder(config, torch.Generator().manual_seed(3))
    encoder.set_mean_image(images.flatten(0, 1))
    return encoder


def test_worlds_are_fresh_and_distinct() -> None:
    sizes = {"train": 6, "test": 6}
    rng = generator(0, "probe", "train")
    first = sample_puzzle("sandbox", rng, ONE_OF_EACH)
    plain = draw_samples(sizes, 1, set(), 0)
    again = draw_samples(sizes, 1, set(), 0)
    others = draw_samples(sizes, 1, {first.digest}, 0)
    lie = {item.kind: cell_centre(item.row, item.column) for item in first.objects}
    found = dict(zip(BODIES, plain["train"].positions[0, 0].numpy(), strict=True))
    at_rest = [np.allclose(found[kind], lie[kind], atol=0.01) for kind in ("yellow", "green", "heavy", "light")]
    assert sum(at_rest) >= 3  # the agent may have pushed one while it warmed up
    assert torch.equal(plain["train"].images, again["train"].images)
    assert not torch.equal(plain["train"].images[0], others["train"].images[0])
    everything = torch.cat([plain["train"].images, plain["test"].images])[:, 0].flatten(1)
    assert len(torch.unique(everything, dim=0)) == 12


def test_what_is_said_of_a_move_is_what_happened(real: dict[str, ProbeSample]) -> None:
    sample = real["train"]
    way = (sample.positions[:, 1:, 0] - sample.positions[:, :-1, 0]).numpy()
    free = ~sample.contacts.numpy()
    expected = np.array(DIRECTIONS[1:])[sample.moves.numpy()] * 25 / 7 * 0.04  # m/s for 0.04 s
    short = np.abs(way - expected).max(axis=2) > 0.02
    assert 0.1 < sample.contacts.double().mean() < 0.6
    assert short[~free].mean() > 0.4
    assert short[free].mean() < 0.15  # on a ramp nothing else is touched
    changed = (sample.images[:, 1:] != sample.images[:, :-1]).flatten(2).any(dim=2).numpy()
    assert changed[free & ~short].all()


def test_what_pictures_tell_is_found_and_what_they_do_not_is_not() -> None:
    rng = np.random.default_rng(0)
    samples = {part: painted(size, rng) for part, size in (("train", 200), ("validation", 60), ("test", 80))}
    encoder = coder(samples["train"].images)
    scores = score(msgspec.structs.replace(TINY, moves=1, pixels=True), encoder, samples)
    assert set(scores) == set(TARGETS) == POSITIONS | {"displacement", "contact", "move"}
    for features in ("trained", "untrained", "pixels"):
        found = {target: row["scores"][features] for target, row in scores.items()}
        assert found["agent"]["value"] > 0.95
        assert found["agent"]["error_cells"] < 0.1 / PITCH
        assert found["yellow"]["value"] < 0.1
        assert 0.3 < found["to_yellow"]["value"] < 0.7  # half of it is where the agent is, the rest cannot be known
        assert found["contact"]["value"] > 0.95
        assert found["displacement"]["value"] > 0.8
        assert found["move"]["value"] > 0.6  # a blocked one looks like no other
    assert 0.3 < scores["contact"]["guess"] < 0.7
    for row in scores.values():
        assert all(
            cell["low"] <= cell["value"] + 0.05 and cell["value"] - 0.05 <= cell["high"]
            for cell in row["scores"].values()
        )


def test_pixels_of_real_worlds_tell_where_things_are(real: dict[str, ProbeSample]) -> None:
    scores = score(
        msgspec.structs.replace(TINY, pixels=True, untrained=1), coder(real["train"].images, features=16), real
    )
    assert all(scores[body]["scores"]["pixels"]["value"] > 0.3 for body in ("agent", "yellow"))


def test_an_untrained_encoder_gains_nothing_over_itself(
    real: dict[str, ProbeSample], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {
        part: ProbeSample(s.images[:20], s.positions[:20], s.moves[:20], s.contacts[:20]) for part, s in real.items()
    }
    encoder = coder(few["train"].images, "impala", features=8)
    monkeypatch.setattr("gym_open.train.probe.probing._untrained", lambda *_: encoder)
    for row in score(TINY, encoder, few).values():
        assert row["gain"] == {"value": 0, "low": 0, "high": 0}
        assert row["scores"]["trained"] == row["scores"]["untrained"]


@pytest.fixture(scope="module")
def encoder(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = EncoderTrainConfig(updates=2, batch_size=4, encoder=EncoderConfig(features=16), threads=1)
    return train_encoder(config, release, tmp_path_factory.mktemp("encoder") / "encoder").path


def test_payload_is_as_documented_and_repeatable(encoder: Path, tmp_path: Path) -> None:
    first, second = (probe(TINY, encoder, tmp_path / name).path for name in ("a", "b"))
    assert artefacts.digest(first) == artefacts.digest(second)
    found = json.loads((first / "probe.json").read_text())
    assert (found["worlds"], found["moves"]) == ({"train": 12, "validation": 6, "test": 6}, 2)
    for target, row in found["targets"].items():
        assert set(row) == {"measure", "guess", "scores", "gain"}
        assert set(row["scores"]) == {"trained", "untrained"}
        more = {"error_cells"} if target in POSITIONS else set[str]()
        assert all(set(cell) == {"value", "low", "high"} | more for cell in row["scores"].values())
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(probe_table(first))
    shown = console.export_text()
    assert all(target in shown for target in TARGETS)


def test_puzzles_of_the_logs_are_found_in_the_lineage(encoder: Path) -> None:
    record = artefacts.lineage(encoder)
    assert logged_puzzles(record) == set(record.parents[0].lineage.parents[0].lineage.facts["puzzles"])
    assert len(logged_puzzles(record)) == 3


def test_the_encoder_that_a_log_holds_is_probed(make_log: Callable[..., Path], tmp_path: Path) -> None:
    def work(folder: Path) -> Mapping[str, Any]:
        (folder / "encoder").mkdir()
        save_encoder(folder / "encoder", Encoder(EncoderConfig(features=8), torch.Generator().manual_seed(0)))
        return {"puzzles": []}

    log = artefacts.build(tmp_path / "log", kind="log", config=TINY, parents=[], work=work).path
    assert artefacts.lineage(probe(TINY, log, tmp_path / "probe").path).parents[0].digest == artefacts.digest(log)
