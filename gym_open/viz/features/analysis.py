"""What an encoder makes of pictures: principal components, neighbours, and how much of its width it uses."""

import msgspec
import numpy as np

from gym_open.envs.constants import PITCH
from gym_open.viz.features.frames import Frames

NEIGHBOURS = 4


class Analysis(msgspec.Struct, frozen=True, eq=False):
    """Features (n, D) of n pictures, looked at."""

    width: int
    """D."""
    points: np.ndarray
    """(n, 3): the first principal components, in units of the deviation along the first."""
    explained: np.ndarray
    """(min(n, D),): share of the variance along each component, falling; zeros if all features are constant."""
    rank: float
    """Effective rank (Roy and Vetterli 2007): e to the entropy of the singular values; from 1 to D."""
    dead: int
    """Units that have one and the same value on all pictures."""
    near: np.ndarray
    """(n, k) int64: the nearest other pictures by Euclidean distance of features, nearest first."""
    distances: np.ndarray
    """(n, k): how far they are, in units of the mean distance of two pictures."""


def analyse(features: np.ndarray, neighbours: int = NEIGHBOURS) -> Analysis:
    """Look at features (n, D); fewer than n neighbours are found if there are fewer other pictures."""
    from scipy.spatial.distance import cdist

    features = np.asarray(features, dtype=np.float64)
    centred = features - features.mean(axis=0)
    points, singular = _components(centred)
    variance = singular**2
    total = variance.sum()
    apart = cdist(centred, centred)
    mean = apart.sum() / max(len(apart) * (len(apart) - 1), 1)
    np.fill_diagonal(apart, np.inf)
    near = np.argsort(apart, axis=1, kind="stable")[:, : min(neighbours, len(apart) - 1)]
    return Analysis(
        width=features.shape[1],
        points=points,
        explained=variance / total if total else variance,
        rank=effective_rank(singular),
        dead=int((features == features[0]).all(axis=0).sum()),
        near=near,
        distances=np.take_along_axis(apart, near, axis=1) / (mean or 1.0),
    )


def _components(centred: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first three components (n, 3) and all singular values; a component's largest weight is positive."""
    left, singular, right = np.linalg.svd(centred, full_matrices=False)
    signs = np.sign(right[np.arange(len(right)), np.abs(right).argmax(axis=1)])
    points = np.zeros((len(centred), 3))
    scaled = (left * singular * signs)[:, :3]
    points[:, : scaled.shape[1]] = scaled
    deviation = points[:, 0].std()
    return points / (deviation or 1.0), singular


def effective_rank(singular: np.ndarray) -> float:
    """Roy and Vetterli's effective rank of a matrix with these singular values; 0 of one that is zero."""
    shares = singular[singular > 0] / max(singular.sum(), np.finfo(float).tiny)
    return float(np.exp(-(shares * np.log(shares)).sum())) if shares.size else 0.0


def components_for(explained: np.ndarray, share: float) -> int:
    """How many components hold `share` of the variance."""
    return int(np.searchsorted(np.cumsum(explained), share - 1e-12) + 1) if explained.any() else 0


def same_world(frames: Frames, near: np.ndarray) -> float:
    """Share of pictures whose neighbours (n, k) are of the same world, over all k."""
    return float((frames.worlds[near] == frames.worlds[:, None]).mean())


def agent_apart(frames: Frames, near: np.ndarray) -> float:
    """Median distance, in cells of the grid, of the agent in a picture and in its neighbours (n, k)."""
    return float(np.median(np.linalg.norm(frames.agent[near] - frames.agent[:, None], axis=2)) / PITCH)
