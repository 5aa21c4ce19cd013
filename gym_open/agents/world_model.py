"""What every world model is: something that learns from transitions, and says how surprising they were."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import WorldModelConfig
from gym_open.agents.encoder import Encoder


class TransitionBatch(NamedTuple):
    """B steps: what was seen, what was done, what was seen then."""

    obs: Tensor
    """(B, 84, 84, 3) uint8."""
    actions: Tensor
    """(B,) int64."""
    next_obs: Tensor
    """(B, 84, 84, 3) uint8."""


class WorldModel(nn.Module, ABC):
    """A loss to learn by, an error to be rewarded by, and a latent space to measure impact in.

    Methods compute in the precision of the caller's autocast; losses and errors are fp32.

    Attributes:
        encoder: from prepared pictures to features; the policy may hold the same one.
        loss_scale: what the curriculum multiplies the loss of a world by, so that one threshold serves all models.
        error_parts: names of what `errors` gives.
        figures: names of what `measure` gives beside the loss.
    """

    error_parts: tuple[str, ...]
    figures: tuple[str, ...] = ()

    def __init__(self, encoder: Encoder, config: WorldModelConfig, n_actions: int) -> None:
        super().__init__()
        self.encoder = encoder
        self.loss_scale = config.loss_scale
        self.n_actions = n_actions

    @abstractmethod
    def measure(
        self, transitions: TransitionBatch, shifts: Tensor, generator: torch.Generator, features: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """What is minimised, a scalar, and scalars without gradient that tell how well it goes, named as in `figures`.

        Args:
            transitions: B steps.
            shifts: shift of each observation, (B, 2) int64, as `augment.draw_shifts` gives them.
            generator: source of further shifts.
            features: what the encoder makes of the shifted `transitions.obs`, (B, features), if that is known already.
        """

    def loss(
        self, transitions: TransitionBatch, shifts: Tensor, generator: torch.Generator, features: Tensor | None = None
    ) -> Tensor:
        """What is minimised, of `measure`."""
        return self.measure(transitions, shifts, generator, features)[0]

    @abstractmethod
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """The model's own error in B steps as intrinsic reward: its summands by name, (B,) each, without gradient."""

    @abstractmethod
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        """Where pictures (B, 84, 84, 3) uint8 are in the model's latent space: (B, D) fp32, without gradient.

        Args:
            images: the pictures, unshifted.
            features: what the encoder makes of them, (B, features), if that is known already.
        """

    @torch.no_grad()
    def world_loss(self, transitions: TransitionBatch, generator: torch.Generator) -> float:
        """`loss` of B steps of one world, unshifted unless the loss itself is about shifts."""
        return float(self.loss(transitions, no_shifts(len(transitions.obs)), generator))

    def watch(self, images: Tensor) -> None:
        """Take (B, 84, 84, 3) uint8 newly seen pictures into running statistics, before they are rewarded."""

    def stepped(self) -> None:
        """Called after each gradient step."""

    def unshifted(self, images: Tensor) -> Tensor:
        """The encoder's features (B, features) of pictures (B, 84, 84, 3) uint8 as they are."""
        return self.features(images, no_shifts(len(images)))

    def features(self, images: Tensor, shifts: Tensor) -> Tensor:
        """The encoder's features (B, features) of pictures (B, 84, 84, 3) uint8 moved by `shifts`, (B, 2) int64."""
        return self.encoder(self.encoder.prepare_shifted(images, shifts))
