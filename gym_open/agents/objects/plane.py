"""The table as the agent's own moves measure it: a homography from the image to the plane on which the agent moves.

The camera sees the table at an angle, so a move is many pixels long near the camera and few far from it. A homography H
takes places in the image to places on the table (Hartley & Zisserman 2004, chapter 2). In exploration, every free move
shows one side of it: the agent's centroid goes from p to p′, and H(p′) − H(p) must be the move's direction. So H is
fitted to moves alone, without knowing the camera. The unit of length is one move along an axis.
"""

from typing import NamedTuple

import numpy as np

CELLS = 42
"""Edge of a map: half the edge of an observation."""
UNFITTED = np.diag([CELLS / 4, CELLS / 4, 1.0])
"""The homography of an encoder that stays in the image: its unit is two cells, about a move in the table's middle."""
ROUNDS = 4
"""Fits; before each but the first, moves that something blocked are left out."""
BLOCKED = 0.3
"""A move whose length differs by more than this was blocked, or the agent was not seen."""
SOFT = 0.1
"""Differences beyond this count linearly, not squared."""
EDGE = 0.003
"""Share of the agent's places beyond each end of the table."""
FEWEST = 50
"""Free moves that a fit needs."""
DENSITY, DENSEST = 8.0, 4.0
"""Mass of a unit of area of the table, and the largest of a cell: cells behind the table see a large area."""


class Plane(NamedTuple):
    """Where the cells of a map are on the table."""

    places: np.ndarray
    """(x, y) of each cell, (42, 42, 2) float64, in moves from the middle of the table."""
    weights: np.ndarray
    """Mass of each cell if an object fills it, (42, 42) float64."""


class PlaneFit(NamedTuple):
    """A homography, the extent of the table, and how well the moves agree with them."""

    homography: np.ndarray
    """(3, 3): from (x, y, 1) in the image, −1 … 1 to the right and up, to the table."""
    reach: np.ndarray
    """How far from the middle the agent gets along x and y, (2,), in moves."""
    moves: int
    """Moves that agree with the homography."""
    error: float
    """Median distance, in moves, between where these moves should end and where they end."""


def fit_plane(before: np.ndarray, after: np.ndarray, directions: np.ndarray) -> PlaneFit | None:
    """Fit a homography to M moves of the agent.

    Args:
        before: places of the agent before each move, (M, 2) as (row, column) in cells of a map.
        after: the same after it.
        directions: direction (x, y) of each move on the table, (M, 2); (0, 0) for none.

    Returns:
        None if fewer than `FEWEST` moves, or less than a third of them, agree with any homography.
    """
    begin, end = in_image(before), in_image(after)
    tried = (directions != 0).any(axis=1)
    if tried.sum() < FEWEST:
        return None
    slope, *_ = np.linalg.lstsq(directions[tried], (end - begin)[tried], rcond=None)
    if abs(np.linalg.det(slope)) < 1e-8:
        return None
    start = np.eye(3)
    start[:2, :2] = np.linalg.inv(slope).T
    homography, free, errors = start, tried, np.zeros(len(tried))
    for _ in range(ROUNDS):
        homography = _fit(homography, begin[free], end[free], directions[free])
        errors = np.linalg.norm(project(homography, end) - project(homography, begin) - directions, axis=1)
        free = tried & (errors < BLOCKED)
        if free.sum() < max(FEWEST, tried.sum() / 3):
            return None
    visited = project(homography, np.concatenate([begin, end])[np.tile(free, 2)])
    low, high = np.quantile(visited, [EDGE, 1 - EDGE], axis=0)
    homography[:2] -= ((low + high) / 2)[:, None] * homography[2]
    return PlaneFit(homography, (high - low) / 2, int(free.sum()), float(np.median(errors[free])))


def _fit(start: np.ndarray, begin: np.ndarray, end: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The homography, (3, 3), that explains the moves best; the search begins at `start`."""

    def misses(numbers: np.ndarray) -> np.ndarray:
        homography = _matrix(numbers)
        moved = project(homography, end) - project(homography, begin) - directions
        return np.append(moved.ravel(), SOFT * numbers[[2, 5]])  # moves do not say where the middle is

    from scipy.optimize import least_squares

    return _matrix(least_squares(misses, start.ravel()[:8], loss="soft_l1", f_scale=SOFT).x)


def _matrix(numbers: np.ndarray) -> np.ndarray:
    """A homography from its eight free numbers."""
    return np.append(numbers, 1.0).reshape(3, 3)


def in_image(cells: np.ndarray) -> np.ndarray:
    """(row, column) in cells, (…, 2), to (x, y) in −1 … 1, to the right and up."""
    middle = (CELLS - 1) / 2
    return np.stack([cells[..., 1] - middle, middle - cells[..., 0]], axis=-1) / (CELLS / 2)


def project(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Places (…, 2) on the table of points (…, 2) in the image."""
    lifted = points @ homography[:, :2].T + homography[:, 2]
    return lifted[..., :2] / lifted[..., 2:]


def plane_of(homography: np.ndarray) -> Plane:
    """Place and weight of each cell of a map."""
    cells = np.moveaxis(np.indices((CELLS, CELLS)), 0, -1).astype(np.float64)
    down, right = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    along = [project(homography, in_image(cells + step)) - project(homography, in_image(cells - step))
             for step in (down, right)]  # fmt: skip
    area = np.abs(along[0][..., 0] * along[1][..., 1] - along[0][..., 1] * along[1][..., 0])
    return Plane(project(homography, in_image(cells)), np.minimum(DENSITY * area, DENSEST))
