"""Rewards from within: what a world model makes of the steps that were taken."""

import hashlib
import math
from abc import ABC, abstractmethod
from collections import Counter
from importlib import import_module

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gym_open.agents.config import INTRINSIC_REWARDS, RewardName
from gym_open.agents.world_model import TransitionBatch, WorldModel


class Reward(ABC):
    """Turns steps into a reward of named summands.

    Attributes:
        parts: names of the P summands.
    """

    parts: tuple[str, ...]

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        self.model, self.n_streams = model, n_streams

    @abstractmethod
    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:
        """Summands (T, N, P) fp32 of the reward of T steps in N worlds.

        Args:
            images: observations around the steps, (T + 1, N, 84, 84, 3) uint8.
            actions: (T, N) int64.
            features: what the world model's encoder makes of the images, (T + 1, N, features), if that is known.
        """

    def entered(self, stream: int) -> None:  # noqa: B027  (most rewards do not mind)
        """Called when a stream enters another world."""

    def tensors(self) -> dict[str, Tensor]:
        """What a checkpoint must keep, by name."""
        return {}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:  # noqa: B027  (most have nothing to keep)
        """Restore what `tensors` gave."""


def make_reward(name: RewardName, model: WorldModel, n_streams: int) -> Reward:
    """The reward `name` of `config.INTRINSIC_REWARDS`, computed from `model` for `n_streams` streams."""
    module, kind = INTRINSIC_REWARDS[name].split(".")
    return getattr(import_module(f"gym_open.agents.{module}"), kind)(model, n_streams)


class OwnError(Reward):
    """The world model's own error (Pathak et al. 2017, Burda et al. 2018): go where it is wrong."""

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        super().__init__(model, n_streams)
        self.parts = model.error_parts

    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:  # noqa: ARG002
        """The model's errors, summand by summand."""
        errors = self.model.errors(
            TransitionBatch(images[:-1].flatten(0, 1), actions.flatten(), images[1:].flatten(0, 1))
        )
        return torch.stack([errors[name].view(actions.shape) for name in self.parts], dim=-1)


class Ride(Reward):
    """Impact (Raileanu & Rocktäschel 2020): how far an action moved the world in the model's latent space.

    Departures from the paper, each with its reason:

    - No episodic counts: OPEn's text names only the distance, and play in a sandbox has no episodes. `CountedRide` has
      them.
    - No clipping to ±1: a reward is divided by its running deviation, which bounds its scale without cutting off what
      is most surprising.
    - RIDE does not train its own forward and inverse model (10 · forward + 0.1 · inverse): the latent space is that of
      whichever world model it is given, which learns by its own loss. That is OPEn's combination of parts.
    """

    parts = ("impact",)

    def __call__(
        self,
        images: Tensor,
        actions: Tensor,  # noqa: ARG002  (what it did shows)
        features: Tensor | None = None,
    ) -> Tensor:
        """`‖latent(s′) − latent(s)‖₂` of each step."""
        known = None if features is None else features.flatten(0, 1)
        latent = self.model.latent(images.flatten(0, 1), known).view(*images.shape[:2], -1)
        return (latent[1:] - latent[:-1]).norm(dim=-1)[..., None]


class CountedRide(Ride):
    """Impact over √N, N being how often what a step led to was seen since its stream entered the world.

    That is RIDE's own reward with "episode" read as "stay in a world". Without it, the largest impact can be had for
    ever between the same two places. RIDE counts observations, which repeat in a grid world; here they hardly do, so
    what is counted is a picture's cell (`cells`).
    """

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        super().__init__(model, n_streams)
        self._seen: list[Counter[int]] = [Counter() for _ in range(n_streams)]

    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:
        """`‖latent(s′) − latent(s)‖₂ / √N(s′)` of each step, s′ itself counted."""
        found = np.array(cells(images[1:].flatten(0, 1))).reshape(actions.shape)
        counts = torch.ones(actions.shape)
        for t, row in enumerate(found.tolist()):
            for stream, (seen, here) in enumerate(zip(self._seen, row, strict=True)):
                seen[here] += 1
                counts[t, stream] = seen[here]
        return super().__call__(images, actions, features) / counts.sqrt()[..., None]

    def entered(self, stream: int) -> None:
        """Forget what the stream has seen."""
        self._seen[stream].clear()

    def tensors(self) -> dict[str, Tensor]:
        """The counts of each stream, (cells seen, 2) int64: the cell, and how often."""
        pairs = [torch.tensor(list(seen.items()), dtype=torch.int64).view(-1, 2) for seen in self._seen]
        return {f"seen/{stream}": pair for stream, pair in enumerate(pairs)}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore the counts."""
        self._seen = [Counter(dict(tensors[f"seen/{stream}"].tolist())) for stream in range(len(self._seen))]


_BLOCK = 7
"""Edge in pixels: an object is two thirds of that wide, and a move takes it about one block on."""
_LEVELS = 16
"""Grey levels to one: an object's arrival changes a block's mean by more."""


def cells(images: Tensor) -> list[int]:
    """What each of B pictures (B, 84, 84, 3) uint8 shows, coarsely: 64 bits, the same for pictures that look alike.

    As in Go-Explore (Ecoffet et al. 2021), a picture is made small and its levels few: here 12×12, each number the mean
    of 7×7 pixels of a colour, 16 levels to one.
    """
    sums = F.avg_pool2d(images.permute(0, 3, 1, 2).float(), _BLOCK, divisor_override=1)  # of integers: exact
    coarse = (sums.long() // (_BLOCK * _BLOCK * _LEVELS)).to(torch.uint8).numpy()
    digests = (hashlib.blake2b(one.tobytes(), digest_size=8).digest() for one in coarse)
    return [int.from_bytes(digest, "little", signed=True) for digest in digests]


class RewardScale:
    """Divides rewards by the running deviation of their discounted sum (Burda et al. 2018, RND).

    The sum runs on through switches of world: play is not episodic. The mean is not subtracted. Its discount is PPO's
    γ (.95) in place of RND's .99: what is scaled then is the return that PPO estimates.
    """

    def __init__(self, n_streams: int, gamma: float) -> None:
        self._gamma = gamma
        self.state = np.zeros(n_streams + 3)
        """Discounted sum of each stream, then count, mean and sum of squared differences of all sums so far."""

    def normalise(self, rewards: np.ndarray) -> np.ndarray:
        """Take T steps of N streams into account, (T, N), and return them scaled."""
        sums, (count, mean, squares) = self.state[:-3], self.state[-3:]
        for now in rewards:
            sums = self._gamma * sums + now
            for value in sums:  # Welford's update, one value at a time
                count += 1
                step = value - mean
                mean += step / count
                squares += step * (value - mean)
        self.state = np.array([*sums, count, mean, squares])
        return rewards / (math.sqrt(squares / count) + 1e-8)
