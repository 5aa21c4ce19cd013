"""The analysis of features, checked by closed forms and other search algorithms."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from gym_open.viz.features.analysis import (
    FeatureAnalysis,
    agent_apart,
    analyse,
    components_for,
    effective_rank,
    same_world,
)
from gym_open.viz.features.frames import Frames


def made(deviations: list[float], n: int = 200, width: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Features with known directions and standard deviations, and the points that they were made from."""
    rng = np.random.default_rng(3)
    scores = rng.normal(size=(n, len(deviations)))
    scores = np.linalg.qr(scores - scores.mean(axis=0))[0] * np.sqrt(n) * deviations
    directions = np.linalg.qr(rng.normal(size=(width, len(deviations))))[0].T
    return scores @ directions + rng.normal(size=width), scores


def test_components_are_the_directions_from_which_features_were_made() -> None:
    features, scores = made([4.0, 2.0, 1.0])
    found = analyse(features)
    assert found.explained[:3] == pytest.approx(np.array([16, 4, 1]) / 21)
    assert found.explained[3:] == pytest.approx(0, abs=1e-12)
    for i in range(3):
        expected = scores[:, i] / 4.0
        assert np.allclose(found.points[:, i], expected) or np.allclose(found.points[:, i], -expected)
    assert (components_for(found.explained, 0.7), components_for(found.explained, 0.9)) == (1, 2)


def test_signs_do_not_depend_on_the_order_of_images() -> None:
    features, _ = made([4.0, 2.0, 1.0])
    order = np.random.default_rng(0).permutation(len(features))
    assert np.allclose(analyse(features[order]).points, analyse(features).points[order])
    assert np.allclose(
        analyse(10 * features).points, analyse(features).points
    )  # in units of the first standard deviation


def test_the_effective_rank_of_equal_directions_is_their_number() -> None:
    assert effective_rank(np.array([3.0, 3.0, 3.0, 3.0])) == pytest.approx(4)
    assert effective_rank(np.array([5.0, 0.0])) == pytest.approx(1)
    two_to_one = np.exp(-(2 / 3 * np.log(2 / 3) + 1 / 3 * np.log(1 / 3)))
    assert effective_rank(np.array([2.0, 1.0])) == pytest.approx(two_to_one)
    assert analyse(made([1.0] * 5)[0]).rank == pytest.approx(5)


def test_neighbours_are_those_of_a_tree_search() -> None:
    features = np.random.default_rng(1).normal(size=(60, 5))
    found = analyse(features, neighbours=3)
    distances, near = KDTree(features).query(features, k=4)
    assert np.array_equal(found.near, np.asarray(near)[:, 1:])
    every = np.linalg.norm(features[:, None] - features, axis=2)
    mean = every[~np.eye(60, dtype=bool)].mean()
    assert found.distances == pytest.approx(distances[:, 1:] / mean)


def test_dead_units_are_those_that_never_change() -> None:
    features = np.random.default_rng(1).normal(size=(30, 6)).astype(np.float32)
    features[:, [0, 4]] = 0.0
    features[:, 2] = 7.5
    assert analyse(features).dead == 3


@pytest.mark.parametrize(("n", "k"), [(1, 0), (2, 1), (3, 2)])
def test_few_images_and_constant_features_are_no_error(n: int, k: int) -> None:
    for features in (np.zeros((n, 4)), np.arange(4.0 * n).reshape(n, 4)):
        found = analyse(features)
        assert found.near.shape == found.distances.shape == (n, k)
        assert found.points.shape == (n, 3)
        assert np.isfinite(found.points).all()
        assert np.isfinite(found.explained).all()
    constant: FeatureAnalysis = analyse(np.zeros((n, 4)))
    assert (constant.rank, constant.dead, components_for(constant.explained, 0.9)) == (0.0, 4, 0)


def test_share_of_the_same_world_and_distance_of_the_agent() -> None:
    frames = Frames(
        origin="", images=np.zeros((3, 84, 84, 3), np.uint8), captions=["", "", ""], worlds=np.array([0, 0, 1]),
        agent=np.array([[0.0, 0.0], [0.141, 0.0], [0.0, 0.423]]), goal=np.zeros(3),
    )  # fmt: skip
    assert same_world(frames, np.array([[1], [0], [0]])) == pytest.approx(2 / 3)
    assert agent_apart(frames, np.array([[1], [0], [0]])) == pytest.approx(1.0)  # of 1, 1 and 3 cells
