"""From maps to features: where the objects of each slot are, how many there are, and what surrounds the agent.

A *map* says how much of a slot lies in each cell of a grid of 42×42 cells over the image. Features that a policy
learns from quickly are coordinates: places as one number each. Codes of places, such as the activations of a
convolution, are not metric, and PPO hardly learns from them.
"""

import math

import numpy as np
import torch
from torch import Tensor

from gym_open.agents.config import BOXES, EncoderConfig
from gym_open.agents.threads import in_parts
from gym_open.envs.jit import compiled

CELLS = 42
"""Edge of a map: half the edge of an observation."""
MIDDLE, LENGTH = 21.0, 10.0
"""A coordinate c in cells is written as `(c − MIDDLE) / LENGTH`."""
EMPTY = 1e-3
"""A map of less mass is empty."""
EDGES = (-40, -21, -12, -7, -4, -2, -1, 0, 1, 2, 3, 5, 8, 13, 22, 41)
"""Edges of the boxes around the agent, in cells: narrow ones near the agent, wide ones far from it."""
_FURTHEST = CELLS + 1
_BOX = np.searchsorted(EDGES, np.arange(-_FURTHEST, _FURTHEST + 1), side="right") - 1
_BOX[_BOX >= BOXES] = -1
"""Box of each distance −43 … 43 from the agent, in cells; −1 beyond the last edge."""


def centroids(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Mass of each map and its centroid (row, column) in cells, with gradients.

    `mass[k] = Σ map[y, x, k]`, `centroid[k] = Σ map[y, x, k] · (y, x) / mass[k]`; the middle if the map is empty.

    Args:
        maps: (B, 42, 42, K) float32, not negative.

    Returns:
        Masses (B, K) and centroids (B, K, 2).
    """
    mass = maps.sum(dim=(1, 2))
    cells = torch.arange(CELLS, dtype=torch.float32, device=maps.device) - MIDDLE
    down, right = (maps.sum(dim=2) * cells[:, None]).sum(dim=1), (maps.sum(dim=1) * cells[:, None]).sum(dim=1)
    return mass, MIDDLE + torch.stack([down, right], dim=2) / mass.clamp(min=EMPTY)[..., None]


def read_maps(maps: Tensor, agent: int, config: EncoderConfig) -> Tensor:
    """Features of maps as `config.readout` says, without gradients.

    - `centroids`: centroid of the agent's slot (2); per slot 4 · centroid · mass / (mass + ½) (2 K); per slot
      .8 · min(mass, 5) (K). Centroids are written as `(c − 21) / 10`.
    - `grid`: per slot and box around the agent, 4 · tanh(mass in the box) (15 · 15 · K).
    - `both`: the one after the other.

    Args:
        maps: (B, 42, 42, K) float32, not negative.
        agent: slot of the agent.
        config: says which features.

    Returns:
        (B, `config.width`) float32.
    """
    grids = np.ascontiguousarray(maps.detach().cpu().numpy())
    out = np.zeros((len(grids), config.width), np.float32)

    with_centroids, with_grid = config.readout != "grid", config.readout != "centroids"

    def work(begin: int, end: int) -> None:
        _read(grids[begin:end], agent, _BOX, with_centroids, with_grid, out[begin:end])

    in_parts(len(grids), work)
    return torch.from_numpy(out).to(maps.device)


@compiled
def _read(  # noqa: PLR0917  (compiled code takes arguments by position)
    maps: np.ndarray, agent: int, box: np.ndarray, with_centroids: bool, with_grid: bool, out: np.ndarray
) -> None:
    """`read_maps` on arrays; `out` holds zeros."""
    n, _, _, slots = maps.shape
    mass, place = np.empty(slots), np.empty((slots, 2))
    for i in range(n):
        _locate(maps[i], mass, place)
        begin = 0
        if with_centroids:
            begin = 2 + 3 * slots
            _write_centroids(mass, place, agent, out[i])
        if with_grid:
            _write_grid(maps[i], round(place[agent, 0]), round(place[agent, 1]), box, out[i, begin:])


@compiled
def _locate(maps: np.ndarray, mass: np.ndarray, place: np.ndarray) -> None:
    """Mass and centroid of each slot; the middle if its map is empty."""
    cells, _, slots = maps.shape
    mass[:] = 0
    place[:] = 0
    for y in range(cells):
        for x in range(cells):
            for k in range(slots):
                value = maps[y, x, k]
                mass[k] += value
                place[k, 0] += value * y
                place[k, 1] += value * x
    for k in range(slots):
        for axis in range(2):
            place[k, axis] = place[k, axis] / mass[k] if mass[k] > EMPTY else MIDDLE


@compiled
def _write_centroids(mass: np.ndarray, place: np.ndarray, agent: int, out: np.ndarray) -> None:
    slots = len(mass)
    for axis in range(2):
        out[axis] = (place[agent, axis] - MIDDLE) / LENGTH
    for k in range(slots):
        for axis in range(2):
            out[2 + 2 * k + axis] = 4 * (place[k, axis] - MIDDLE) / LENGTH * mass[k] / (mass[k] + 0.5)
        out[2 + 2 * slots + k] = 0.8 * min(mass[k], 5.0)


@compiled
def _write_grid(maps: np.ndarray, top: int, left: int, box: np.ndarray, out: np.ndarray) -> None:
    cells, _, slots = maps.shape
    for y in range(cells):
        row = box[y - top + _FURTHEST]
        for x in range(cells):
            column = box[x - left + _FURTHEST]
            if row >= 0 and column >= 0:
                for k in range(slots):
                    out[(k * BOXES + row) * BOXES + column] += maps[y, x, k]
    for f in range(len(out)):
        if out[f] > 0:
            out[f] = 4 * math.tanh(out[f])
