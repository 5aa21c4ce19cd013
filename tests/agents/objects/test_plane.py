"""The table from the agent's moves: a homography that is known here, and the true camera of the world."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.agents.objects.plane import CELLS, FEWEST, UNFITTED, fit_plane, in_image, plane_of, project
from gym_open.envs.constants import MOVES

DIRECTIONS = np.array(MOVES, np.float64)


def in_cells(points: np.ndarray) -> np.ndarray:
    """The inverse of `in_image`."""
    middle = (CELLS - 1) / 2
    return np.stack([middle - points[..., 1] * CELLS / 2, middle + points[..., 0] * CELLS / 2], axis=-1)


def camera(yaw: float, tilt: float) -> np.ndarray:
    """A homography from the image to a table of about 8 × 15 moves."""
    turned = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    tilted = np.array([[5.0, 0, 0], [0, 9.0, 0], [0, tilt, 1]])
    return turned @ tilted


def moves(homography: np.ndarray, n: int, rng: np.random.Generator, blocked: float, noise: float) -> list[np.ndarray]:
    """Places before and after n moves, in cells, and their directions. Some moves are blocked; places are inexact."""
    begin = rng.uniform([-4, -5], [4, 5], (n, 2))
    directions = DIRECTIONS[rng.integers(0, 9, n)]
    free = (rng.random(n) >= blocked)[:, None]
    ends = [begin, np.clip(begin + directions * free, [-4, -5], [4, 5])]
    back = np.linalg.inv(homography)
    seen = [in_cells(project(back, end)) + noise * rng.standard_normal((n, 2)) for end in ends]
    return [*seen, directions]


def test_cells_and_the_image_have_one_middle() -> None:
    corners = np.array([[0.0, 0.0], [20.5, 20.5], [41.0, 41.0]])
    np.testing.assert_allclose(in_image(corners), [[-41 / 42, 41 / 42], [0, 0], [41 / 42, -41 / 42]])
    np.testing.assert_allclose(in_cells(in_image(corners)), corners)


@settings(max_examples=8, deadline=None)
@given(yaw=st.floats(-math.pi, math.pi), tilt=st.floats(-0.6, 0.6), seed=st.integers(0, 2**32 - 1))
def test_moves_give_back_the_homography(yaw: float, tilt: float, seed: int) -> None:
    """From any direction of the camera, a fifth of the moves blocked, each place a tenth of a cell off."""
    truth = camera(yaw, tilt)
    fit = fit_plane(*moves(truth, 1500, np.random.default_rng(seed), blocked=0.2, noise=0.1))
    assert fit is not None
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2))
    apart = project(fit.homography, points) - project(truth, points)
    assert np.linalg.norm(apart - apart.mean(axis=0), axis=1).max() < 0.3  # in moves; the middle is another one
    np.testing.assert_allclose(fit.reach, [4, 5], atol=0.3)
    assert fit.error < 0.15


def test_without_noise_the_fit_is_exact_and_its_middle_is_the_tables() -> None:
    truth = camera(0.4, 0.5)
    fit = fit_plane(*moves(truth, 2000, np.random.default_rng(0), blocked=0.0, noise=0.0))
    assert fit is not None
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2))
    np.testing.assert_allclose(project(fit.homography, points), project(truth, points), atol=0.1)
    assert fit.error < 1e-2  # a wall shortens some moves


@pytest.mark.parametrize("case", ["few", "unrelated", "unmoved"])
def test_what_shows_no_table_gives_none(case: str) -> None:
    rng = np.random.default_rng(0)
    before, after, directions = moves(camera(0.0, 0.3), FEWEST - 10 if case == "few" else 400, rng, 0.0, 0.0)
    if case == "unrelated":
        after = rng.uniform(0, 41, after.shape)
    if case == "unmoved":
        after = before
    assert fit_plane(before, after, directions) is None


def test_an_encoder_that_stays_in_the_image_has_the_images_plane() -> None:
    plane = plane_of(UNFITTED)
    np.testing.assert_allclose(plane.places[0, 0], [-10.25, 10.25])
    np.testing.assert_allclose(plane.places[20, 23] - plane.places[22, 21], [1, 1])
    np.testing.assert_allclose(plane.weights, 2.0)


def test_a_cell_weighs_what_it_covers_of_the_table() -> None:
    """Near the camera, where a cell covers little, it weighs little."""
    plane = plane_of(camera(0.0, -0.5))
    rows = plane.weights[5:37, 21]
    areas = np.abs(np.diff(plane.places[4:37, 21, 1])) * np.abs(np.diff(plane.places[5:37, 20:22, 0]))[:, 0]
    np.testing.assert_allclose(rows, np.minimum(8 * areas, 4), rtol=0.1)
    assert rows[0] > 2 * rows[-1]
