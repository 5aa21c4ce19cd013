"""The linear probe: exact regression, fresh worlds, and scores that tell knowing from guessing."""

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.envs.constants import PITCH, cell_centre
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.seeding import generator
from gym_open.train.config import EncoderTrainConfig, ProbeConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.probe import ONE_OF_EACH, TARGETS, Sample, draw_samples, logged_puzzles, probe, score
from gym_open.train.ridge import fit_ridge, r_squared

TINY = ProbeConfig(train_worlds=12, validation_worlds=4, test_worlds=5, threads=1)


def data(n: int, inputs: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, inputs)) * 3 + 1
    y = x[:, :2] @ rng.normal(size=(2, 3)) + rng.normal(size=(n, 3)) + 5
    return torch.from_numpy(x), torch.from_numpy(y)


@pytest.mark.parametrize(("n", "inputs"), [(40, 6), (20, 50)])
def test_ridge_solves_the_normal_equations(n: int, inputs: int) -> None:
    x, y = data(n, inputs)
    ridge = fit_ridge(x, y, (x, y), [0.3])
    z = x.numpy() - x.numpy().mean(axis=0)
    z /= np.sqrt((z**2).sum(axis=1).mean())
    weights = np.linalg.solve(z.T @ z + 0.3 * np.eye(inputs), z.T @ (y.numpy() - y.numpy().mean(axis=0)))
    np.testing.assert_allclose(ridge.predict(x).numpy(), z @ weights + y.numpy().mean(axis=0), rtol=1e-6)


def test_ridge_takes_the_strength_that_validates_best() -> None:
    x, y = data(30, 25)
    fresh = data(200, 25, seed=0)
    strengths = [1e-6, 1e-2, 1.0, 1e4]

    def error(strength: float) -> float:
        return (fit_ridge(x, y, (x, y), [strength]).predict(fresh[0]) - fresh[1]).square().mean().item()

    chosen = fit_ridge(x, y, fresh, strengths).predict(fresh[0])
    assert (chosen - fresh[1]).square().mean().item() == min(error(strength) for strength in strengths)


def test_inputs_that_never_vary_are_harmless() -> None:
    x, y = data(10, 3)
    ridge = fit_ridge(torch.ones_like(x), y, (x, y), [1.0])
    torch.testing.assert_close(ridge.predict(torch.ones_like(x)), y.mean(dim=0).expand(10, 3))


def test_r_squared() -> None:
    y = torch.tensor([[0.0], [2.0]])
    assert r_squared(y, y) == 1
    assert r_squared(torch.ones(2, 1), y) == 0
    assert r_squared(-y, y) < 0


def test_worlds_are_fresh_distinct_and_measured_in_metres() -> None:
    sizes = {"train": 6, "test": 6}
    rng = generator(0, "probe", "train")
    would_be = [sample_puzzle("sandbox", rng, ONE_OF_EACH) for _ in range(6)]
    plain = draw_samples(sizes, set(), 0)
    for i, puzzle in enumerate(would_be):
        for target in TARGETS:
            (item,) = (item for item in puzzle.objects if item.kind == target)
            expected = cell_centre(item.row, item.column)
            np.testing.assert_allclose(plain["train"].positions[target][i], expected, atol=0.01)
    known = {would_be[0].digest, would_be[3].digest}
    others = draw_samples(sizes, known, 0)
    kept = [plain["train"].images[i] for i in (1, 2, 4, 5)]
    assert all(torch.equal(a, b) for a, b in zip(kept, others["train"].images[:4], strict=True))
    everything = torch.cat([others["train"].images, others["test"].images]).flatten(1)
    assert len(torch.unique(everything, dim=0)) == 12


def test_what_the_pictures_tell_is_found_and_what_they_do_not_is_not() -> None:
    """The agent's position is painted as brightness all over the picture, the yellow goal's not at all."""
    rng, samples = np.random.default_rng(0), {}
    for part, size in (("train", 200), ("validation", 50), ("test", 100)):
        positions = {target: torch.from_numpy(rng.uniform(-0.5, 0.5, size=(size, 2))) for target in TARGETS}
        images = torch.zeros(size, 84, 84, 3, dtype=torch.uint8)
        images[..., :2] = ((positions["agent"] + 0.5) * 255).round().to(torch.uint8)[:, None, None, :]
        samples[part] = Sample(images, positions)
    encoder = Encoder(EncoderConfig(features=64), torch.Generator().manual_seed(3))
    encoder.set_mean_image(samples["train"].images)
    scores = score(msgspec.structs.replace(TINY, pixels=True), encoder, samples)
    for features in ("trained", "untrained", "pixels"):
        assert scores["agent"][features]["r2"] > 0.95
        assert scores["agent"][features]["error_cells"] < 0.1 / PITCH
        assert scores["yellow"][features]["r2"] < 0.1


def test_pixels_of_real_worlds_tell_where_things_are() -> None:
    encoder = Encoder(EncoderConfig(features=64), torch.Generator().manual_seed(3))
    samples = draw_samples({"train": 250, "validation": 60, "test": 100}, set(), 0)
    encoder.set_mean_image(samples["train"].images)
    scores = score(msgspec.structs.replace(TINY, pixels=True), encoder, samples)
    assert scores["agent"]["pixels"]["r2"] > 0.5


@pytest.fixture(scope="module")
def encoder(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    network = EncoderConfig(features=16)
    config = EncoderTrainConfig(updates=2, batch_size=4, encoder=network, curl=CurlConfig(latent=4), threads=1)
    return train_encoder(config, release, tmp_path_factory.mktemp("encoder") / "encoder").path


def test_payload_is_as_documented_and_repeatable(encoder: Path, tmp_path: Path) -> None:
    first, second = (probe(TINY, encoder, tmp_path / name).path for name in ("a", "b"))
    assert artefacts.digest(first) == artefacts.digest(second)
    found = json.loads((first / "probe.json").read_text())
    assert found["worlds"] == {"train": 12, "validation": 4, "test": 5}
    assert set(found["targets"]) == {"agent", "yellow", "green"}
    for row in found["targets"].values():
        assert set(row) == {"trained", "untrained"}
        assert all(set(cell) == {"r2", "error_cells"} for cell in row.values())


def test_puzzles_of_the_logs_are_found_in_the_lineage(
    encoder: Path, make_log: Callable[..., Path], tmp_path: Path
) -> None:
    record = artefacts.lineage(encoder)
    assert logged_puzzles(record) == set(record.parents[0].lineage.parents[0].lineage.facts["puzzles"])
    assert len(logged_puzzles(record)) == 3
