"""The pool: the distinct sandbox worlds to play in, each as it was left, with the last pictures seen of it."""

import math
from collections.abc import Iterable

import msgspec
import numpy as np
import torch
from torch import Tensor

from gym_open import seeding
from gym_open.agents.explorer import Explorer
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World
from gym_open.errors import GymOpenError


class Visits(msgspec.Struct):
    """How often a world was entered and how long it was played in, all streams together."""

    visits: int = 0
    steps: int = 0


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
        visits: one a world.
    """

    def __init__(self, puzzles: tuple[Puzzle, ...], probe: int, seed: int) -> None:
        self.puzzles = puzzles
        self.left: dict[int, np.ndarray] = {}
        self.visits = [Visits() for _ in puzzles]
        self._probe = probe
        self._seed = seed
        self._seen: list[dict[bytes, np.ndarray]] = [{} for _ in puzzles]

    def first_looks(self) -> np.ndarray:
        """Every world as its puzzle has it, (pool, 84, 84, 3) uint8; nothing moves and nothing is remembered."""
        world = World()
        looks: list[np.ndarray] = []
        for puzzle in self.puzzles:
            world.load(puzzle)
            looks.append(world.observe())
        return np.stack(looks)

    def see(self, world: int, images: Iterable[np.ndarray]) -> None:
        """Keep the latest distinct pictures of a world, (84, 84, 3) uint8 each.

        Distinct, because no world model can tell equal pictures apart: they would only put a floor under the loss.
        """
        seen = self._seen[world]
        for image in images:
            key = image.tobytes()
            seen.pop(key, None)
            seen[key] = image.copy()
        self._seen[world] = dict(list(seen.items())[-self._probe :])

    def loss(self, world: int, explorer: Explorer, rollout: int) -> float:
        """The world model's loss on what was last seen of a world; infinite if that is nothing.

        The random shifts depend on the seed, the world and the number of the rollout alone.
        """
        seen = self._seen[world]
        if not seen:
            return math.inf
        number = seeding.integer(self._seed, "collect", "probe", world, rollout)
        return explorer.world_loss(
            torch.from_numpy(np.stack(list(seen.values()))), torch.Generator().manual_seed(number)
        )

    def tensors(self) -> dict[str, Tensor]:
        """What was seen and how the worlds were left, by name."""
        seen = {f"seen/{i}": np.stack(list(one.values())) for i, one in enumerate(self._seen) if one}
        left = {f"left/{i}": state for i, state in self.left.items()}
        return {name: torch.from_numpy(value) for name, value in {**seen, **left}.items()}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore what `tensors` gave."""
        for name, tensor in tensors.items():
            what, index = name.split("/")
            if what == "left":
                self.left[int(index)] = tensor.numpy()
            else:
                self.see(int(index), tensor.numpy())
