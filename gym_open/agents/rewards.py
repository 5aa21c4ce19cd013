"""Intrinsic rewards, which are computed from a world model and the steps that were taken."""

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
    """Computes rewards of steps, as named summands.

    Attributes:
        parts: names of the P summands.
    """

    parts: tuple[str, ...]

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        self.model, self.n_streams = model, n_streams

    @abstractmethod
    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:
        """Summands (T, N, P) fp32 of the rewards of T steps in N worlds.

        Args:
            images: observations around the steps, (T + 1, N, 84, 84, 3) uint8.
            actions: (T, N) int64.
            features: features of the images from the world model's encoder, (T + 1, N, features), if they are known.
        """

    def entered(self, stream: int) -> None:  # noqa: B027  (most rewards need not know)
        """Called when a stream enters another world."""

    def tensors(self) -> dict[str, Tensor]:
        """State that a checkpoint must keep, by name."""
        return {}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:  # noqa: B027  (most have no state)
        """Restore the state from the result of `tensors`."""


def make_reward(name: RewardName, model: WorldModel, n_streams: int) -> Reward:
    """The reward `name` of `config.INTRINSIC_REWARDS`, computed from `model` for `n_streams` streams."""
    module, kind = INTRINSIC_REWARDS[name].split(".")
    return getattr(import_module(f"gym_open.agents.{module}"), kind)(model, n_streams)


class OwnError(Reward):
    """The world model's own error (Pathak et al. 2017, Burda et al. 2018): it leads to where the model is wrong."""

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        super().__init__(model, n_streams)
        self.parts = model.error_parts

    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:  # noqa: ARG002
        """The summands of the model's error."""
        errors = self.model.errors(
            TransitionBatch(images[:-1].flatten(0, 1), actions.flatten(), images[1:].flatten(0, 1))
        )
        return torch.stack([errors[name].view(actions.shape) for name in self.parts], dim=-1)


class Ride(Reward):
    """Impact (Raileanu & Rocktäschel 2020): how far an action moved the world in the model's latent space.

    Departures from the paper, each with its reason:

    - No episodic counts: OPEn's text names only the distance, and exploration of a sandbox has no episodes.
      `CountedRide` has counts.
    - No clipping to ±1: a reward is divided by its running standard deviation. This bounds its scale and keeps the
      largest surprises.
    - RIDE does not train its own forward and inverse model (10 · forward + 0.1 · inverse). Its latent space is that of
      any world model, which learns by its own loss. That is OPEn's combination of parts.
    """

    parts = ("impact",)

    def __call__(
        self,
        images: Tensor,
        actions: Tensor,  # noqa: ARG002  (only their effect counts)
        features: Tensor | None = None,
    ) -> Tensor:
        """`‖latent(s′) − latent(s)‖₂` of each step."""
        known = None if features is None else features.flatten(0, 1)
        latent = self.model.latent(images.flatten(0, 1), known).view(*images.shape[:2], -1)
        return (latent[1:] - latent[:-1]).norm(dim=-1)[..., None]


class CountedRide(Ride):
    """Impact over √N. N counts how often the stream has seen the result of the step since it entered the world.

    This is RIDE's own reward, with segments in place of episodes. Without the counts, moving to and fro between two
    places can have the largest impact for ever. RIDE counts observations, which repeat in a grid world. Here they
    hardly repeat, so this class counts cells of images (`cells`).
    """

    def __init__(self, model: WorldModel, n_streams: int = 1) -> None:
        super().__init__(model, n_streams)
        self._seen: list[Counter[int]] = [Counter() for _ in range(n_streams)]

    def __call__(self, images: Tensor, actions: Tensor, features: Tensor | None = None) -> Tensor:
        """`‖latent(s′) − latent(s)‖₂ / √N(s′)` of each step. N includes this occurrence of s′."""
        found = np.array(cells(images[1:].flatten(0, 1))).reshape(actions.shape)
        counts = torch.ones(actions.shape)
        for t, row in enumerate(found.tolist()):
            for stream, (seen, here) in enumerate(zip(self._seen, row, strict=True)):
                seen[here] += 1
                counts[t, stream] = seen[here]
        return super().__call__(images, actions, features) / counts.sqrt()[..., None]

    def entered(self, stream: int) -> None:
        """Reset the counts of the stream."""
        self._seen[stream].clear()

    def tensors(self) -> dict[str, Tensor]:
        """The counts of each stream, (cells seen, 2) int64: the cell and its count."""
        pairs = [torch.tensor(list(seen.items()), dtype=torch.int64).view(-1, 2) for seen in self._seen]
        return {f"seen/{stream}": pair for stream, pair in enumerate(pairs)}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore the counts."""
        self._seen = [Counter(dict(tensors[f"seen/{stream}"].tolist())) for stream in range(len(self._seen))]


_BLOCK = 7
"""Edge of a block in pixels. An object is two thirds as wide, and a move takes it about one block further."""
_LEVELS = 16
"""Grey levels that count as one level. An object that arrives changes the mean of a block by more."""


def cells(images: Tensor) -> list[int]:
    """The cell of each of B images (B, 84, 84, 3) uint8: 64 bits, which are the same for images that look alike.

    As in Go-Explore (Ecoffet et al. 2021), an image is reduced to few pixels and few levels: here to 12×12 pixels, each
    the mean of 7×7 pixels of a colour, with 16 grey levels per level.
    """
    sums = F.avg_pool2d(images.permute(0, 3, 1, 2).float(), _BLOCK, divisor_override=1)  # of integers: exact
    coarse = (sums.long() // (_BLOCK * _BLOCK * _LEVELS)).to(torch.uint8).numpy()
    digests = (hashlib.blake2b(one.tobytes(), digest_size=8).digest() for one in coarse)
    return [int.from_bytes(digest, "little", signed=True) for digest in digests]


class RewardScale:
    """Divides rewards by the running standard deviation of their discounted sum (Burda et al. 2018, RND).

    The sum continues when a stream switches to another world, because exploration is not episodic. The mean is not
    subtracted. The discount is PPO's γ (.95) in place of RND's .99, because PPO estimates this return.
    """

    def __init__(self, n_streams: int, gamma: float) -> None:
        self._gamma = gamma
        self.state = np.zeros(n_streams + 3)
        """Discounted sum of each stream; then count, mean and sum of squared differences of all sums so far."""

    def normalise(self, rewards: np.ndarray) -> np.ndarray:
        """Update the statistics with the rewards of T steps of N streams, (T, N), and return the scaled rewards."""
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
