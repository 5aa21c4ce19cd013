"""Data that the agents' tests learn from."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch

from gym_open import seeding
from gym_open.agents.threads import threads
from gym_open.agents.world_model import TransitionBatch
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.world import World


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with threads(1):
        yield


@pytest.fixture
def make_images() -> Callable[..., torch.Tensor]:
    """`make_images(count, seed)`: each image shows one square of a random colour at a random place."""

    def draw(count: int, seed: int = 0) -> torch.Tensor:
        rng = np.random.default_rng(seed)
        images = np.full((count, 84, 84, 3), 90, np.uint8)
        for image in images:
            row, column = rng.integers(10, 60, 2)
            image[row : row + 12, column : column + 12] = rng.integers(0, 256, 3)
        return torch.from_numpy(images)

    return draw


@pytest.fixture(scope="session")
def random_play() -> Callable[[int, int], TransitionBatch]:
    """`random_play(n, seed)`: n steps with uniformly random actions in a sandbox world that depends on the seed."""

    def play(n: int, seed: int) -> TransitionBatch:
        rng = seeding.generator(seed, "test", "random play")
        world = World()
        world.load(sample_puzzle("sandbox", rng))
        images = np.empty((n + 1, 84, 84, 3), np.uint8)
        actions = rng.integers(0, N_ACTIONS, n)
        world.observe(images[0])
        for action, image in zip(actions, images[1:], strict=True):
            world.step(int(action))
            world.observe(image)
        seen = torch.from_numpy(images)
        return TransitionBatch(seen[:-1], torch.from_numpy(actions), seen[1:])

    return play
