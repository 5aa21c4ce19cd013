"""The pool: the distinct sandbox worlds, with their states when they were left and the last transitions in each."""

import math

import numpy as np
import torch
import zstandard
from torch import Tensor

from gym_open import seeding
from gym_open.agents.explorer import Explorer
from gym_open.agents.world_model import TransitionBatch
from gym_open.collect.summary import WorldCounts
from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World
from gym_open.errors import GymOpenError


def sample_pool(size: int, sandbox: SandboxConfig, seed: int) -> tuple[Puzzle, ...]:
    """Draw `size` sandbox worlds with different layouts.

    Raises:
        GymOpenError: if the configuration allows too few different layouts.
    """
    rng = seeding.generator(seed, "collect", "pool")
    found: dict[str, Puzzle] = {}
    for _ in range(100 * size):
        puzzle = sample_puzzle("sandbox", rng, sandbox)
        found.setdefault(puzzle.digest, puzzle)
        if len(found) == size:
            return tuple(found.values())
    raise GymOpenError(f"`pool`: only {len(found)} different worlds of {sandbox}, expected {size}; give fewer")


class Pool:
    """The worlds, by index.

    Attributes:
        left: integration state of each world that was left, by index.
        counts: counts of each world.
    """

    def __init__(self, puzzles: tuple[Puzzle, ...], probe: int, seed: int) -> None:
        self.puzzles = puzzles
        self.left: dict[int, np.ndarray] = {}
        self.counts = [WorldCounts() for _ in puzzles]
        self._probe = probe
        self._seed = seed
        self._seen: list[dict[bytes, tuple[np.ndarray, int, np.ndarray]]] = [{} for _ in puzzles]

    def initial_images(self) -> np.ndarray:
        """Initial observation of every world, (pool, 84, 84, 3) uint8. The pool does not change."""
        world = World()
        looks: list[np.ndarray] = []
        for puzzle in self.puzzles:
            world.load(puzzle)
            looks.append(world.observe())
        return np.stack(looks)

    def see(self, world: int, obs: np.ndarray, actions: np.ndarray, next_obs: np.ndarray) -> None:
        """Keep the latest transitions of a world, one per distinct observation.

        No world model can tell equal images apart. Repeated observations would only limit how low the loss can fall.

        Args:
            world: index of the world.
            obs: observations, (T, 84, 84, 3) uint8.
            actions: actions taken at `obs`, (T,) int64.
            next_obs: observations that the actions led to, like `obs`.
        """
        seen = self._seen[world]
        for image, action, after in zip(obs, actions.tolist(), next_obs, strict=True):
            key = image.tobytes()
            seen.pop(key, None)
            seen[key] = image.copy(), action, after.copy()
        self._seen[world] = dict(list(seen.items())[-self._probe :])

    def transitions(self, world: int) -> TransitionBatch | None:
        """Kept transitions of a world, oldest first. None if there are none."""
        seen = self._seen[world]
        if not seen:
            return None
        obs, actions, after = zip(*seen.values(), strict=True)
        return TransitionBatch(
            torch.from_numpy(np.stack(obs)), torch.tensor(actions, dtype=torch.int64), torch.from_numpy(np.stack(after))
        )

    def loss(self, world: int, explorer: Explorer, rollout: int) -> float:
        """Scaled loss of the explorer's world model on the kept transitions of a world; infinite if there are none.

        Its randomness depends only on the seed, the world and the number of the rollout.
        """
        transitions = self.transitions(world)
        if transitions is None:
            return math.inf
        number = seeding.integer(self._seed, "collect", "probe", world, rollout)
        return explorer.world_loss(transitions, torch.Generator().manual_seed(number))

    def tensors(self) -> dict[str, Tensor]:
        """Transitions and left states by name. Images are compressed, to about 1/300."""
        found = {f"left/{index}": torch.from_numpy(state) for index, state in self.left.items()}
        for index in range(len(self.puzzles)):
            transitions = self.transitions(index)
            if transitions is not None:
                found[f"obs/{index}"] = _packed(transitions.obs)
                found[f"actions/{index}"] = transitions.actions
                found[f"next_obs/{index}"] = _packed(transitions.next_obs)
        return found

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore the state from the result of `tensors`."""
        for index in range(len(self.puzzles)):
            if f"left/{index}" in tensors:
                self.left[index] = tensors[f"left/{index}"].numpy()
            if f"obs/{index}" in tensors:
                obs, after = (_unpacked(tensors[f"{name}/{index}"]) for name in ("obs", "next_obs"))
                self.see(index, obs, tensors[f"actions/{index}"].numpy(), after)


def _packed(images: Tensor) -> Tensor:
    """Images (B, 84, 84, 3) uint8, compressed by Zstandard, as a tensor of bytes."""
    return torch.frombuffer(bytearray(zstandard.compress(images.numpy().tobytes(), 1)), dtype=torch.uint8)


def _unpacked(packed: Tensor) -> np.ndarray:
    images = np.frombuffer(zstandard.decompress(packed.numpy().tobytes()), np.uint8)
    return images.reshape(-1, IMAGE_SIZE, IMAGE_SIZE, 3)
