"""Analysis of features: principal components, nearest neighbours, effective rank and dead units."""

import msgspec
import numpy as np

from gym_open.envs.constants import PITCH
from gym_open.viz.features.frames import Frames

NEIGHBOURS = 4


class FeatureAnalysis(msgspec.Struct, frozen=True, eq=False):
    """What an analysis of features (n, D) of n images found."""

    width: int
    """D."""
    points: np.ndarray
    """First three principal components, (n, 3), in units of the standard deviation along the first."""
    explained: np.ndarray
    """Share of the variance along each component, (min(n, D),), falling; zeros if all features are constant."""
    rank: float
    """Effective rank (Roy and Vetterli 2007): exp of the entropy of the singular values; from 1 to D."""
    dead: int
    """Number of units with the same value for all images."""
    near: np.ndarray
    """The nearest other images by Euclidean distance of features, (n, k) int64, nearest first."""
    distances: np.ndarray
    """Their distances, (n, k), in units of the mean distance of two images."""


def analyse(features: np.ndarray, neighbours: int = NEIGHBOURS) -> FeatureAnalysis:
    """Analyse features (n, D); there are fewer neighbours if there are fewer other images."""
    from scipy.spatial.distance import cdist

    features = np.asarray(features, dtype=np.float64)
    centred = features - features.mean(axis=0)
    points, singular = _components(centred)
    variance = singular**2
    total = variance.sum()
    distances = cdist(centred, centred)
    mean = distances.sum() / max(len(distances) * (len(distances) - 1), 1)
    np.fill_diagonal(distances, np.inf)
    near = np.argsort(distances, axis=1, kind="stable")[:, : min(neighbours, len(distances) - 1)]
    return FeatureAnalysis(
        width=features.shape[1],
        points=points,
        explained=variance / total if total else variance,
        rank=effective_rank(singular),
        dead=int((features == features[0]).all(axis=0).sum()),
        near=near,
        distances=np.take_along_axis(distances, near, axis=1) / (mean or 1.0),
    )


def _components(centred: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first three components (n, 3) and all singular values; each component's largest weight is positive."""
    left, singular, right = np.linalg.svd(centred, full_matrices=False)
    signs = np.sign(right[np.arange(len(right)), np.abs(right).argmax(axis=1)])
    points = np.zeros((len(centred), 3))
    scaled = (left * singular * signs)[:, :3]
    points[:, : scaled.shape[1]] = scaled
    deviation = points[:, 0].std()
    return points / (deviation or 1.0), singular


def effective_rank(singular: np.ndarray) -> float:
    """Roy and Vetterli's effective rank of a matrix with these singular values; 0 for a zero matrix."""
    shares = singular[singular > 0] / max(singular.sum(), np.finfo(float).tiny)
    return float(np.exp(-(shares * np.log(shares)).sum())) if shares.size else 0.0


def components_for(explained: np.ndarray, share: float) -> int:
    """Number of components that together have `share` of the variance."""
    return int(np.searchsorted(np.cumsum(explained), share - 1e-12) + 1) if explained.any() else 0


def same_world(frames: Frames, near: np.ndarray) -> float:
    """Share of all neighbours (n, k) that show the same world as their image."""
    return float((frames.worlds[near] == frames.worlds[:, None]).mean())


def agent_apart(frames: Frames, near: np.ndarray) -> float:
    """Median distance, in cells of the grid, between the agent in an image and in its neighbours (n, k)."""
    return float(np.median(np.linalg.norm(frames.agent[near] - frames.agent[:, None], axis=2)) / PITCH)
