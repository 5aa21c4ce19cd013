"""Features of maps: closed forms, and the same numbers from plain loops."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gym_open.agents.config import EncoderConfig
from gym_open.agents.objects.plane import CELLS, UNFITTED, plane_of
from gym_open.agents.objects.readout import EDGES, centroids, read_maps, turns_of
from gym_open.agents.symmetry import ELEMENTS

IMAGE = plane_of(UNFITTED)
"""Two cells are one move, and a cell has the weight 2."""
REACH = np.array([10.5, 10.5])


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
    torch.testing.assert_close(places, torch.tensor([[[11.0, 23.0], [5.0, 7.0], [20.5, 20.5]]]))


def test_centroids_have_gradients() -> None:
    maps = one_cell((10, 20, 0), (12, 26, 0)).requires_grad_()
    centroids(maps)[1][0, 0, 0].backward()
    assert maps.grad is not None
    assert maps.grad[0, 12, 0, 0] == pytest.approx(0.5)  # (12 − 11) / 2


def read(maps: torch.Tensor, agent: int, readout: str) -> torch.Tensor:
    return read_maps(maps, agent, IMAGE, REACH, config(readout))[0]


def test_walls_come_first_then_places_then_masses() -> None:
    features = read(one_cell((10, 20, 1), (31, 41, 2)), 1, "centroids").tolist()
    x, y = (20 - 20.5) / 2, (20.5 - 10) / 2
    assert features[:4] == pytest.approx([(10.5 - x) / 7, (10.5 - y) / 7, (10.5 + x) / 7, (10.5 + y) / 7])
    weight = 2 * 2 / 2.5 / 7
    assert features[4:8] == pytest.approx([weight * -x * 0, 0, 0, 0])  # an empty slot, and the agent itself
    assert features[8:10] == pytest.approx([weight * 10.5, weight * -10.5])
    assert features[10:] == pytest.approx([0, 1.6, 1.6])


def test_the_grid_lies_around_the_agent() -> None:
    """What is four cells to the right of the agent is two moves away: on the edge of the tenth box."""
    features = read(one_cell((10, 20, 0), (10, 24, 1)), 0, "grid").view(3, 15, 15)
    assert features[0, 7, 7] == pytest.approx(4 * math.tanh(2))
    assert features[1, 11, 7] == pytest.approx(4 * math.tanh(2))
    assert features.count_nonzero() == 2
    assert EDGES[11] == 2


@given(seed=st.integers(0, 2**32 - 1), agent=st.integers(0, 2))
def test_features_are_those_of_plain_loops(seed: int, agent: int) -> None:
    rng = np.random.default_rng(seed)
    maps = (rng.random((1, CELLS, CELLS, 3)) * (rng.random((1, CELLS, CELLS, 3)) < rng.random())).astype(np.float32)
    found = read(torch.from_numpy(maps), agent, "both").numpy()
    weighed = maps[0].astype(np.float64) * IMAGE.weights[..., None]
    mass = weighed.sum(axis=(0, 1))
    centre = np.stack([(weighed * IMAGE.places[..., axis, None]).sum(axis=(0, 1)) for axis in (0, 1)], axis=1)
    centre = np.where(mass[:, None] > 1e-3, centre / mass.clip(1e-9)[:, None], 0.0)
    boxes = np.zeros((3, 15, 15))
    for row in range(CELLS):
        for column in range(CELLS):
            i, j = np.searchsorted(EDGES, IMAGE.places[row, column] - centre[agent], side="right") - 1
            if 0 <= i < 15 and 0 <= j < 15:
                boxes[:, i, j] += weighed[row, column]
    walls = np.concatenate([REACH - centre[agent], REACH + centre[agent]]) / 7
    places = 2 * (centre - centre[agent]) / 7 * (mass / (mass + 0.5))[:, None]
    expected = [walls, places.ravel(), 0.8 * mass.clip(max=5)]
    np.testing.assert_allclose(found, np.concatenate([*expected, 4 * np.tanh(boxes).ravel()]), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("readout", ["centroids", "grid", "both"])
def test_a_turned_table_gives_turned_features(readout: str) -> None:
    """Maps are turned by their cells, features by `turns_of`: both give the same."""
    rng = np.random.default_rng(3)
    maps = (rng.random((CELLS, CELLS, 3)) * (rng.random((CELLS, CELLS, 3)) < 0.02)).astype(np.float32)
    source, sign = turns_of(config(readout))
    features = read(torch.from_numpy(maps[None]), 1, readout)
    for g, element in enumerate(ELEMENTS):
        turned = np.zeros_like(maps)
        for row, column in np.argwhere(maps.any(axis=2)):
            x, y = element @ [column - 20.5, 20.5 - row]
            turned[int(20.5 - y), int(x + 20.5)] = maps[row, column]
        after = read(torch.from_numpy(turned[None]), 1, readout)
        torch.testing.assert_close(after, features[source[g]] * sign[g], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("readout", "width"), [("centroids", 13), ("grid", 675), ("both", 688)])
def test_the_configuration_knows_the_width(readout: str, width: int) -> None:
    assert config(readout).width == width
    assert read(one_cell((1, 2, 0)), 0, readout).shape == (width,)
