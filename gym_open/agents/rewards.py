"""Rewards from within: what a world model makes of the steps that were taken."""

import math
from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor

from gym_open.agents.world_model import Transitions, WorldModel


class Reward(ABC):
    """Turns steps into a reward of named summands.

    Attributes:
        parts: names of the P summands.
    """

    parts: tuple[str, ...]

    @abstractmethod
    def __call__(self, images: Tensor, actions: Tensor) -> Tensor:
        """Summands (T, N, P) fp32 of the reward of T steps in N worlds.

        Args:
            images: observations around the steps, (T + 1, N, 84, 84, 3) uint8.
            actions: (T, N) int64.
        """


class OwnError(Reward):
    """The world model's own error (Pathak et al. 2017, Burda et al. 2018): go where it is wrong."""

    def __init__(self, model: WorldModel) -> None:
        self._model = model
        self.parts = model.error_parts

    def __call__(self, images: Tensor, actions: Tensor) -> Tensor:
        """The model's errors, summand by summand."""
        errors = self._model.errors(Transitions(images[:-1].flatten(0, 1), actions.flatten(), images[1:].flatten(0, 1)))
        return torch.stack([errors[name].view(actions.shape) for name in self.parts], dim=-1)


class Ride(Reward):
    """Impact (Raileanu & Rocktäschel 2020): how far an action moved the world in the model's latent space.

    Departures from the paper, each with its reason:

    - No episodic counts: OPEn's text names only the distance, and play in a sandbox has no episodes.
    - No clipping to ±1: a reward is divided by its running deviation, which bounds its scale without cutting off what
      is most surprising.
    - RIDE does not train its own forward and inverse model (10 · forward + 0.1 · inverse): the latent space is that of
      whichever world model it is given, which learns by its own loss. That is OPEn's combination of parts.
    """

    parts = ("impact",)

    def __init__(self, model: WorldModel) -> None:
        self._model = model

    def __call__(self, images: Tensor, actions: Tensor) -> Tensor:  # noqa: ARG002  (what it did shows)
        """`‖latent(s′) − latent(s)‖₂` of each step."""
        latent = self._model.latent(images.flatten(0, 1)).view(*images.shape[:2], -1)
        return (latent[1:] - latent[:-1]).norm(dim=-1)[..., None]


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
