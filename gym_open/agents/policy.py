"""Policy and value heads on one encoder."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.encoder import Encoder, init_layer


class ActorCritic(nn.Module):
    """An encoder with a linear policy head (gain 0.01) and a linear value head (gain 1), as in CleanRL's `Agent`."""

    def __init__(self, encoder: Encoder, n_actions: int, generator: torch.Generator) -> None:
        super().__init__()
        self.n_actions = n_actions
        self.encoder = encoder
        self.actor = nn.Linear(encoder.config.features, n_actions)
        self.critic = nn.Linear(encoder.config.features, 1)
        init_layer(self.actor, generator, std=0.01)
        init_layer(self.critic, generator, std=1.0)

    def forward(self, prepared: Tensor) -> tuple[Tensor, Tensor]:
        """Action logits (B, n_actions) and values (B,), fp32, of prepared pictures (B, 3, 84, 84)."""
        return self.heads(self.encoder(prepared))

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Action logits (B, n_actions) and values (B,), fp32, of the encoder's features (B, features)."""
        return self.actor(features).float(), self.critic(features).float().flatten()

    def get_value(self, prepared: Tensor) -> Tensor:
        """Values (B,) of prepared pictures (B, 3, 84, 84)."""
        return self.critic(self.encoder(prepared)).float().flatten()

    def get_action_and_value(
        self, prepared: Tensor, action: Tensor | None = None, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Sample actions, or look at given ones.

        Args:
            prepared: pictures, (B, 3, 84, 84).
            action: (B,) int64; sampled if None.
            generator: source of the samples; needed if `action` is None.

        Returns:
            Action, its log-probability, the policy's entropy in nats, and the value, each (B,).

        Raises:
            ValueError: if neither an action nor a generator is given.
        """
        logits, value = self(prepared)
        logprobs = F.log_softmax(logits, dim=1)
        probs = logprobs.exp()
        if action is None:
            if generator is None:
                raise ValueError("generator must be given to sample actions, got None")
            action = torch.multinomial(probs, 1, generator=generator).flatten()
        entropy = -(probs * logprobs).sum(dim=1)
        return action, logprobs.gather(1, action[:, None]).flatten(), entropy, value
