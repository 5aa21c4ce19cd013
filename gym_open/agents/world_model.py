"""The base class of all world models, which learn from transitions and measure how surprising each one is."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import WorldModelConfig
from gym_open.agents.encoder import ImageEncoder


class TransitionBatch(NamedTuple):
    """B transitions (o_t, a_t, o_t+1)."""

    obs: Tensor
    """(B, 84, 84, 3) uint8."""
    actions: Tensor
    """(B,) int64."""
    next_obs: Tensor
    """(B, 84, 84, 3) uint8."""


class WorldModel(nn.Module, ABC):
    """A loss for learning, an error that can be a reward, and a latent space in which impact is measured.

    Methods compute in the precision of the caller's autocast; losses and errors are fp32.

    Attributes:
        encoder: from prepared images to features. The policy may share it.
        loss_scale: the curriculum multiplies the loss of a world by it, so that one threshold serves all models.
        error_parts: names of the summands that `errors` returns.
        figures: names of the numbers that `measure` returns in addition to the loss.
    """

    error_parts: tuple[str, ...]
    figures: tuple[str, ...] = ()

    def __init__(self, encoder: ImageEncoder, config: WorldModelConfig, n_actions: int) -> None:
        super().__init__()
        self.encoder = encoder
        self.loss_scale = config.loss_scale
        self.n_actions = n_actions

    @abstractmethod
    def measure(
        self, transitions: TransitionBatch, shifts: Tensor, generator: torch.Generator, features: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss to minimise, a scalar, and diagnostic scalars without gradient, by the names in `figures`.

        Args:
            transitions: B transitions.
            shifts: shift of each observation, (B, 2) int64, from `augment.draw_shifts`.
            generator: source of further shifts.
            features: the encoder's features of the shifted `transitions.obs`, (B, features), if known.
        """

    def loss(
        self, transitions: TransitionBatch, shifts: Tensor, generator: torch.Generator, features: Tensor | None = None
    ) -> Tensor:
        """The loss of `measure` alone."""
        return self.measure(transitions, shifts, generator, features)[0]

    @abstractmethod
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """The model's own error in B transitions, as intrinsic reward: summands by name, (B,) each, no gradient."""

    @abstractmethod
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        """Positions of images (B, 84, 84, 3) uint8 in the model's latent space: (B, D) fp32, without gradient.

        Args:
            images: the images, unshifted.
            features: the encoder's features of them, (B, features), if they are known already.
        """

    @torch.no_grad()
    def world_loss(self, transitions: TransitionBatch, generator: torch.Generator) -> float:
        """`loss` of B transitions of one world. Images are not shifted, unless the loss itself needs shifts."""
        return float(self.loss(transitions, no_shifts(len(transitions.obs)), generator))

    def watch(self, images: Tensor) -> None:
        """Add new images (B, 84, 84, 3) uint8 to running statistics, before their rewards are computed."""

    def stepped(self) -> None:
        """Update slow copies of networks. The learner calls this after each gradient step."""

    def finish(self, transitions: TransitionBatch) -> dict[str, float]:  # noqa: ARG002
        """Learn from `transitions`, on the CPU, what needs the finished model; return facts about it, by name."""
        return {}

    def unshifted(self, images: Tensor) -> Tensor:
        """The encoder's features (B, features) of unshifted images (B, 84, 84, 3) uint8."""
        return self.features(images, no_shifts(len(images)))

    def features(self, images: Tensor, shifts: Tensor) -> Tensor:
        """The encoder's features (B, features) of images (B, 84, 84, 3) uint8, moved by `shifts`, (B, 2) int64."""
        return self.encoder(self.encoder.prepare_shifted(images, shifts))
