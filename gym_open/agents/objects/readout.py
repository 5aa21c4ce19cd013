"""From maps to features: where the objects of each slot are, how many there are, and what surrounds the agent.

A *map* says how much of a slot lies in each cell of a grid of 42×42 cells over the image. Features that a policy
learns from quickly are coordinates: places as one number each. Codes of places, such as the activations of a
convolution, are not metric, and PPO hardly learns from them. Places are on the table (`plane`), in moves.
"""

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor

from gym_open.agents.config import BOXES, EncoderConfig
from gym_open.agents.objects.plane import CELLS, Plane
from gym_open.agents.symmetry import Turns, TurnsBuilder
from gym_open.agents.threads import in_parts
from gym_open.envs.jit import compiled

LENGTH = 7.0
"""A distance of d moves is written as d / LENGTH."""
EMPTY = 1e-3
"""A map of less mass is empty."""
EDGES = np.array([-17, -8.5, -5.3, -3.2, -2, -1.25, -0.75, -0.25, 0.25, 0.75, 1.25, 2, 3.2, 5.3, 8.5, 17])
"""Edges of the boxes around the agent, in moves: narrow ones near the agent, wide ones far from it."""
WALLS = [(1, 0), (0, 1), (-1, 0), (0, -1)]
"""Directions (x, y) of the table's walls, in the order of the features."""


def centroids(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Mass of each map and its centroid (row, column) in cells, with gradients.

    `mass[k] = Σ map[y, x, k]`, `centroid[k] = Σ map[y, x, k] · (y, x) / mass[k]`; the middle if the map is empty.

    Args:
        maps: (B, 42, 42, K) float32, not negative.

    Returns:
        Masses (B, K) and centroids (B, K, 2).
    """
    middle = (CELLS - 1) / 2
    mass = maps.sum(dim=(1, 2))
    cells = torch.arange(CELLS, dtype=torch.float32, device=maps.device) - middle
    down, right = (maps.sum(dim=2) * cells[:, None]).sum(dim=1), (maps.sum(dim=1) * cells[:, None]).sum(dim=1)
    return mass, middle + torch.stack([down, right], dim=2) / mass.clamp(min=EMPTY)[..., None]


def read_maps(maps: Tensor, agent: int, plane: Plane, reach: np.ndarray, config: EncoderConfig) -> Tensor:
    """Features of maps as `config.readout` says, without gradients. Distances are written as moves / 7.

    - `centroids`: distances of the agent to the walls on the right, behind, on the left and in front (4); per slot,
      2 · (centroid − agent) · mass / (mass + ½) (2 K); per slot, .8 · min(mass, 5) (K).
    - `grid`: per slot and box around the agent, 4 · tanh(mass in the box) (15 · 15 · K).
    - `both`: the one after the other.

    Args:
        maps: (B, 42, 42, K) float32, not negative.
        agent: slot of the agent.
        plane: where the cells are on the table, and their weights.
        reach: how far the agent gets from the table's middle along x and y, (2,), in moves.
        config: says which features.

    Returns:
        (B, `config.width`) float32.
    """
    grids = np.ascontiguousarray(maps.detach().cpu().numpy())
    out = np.zeros((len(grids), config.width), np.float32)
    with_centroids, with_grid = config.readout != "grid", config.readout != "centroids"

    def work(begin: int, end: int) -> None:
        _read(
            grids[begin:end],
            agent,
            plane.places,
            plane.weights,
            reach,
            EDGES,
            with_centroids,
            with_grid,
            out[begin:end],
        )

    in_parts(len(grids), work)
    return torch.from_numpy(out).to(maps.device)


@cache
def turns_of(config: EncoderConfig) -> Turns:
    """What the symmetries of the table do to the features of `read_maps`."""
    builder = TurnsBuilder()
    if config.readout != "grid":
        builder.directions(WALLS)
        builder.vectors(config.slots)
        builder.scalars(config.slots)
    if config.readout != "centroids":
        boxes = np.moveaxis(np.indices((BOXES, BOXES)), 0, -1).reshape(-1, 2) - BOXES // 2
        builder.places(boxes, count=config.slots)
    return builder.build()


@compiled
def _read(  # noqa: PLR0917  (compiled code takes arguments by position)
    maps: np.ndarray, agent: int, places: np.ndarray, weights: np.ndarray, reach: np.ndarray, edges: np.ndarray,
    with_centroids: bool, with_grid: bool, out: np.ndarray,
) -> None:  # fmt: skip
    """`read_maps` on arrays; `out` holds zeros."""
    n, _, _, slots = maps.shape
    mass, centre = np.empty(slots), np.empty((slots, 2))
    for i in range(n):
        _locate(maps[i], places, weights, mass, centre)
        begin = 0
        if with_centroids:
            begin = 4 + 3 * slots
            _write_centroids(mass, centre, agent, reach, out[i])
        if with_grid:
            _write_grid(maps[i], places, weights, centre[agent, 0], centre[agent, 1], edges, out[i, begin:])


@compiled
def _locate(maps: np.ndarray, places: np.ndarray, weights: np.ndarray, mass: np.ndarray, centre: np.ndarray) -> None:
    """Mass and centroid (x, y) of each slot; the middle of the table if its map is empty."""
    cells, _, slots = maps.shape
    mass[:] = 0
    centre[:] = 0
    for y in range(cells):
        for x in range(cells):
            for k in range(slots):
                value = maps[y, x, k] * weights[y, x]
                mass[k] += value
                centre[k, 0] += value * places[y, x, 0]
                centre[k, 1] += value * places[y, x, 1]
    for k in range(slots):
        for axis in range(2):
            centre[k, axis] = centre[k, axis] / mass[k] if mass[k] > EMPTY else 0.0


@compiled
def _write_centroids(mass: np.ndarray, centre: np.ndarray, agent: int, reach: np.ndarray, out: np.ndarray) -> None:
    slots = len(mass)
    for axis in range(2):
        out[axis] = (reach[axis] - centre[agent, axis]) / LENGTH
        out[2 + axis] = (reach[axis] + centre[agent, axis]) / LENGTH
    for k in range(slots):
        for axis in range(2):
            away = (centre[k, axis] - centre[agent, axis]) / LENGTH
            out[4 + 2 * k + axis] = 2 * away * mass[k] / (mass[k] + 0.5)
        out[4 + 2 * slots + k] = 0.8 * min(mass[k], 5.0)


@compiled
def _write_grid(  # noqa: PLR0917  (compiled code takes arguments by position)
    maps: np.ndarray, places: np.ndarray, weights: np.ndarray, x0: float, y0: float, edges: np.ndarray, out: np.ndarray
) -> None:
    cells, _, slots = maps.shape
    for y in range(cells):
        for x in range(cells):
            for k in range(slots):
                if maps[y, x, k] > 0:
                    i = np.searchsorted(edges, places[y, x, 0] - x0, side="right") - 1
                    j = np.searchsorted(edges, places[y, x, 1] - y0, side="right") - 1
                    if 0 <= i < BOXES and 0 <= j < BOXES:
                        out[(k * BOXES + i) * BOXES + j] += maps[y, x, k] * weights[y, x]
    for f in range(len(out)):
        if out[f] > 0:
            out[f] = 4 * math.tanh(out[f])
