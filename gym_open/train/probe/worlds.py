"""What a linear probe looks at: random play in fresh sandbox worlds, with the truth about it."""

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
"""What is looked for, and its body in the model."""
ONE_OF_EACH = SandboxConfig(yellow=(1, 1), green=(1, 1), heavy=(1, 1), light=(1, 1))
"""Worlds where "the heavy cube" means one thing, so that its position is a function of the picture."""
MOVES = N_ACTIONS - 1
"""Actions that a probe world is played by: all but the no-op, which changes nothing."""
WARM_UP = 8
"""Random moves before the first picture, so that things no longer lie where worlds are laid out."""


@dataclass(frozen=True)
class Sample:
    """Play in W worlds, T moves in each, and a picture before the first of them and after every one."""

    images: Tensor
    """(W, T + 1, 84, 84, 3) uint8."""
    positions: Tensor
    """(W, T + 1, 5, 2) float64: on the table, in metres, in the order of `BODIES`."""
    moves: Tensor
    """(W, T) int64 in 0…7: the action, less one."""
    contacts: Tensor
    """(W, T) bool: whether the agent touched something other than the ground during the move."""


def draw_samples(sizes: Mapping[str, int], moves: int, known: set[str], seed: int) -> dict[str, Sample]:
    """Fresh sandbox worlds by part, each warmed up and then played for `moves` random moves.

    No world is in `known` (digests of layouts), and none is drawn twice.
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
            samples[part] = Sample(*arrays)
    return samples


def _fresh_puzzle(rng: np.random.Generator, used: set[str]) -> Puzzle:
    while True:
        puzzle = sample_puzzle("sandbox", rng, ONE_OF_EACH)
        if puzzle.digest not in used:
            used.add(puzzle.digest)
            return puzzle
