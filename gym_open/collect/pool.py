"""The pool: the distinct sandbox worlds to play in, each as it was left, with the last transitions seen in it."""

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
    """Draw `size` sandbox worlds of different layout.

    Raises:
        GymOpenError: if the configuration leaves too few different ones.
    """
    rng = seeding.generator(seed, "collect", "pool")
    found: dict[str, Puzzle] = {}
    for _ in range(100 * size):
        puzzle = sample_puzzle("sandbox", rng, sandbox)
        found.setdefault(puzzle.digest, puzzle)
        if len(found) == size:
            return tuple(found.values())
    raise GymOpenError(f"`pool`: only {len(found)} different worlds of {sandbox}, {size} wanted; ask for fewer")


class Pool:
    """The worlds by index.

    Attributes:
        left: integration state of each world that was left, by index.
        tallies: one a world.
    """

    def __init__(self, puzzles: tuple[Puzzle, ...], probe: int, seed: int) -> None:
        self.puzzles = puzzles
        self.left: dict[int, np.ndarray] = {}
        self.tallies = [WorldCounts() for _ in puzzles]
        self._probe = probe
        self._seed = seed
        self._seen: list[dict[bytes, tuple[np.ndarray, int, np.ndarray]]] = [{} for _ in puzzles]

    def first_looks(self) -> np.ndarray:
        """Every world as its puzzle has it, (pool, 84, 84, 3) uint8; nothing moves and nothing is remembered."""
        world = World()
        looks: list[np.ndarray] = []
        for puzzle in self.puzzles:
            world.load(puzzle)
            looks.append(world.observe())
        return np.stack(looks)

    def see(self, world: int, obs: np.ndarray, actions: np.ndarray, next_obs: np.ndarray) -> None:
        """Keep the latest transitions of a world, one an observation.

        Of distinct observations, because no world model can tell equal pictures apart: they would only put a floor
        under the loss.

        Args:
            world: its index.
            obs: (T, 84, 84, 3) uint8.
            actions: (T,) int64, taken at `obs`.
            next_obs: what each led to, like `obs`.
        """
        seen = self._seen[world]
        for image, action, after in zip(obs, actions.tolist(), next_obs, strict=True):
            key = image.tobytes()
            seen.pop(key, None)
            seen[key] = image.copy(), action, after.copy()
        self._seen[world] = dict(list(seen.items())[-self._probe :])

    def transitions(self, world: int) -> TransitionBatch | None:
        """What is kept of a world, oldest first; None if nothing is."""
        seen = self._seen[world]
        if not seen:
            return None
        obs, actions, after = zip(*seen.values(), strict=True)
        return TransitionBatch(
            torch.from_numpy(np.stack(obs)), torch.tensor(actions, dtype=torch.int64), torch.from_numpy(np.stack(after))
        )

    def loss(self, world: int, explorer: Explorer, rollout: int) -> float:
        """The scaled loss of the explorer's world model on what was last seen of a world; infinite if that is nothing.

        Its randomness depends on the seed, the world and the number of the rollout alone.
        """
        transitions = self.transitions(world)
        if transitions is None:
            return math.inf
        number = seeding.integer(self._seed, "collect", "probe", world, rollout)
        return explorer.world_loss(transitions, torch.Generator().manual_seed(number))

    def tensors(self) -> dict[str, Tensor]:
        """What was seen and how the worlds were left, by name; pictures are packed, to a three-hundredth or so."""
        found = {f"left/{index}": torch.from_numpy(state) for index, state in self.left.items()}
        for index in range(len(self.puzzles)):
            transitions = self.transitions(index)
            if transitions is not None:
                found[f"obs/{index}"] = _packed(transitions.obs)
                found[f"actions/{index}"] = transitions.actions
                found[f"next_obs/{index}"] = _packed(transitions.next_obs)
        return found

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore what `tensors` gave."""
        for index in range(len(self.puzzles)):
            if f"left/{index}" in tensors:
                self.left[index] = tensors[f"left/{index}"].numpy()
            if f"obs/{index}" in tensors:
                obs, after = (_unpacked(tensors[f"{name}/{index}"]) for name in ("obs", "next_obs"))
                self.see(index, obs, tensors[f"actions/{index}"].numpy(), after)


def _packed(images: Tensor) -> Tensor:
    """Zstandard's bytes of pictures (B, 84, 84, 3) uint8, as a tensor."""
    return torch.frombuffer(bytearray(zstandard.compress(images.numpy().tobytes(), 1)), dtype=torch.uint8)


def _unpacked(packed: Tensor) -> np.ndarray:
    pictures = np.frombuffer(zstandard.decompress(packed.numpy().tobytes()), np.uint8)
    return pictures.reshape(-1, IMAGE_SIZE, IMAGE_SIZE, 3)
