"""Features of maps: closed forms, and the same numbers from plain loops."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gym_open.agents.config import EncoderConfig
from gym_open.agents.objects.readout import CELLS, EDGES, centroids, read_maps


def config(readout: str, slots: int = 3) -> EncoderConfig:
    return EncoderConfig(architecture="slots", slots=slots, readout=readout)  # type: ignore[arg-type]


def one_cell(*cells: tuple[int, int, int], slots: int = 3) -> torch.Tensor:
    """A map with mass 1 in each cell (row, column, slot)."""
    maps = torch.zeros(1, CELLS, CELLS, slots)
    for row, column, slot in cells:
        maps[0, row, column, slot] = 1
    return maps


def test_centroids_are_means_of_cells_and_the_middle_if_there_is_nothing() -> None:
    mass, places = centroids(one_cell((10, 20, 0), (12, 26, 0), (5, 7, 1)))
    assert mass.tolist() == [[2, 1, 0]]
    torch.testing.assert_close(places, torch.tensor([[[11.0, 23.0], [5.0, 7.0], [21.0, 21.0]]]))


def test_centroids_have_gradients() -> None:
    maps = one_cell((10, 20, 0), (12, 26, 0)).requires_grad_()
    centroids(maps)[1][0, 0, 0].backward()
    assert maps.grad is not None
    assert maps.grad[0, 12, 0, 0] == pytest.approx(0.5)  # (12 − 11) / 2


def test_the_agents_place_comes_first_then_places_then_masses() -> None:
    features = read_maps(one_cell((10, 20, 1), (31, 41, 2)), agent=1, config=config("centroids"))[0].tolist()
    weight = 4 * 1 / 1.5
    assert features[:2] == pytest.approx([-1.1, -0.1])
    assert features[2:8] == pytest.approx([0, 0, -1.1 * weight, -0.1 * weight, 1.0 * weight, 2.0 * weight])
    assert features[8:] == pytest.approx([0, 0.8, 0.8])


def test_the_grid_lies_around_the_agent() -> None:
    """The box that begins at the agent holds it; what is two cells to the right of it is two boxes further."""
    features = read_maps(one_cell((10, 20, 0), (10, 22, 1)), agent=0, config=config("grid"))[0].view(3, 15, 15)
    here = EDGES.index(0)
    assert features[0, here, here] == pytest.approx(4 * math.tanh(1))
    assert features[1, here, here + 2] == pytest.approx(4 * math.tanh(1))
    assert features.count_nonzero() == 2


@given(seed=st.integers(0, 2**32 - 1), agent=st.integers(0, 2))
def test_features_are_those_of_plain_loops(seed: int, agent: int) -> None:
    rng = np.random.default_rng(seed)
    maps = (rng.random((1, CELLS, CELLS, 3)) * (rng.random((1, CELLS, CELLS, 3)) < rng.random())).astype(np.float32)
    found = read_maps(torch.from_numpy(maps), agent, config("both"))[0].numpy()
    mass = maps[0].astype(np.float64).sum(axis=(0, 1))
    index = np.arange(CELLS)
    rows = np.where(
        mass > 1e-3, (maps[0].sum(axis=1, dtype=np.float64) * index[:, None]).sum(axis=0) / mass.clip(1e-9), 21
    )
    columns = np.where(
        mass > 1e-3, (maps[0].sum(axis=0, dtype=np.float64) * index[:, None]).sum(axis=0) / mass.clip(1e-9), 21
    )
    boxes = np.zeros((3, 15, 15))
    for row in range(CELLS):
        for column in range(CELLS):
            down = np.searchsorted(EDGES, row - round(rows[agent]), side="right") - 1
            right = np.searchsorted(EDGES, column - round(columns[agent]), side="right") - 1
            if 0 <= down < 15 and 0 <= right < 15:
                boxes[:, down, right] += maps[0, row, column]
    places = (np.stack([rows, columns], axis=1) - 21) / 10
    expected = [places[agent], (4 * places * (mass / (mass + 0.5))[:, None]).ravel(), 0.8 * mass.clip(max=5)]
    np.testing.assert_allclose(found, np.concatenate([*expected, 4 * np.tanh(boxes).ravel()]), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("readout", "width"), [("centroids", 11), ("grid", 675), ("both", 686)])
def test_the_configuration_knows_the_width(readout: str, width: int) -> None:
    assert config(readout).width == width
    assert read_maps(one_cell((1, 2, 0)), 0, config(readout)).shape == (1, width)
