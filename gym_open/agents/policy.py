"""Policy and value heads on one encoder."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import SYMMETRIES
from gym_open.agents.encoder import ImageEncoder, StateEncoder, init_layer
from gym_open.agents.symmetry import GroupActor, GroupCritic, GroupLayer, Lift
from gym_open.errors import DivergedError


class ActorCritic(nn.Module):
    """An encoder, a trunk, a linear policy head (gain 0.01), a linear value head (gain 1), as in CleanRL's `Agent`.

    With `symmetric`, trunk and heads have the symmetries of the table (`symmetry`).

    A frozen encoder does not learn, so its features of an image never change. In this case, `observe` returns features,
    which are computed once, in place of images.

    Args:
        encoder: of images, or of simulator states.
        n_actions: width of the policy head.
        generator: source of the heads' weights.
        trunk: widths of hidden layers with tanh between the encoder and the heads; none by default.
        symmetric: whether trunk and heads have the table's symmetries. The trunk then has one layer or more, each of
            a multiple of 8 units, and the encoder has `turns`.
        frozen: whether the encoder does not learn.
    """

    def __init__(
        self,
        encoder: ImageEncoder | StateEncoder,
        n_actions: int,
        generator: torch.Generator,
        *,
        trunk: Sequence[int] = (),
        symmetric: bool = False,
        frozen: bool = False,
    ) -> None:
        super().__init__()
        self.n_actions = n_actions
        self.frozen = frozen
        self.encoder = encoder.requires_grad_(not frozen)
        self.widths, self.symmetric = tuple(trunk), symmetric
        self.actor: nn.Linear | GroupActor
        self.critic: nn.Linear | GroupCritic
        if symmetric:
            self.trunk, self.actor, self.critic = _symmetric_layers(encoder, trunk, generator)
        else:
            self.trunk, self.actor, self.critic = _plain_layers(encoder.config.width, trunk, n_actions, generator)

    @property
    def obs_shape(self) -> tuple[int, ...]:
        """Shape of one observation that `observe` returns."""
        return (self.encoder.config.width,) if self.frozen else self.encoder.shape

    @property
    def obs_dtype(self) -> torch.dtype:
        """Type of the observations that `observe` returns."""
        return torch.float32 if self.frozen else self.encoder.dtype

    def observe(self, seen: Tensor) -> Tensor:
        """What a rollout stores of B images or states: the input itself, or the features of a frozen encoder."""
        return self.encoder(self.encoder.prepare(seen)).float() if self.frozen else seen

    def prepare(self, obs: Tensor) -> Tensor:
        """Turn results of `observe` into the input of `forward`."""
        return obs if self.frozen else self.encoder.prepare(obs)

    def prepare_shifted(self, obs: Tensor, shifts: Tensor) -> Tensor:
        """`prepare`, and move each image by its shift, (B, 2) int64. Features and states are not shifted."""
        return obs if self.frozen else self.encoder.prepare_shifted(obs, shifts)

    def forward(self, prepared: Tensor) -> tuple[Tensor, Tensor]:
        """Action logits (B, n_actions) and values (B,), fp32, of B prepared observations."""
        return self.heads(prepared if self.frozen else self.encoder(prepared))

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Action logits (B, n_actions) and values (B,), fp32, of the encoder's features (B, features)."""
        hidden = self.trunk(features)
        return self.actor(hidden).float(), self.critic(hidden).float().flatten()

    def get_value(self, prepared: Tensor) -> Tensor:
        """Values (B,) of B prepared observations."""
        return self(prepared)[1]

    def get_action_and_value(
        self, prepared: Tensor, action: Tensor | None = None, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Sample actions, or evaluate given ones.

        Args:
            prepared: result of `prepare` for B observations.
            action: (B,) int64; sampled if None.
            generator: source of the samples, on the CPU; required if `action` is None.

        Returns:
            Action, its log-probability, the policy's entropy in nats, and the value, each (B,).

        Raises:
            ValueError: if neither an action nor a generator is given.
            DivergedError: if actions are to be sampled and their probabilities are not finite.
        """
        logits, value = self(prepared)
        logprobs = F.log_softmax(logits, dim=1)
        probs = logprobs.exp()
        if action is None:
            if generator is None:
                raise ValueError("generator must be given to sample actions, got None")
            if not probs.isfinite().all():
                raise DivergedError("the policy's probabilities are not finite")
            action = torch.multinomial(probs.cpu(), 1, generator=generator).flatten().to(logits.device)
        entropy = -(probs * logprobs).sum(dim=1)
        return action, logprobs.gather(1, action[:, None]).flatten(), entropy, value


def _plain_layers(
    features: int, trunk: Sequence[int], n_actions: int, generator: torch.Generator
) -> tuple[nn.Sequential, nn.Linear, nn.Linear]:
    """Trunk, policy head and value head of linear layers."""
    layers, widths = nn.Sequential(), [features, *trunk]
    for inputs, outputs in pairwise(widths):
        layer = nn.Linear(inputs, outputs)
        init_layer(layer, generator)
        layers.extend([layer, nn.Tanh()])
    actor, critic = nn.Linear(widths[-1], n_actions), nn.Linear(widths[-1], 1)
    init_layer(actor, generator, std=0.01)
    init_layer(critic, generator, std=1.0)
    return layers, actor, critic


def _symmetric_layers(
    encoder: ImageEncoder | StateEncoder, trunk: Sequence[int], generator: torch.Generator
) -> tuple[nn.Sequential, GroupActor, GroupCritic]:
    """The same with the symmetries of the table."""
    if encoder.turns is None:
        raise ValueError(f"features of architecture {encoder.config.architecture!r} have no symmetries")
    filters = [width // SYMMETRIES for width in trunk]
    layers = nn.Sequential(Lift(encoder.turns, filters[0], generator), nn.Tanh())
    for inputs, outputs in pairwise(filters):
        layers.extend([GroupLayer(inputs, outputs, generator), nn.Tanh()])
    return layers, GroupActor(filters[-1], generator, std=0.01), GroupCritic(filters[-1], generator, std=1.0)
