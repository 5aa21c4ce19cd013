"""Data for linear probes: random moves in new sandbox worlds, with true positions and contacts."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gym_open import progress, seeding
from gym_open.envs.constants import IMAGE_SIZE, N_ACTIONS
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World

BODIES = {"agent": "agent", "yellow": "yellow_0", "green": "green_0", "heavy": "heavy_0", "light": "light_0"}
"""Names of the bodies whose positions are probed, and the bodies in the model."""
ONE_OF_EACH = SandboxConfig(yellow=(1, 1), green=(1, 1), heavy=(1, 1), light=(1, 1))
"""Worlds with exactly one heavy cube and so on, so that its position is a function of the image."""
MOVES = N_ACTIONS - 1
"""Number of actions in probe worlds: all except the no-op, which changes nothing."""
WARM_UP = 8
"""Random moves before the first image, so that bodies no longer lie where the layout puts them."""


@dataclass(frozen=True)
class ProbeSample:
    """W worlds with T moves each, and an image before the first move and after every move."""

    images: Tensor
    """(W, T + 1, 84, 84, 3) uint8."""
    positions: Tensor
    """(W, T + 1, 5, 2) float64: positions on the table in metres, in the order of `BODIES`."""
    moves: Tensor
    """(W, T) int64 in 0…7: the action minus one."""
    contacts: Tensor
    """(W, T) bool: whether the agent touched something other than the ground in the move."""


def draw_samples(sizes: Mapping[str, int], moves: int, known: set[str], seed: int) -> dict[str, ProbeSample]:
    """Draw new sandbox worlds by part; warm each of them up, then make `moves` random moves.

    No layout is in `known` (digests), and none is drawn twice.
    """
    world, used, samples = World(), set(known), {}
    bodies = [INVENTORY.index(body) for body in BODIES.values()]
    with progress.bar("draw probe worlds", sum(sizes.values())) as bar:
        for part, size in sizes.items():
            rng = seeding.generator(seed, "probe", part)
            images = np.empty((size, moves + 1, IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
            positions = np.empty((size, moves + 1, len(bodies), 2))
            chosen, contacts = np.empty((size, moves), np.int64), np.empty((size, moves), bool)
            for i in range(size):
                world.load(_fresh_puzzle(rng, used))
                for move in rng.integers(MOVES, size=WARM_UP).tolist():
                    world.step(move + 1)
                chosen[i] = rng.integers(MOVES, size=moves)
                for j in range(moves + 1):
                    if j:
                        touched = world.step(int(chosen[i, j - 1]) + 1).contacts
                        contacts[i, j - 1] = any("agent" in (contact.a, contact.b) for contact in touched)
                    world.observe(images[i, j])
                    positions[i, j] = world.object_state()[bodies, :2]
                bar.advance()
            arrays = (torch.from_numpy(array) for array in (images, positions, chosen, contacts))
            samples[part] = ProbeSample(*arrays)
    return samples


def _fresh_puzzle(rng: np.random.Generator, used: set[str]) -> Puzzle:
    while True:
        puzzle = sample_puzzle("sandbox", rng, ONE_OF_EACH)
        if puzzle.digest not in used:
            used.add(puzzle.digest)
            return puzzle
