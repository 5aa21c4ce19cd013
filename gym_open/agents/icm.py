"""ICM: a world model that predicts the effect of an action, in features that identify the action (Pathak et al. 2017).

    φ = LayerNorm(features), inverse model p(a | φ, φ′), forward model φ̂′(φ, a)
    loss = (1 − β)·CE(p, a) + β·½ mean_d (φ̂′_d − φ′_d)²,     reward = η·½ mean_d (φ̂′_d − φ′_d)²

Departures from `pathak22/noreward-rl`, each with its reason:

- φ is normalised (without parameters), and its square error is averaged over the features, not summed. φ then keeps one
  scale, so that a threshold on the loss means the same in every run and for every width.
- The forward error gives φ no gradient, as in Burda et al. 2018 ("Large-scale study"). The inverse model alone decides
  what φ holds, and features cannot become easy to predict by becoming empty.
- The loss has no further factor of 10. This factor made up for a learning rate of 1e-4, and OPEn's is 1e-3.
- The encoder is OPEn's three-layer one.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import IcmConfig
from gym_open.agents.encoder import Encoder, init_layer
from gym_open.agents.world_model import TransitionBatch, WorldModel


class Icm(WorldModel):
    """Inverse and forward model over the encoder's normalised features."""

    figures = ("forward", "inverse", "inverse_accuracy")
    encoder: Encoder

    def __init__(self, encoder: Encoder, config: IcmConfig, n_actions: int, generator: torch.Generator) -> None:
        super().__init__(encoder, config, n_actions)
        self.config = config
        self.error_parts = ("forward", "inverse") if config.eta_inverse else ("forward",)
        width = encoder.config.width
        self.inverse = _two_layers(2 * width, config.hidden, n_actions, generator)
        self.predictor = _two_layers(width + n_actions, config.hidden, width, generator)

    def measure(
        self,
        transitions: TransitionBatch,
        shifts: Tensor,
        generator: torch.Generator,  # noqa: ARG002  (all shifts are given)
        features: Tensor | None = None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """`(1 − β)·inverse + β·forward` over B transitions, s and s′ shifted alike; both errors and p's accuracy."""
        if features is None:
            features = self.features(transitions.obs, shifts)
        phi, next_phi = _normalised(features), _normalised(self.features(transitions.next_obs, shifts))
        forward, inverse, named = self._compare(phi, next_phi, transitions.actions)
        loss = ((1 - self.config.beta) * inverse + self.config.beta * forward).mean()
        means = (part.detach().mean() for part in (forward, inverse, named))
        return loss, dict(zip(self.figures, means, strict=True))

    def action_logits(self, phi: Tensor, next_phi: Tensor) -> Tensor:
        """Logits (B, n_actions) fp32 of the inverse model for the action between two latents (B, features)."""
        return self.inverse(torch.cat([phi, next_phi], dim=1)).float()

    @torch.no_grad()
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """`forward`, and `inverse` if its weight is not 0: each error times its weight, clipped at 1."""
        phi, next_phi = self.latent(transitions.obs), self.latent(transitions.next_obs)
        forward, inverse, _ = self._compare(phi, next_phi, transitions.actions)
        summands = {"forward": self.config.eta * forward, "inverse": self.config.eta_inverse * inverse}
        return {name: summands[name].clamp(max=1.0) for name in self.error_parts}

    @torch.no_grad()
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        """φ of B images, (B, features)."""
        return _normalised(self.unshifted(images) if features is None else features)

    def _compare(self, phi: Tensor, next_phi: Tensor, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Forward error ½ mean_d (φ̂′ − φ′)², inverse error −log p(a), and whether p is largest for a; (B,) fp32."""
        done = F.one_hot(actions, self.n_actions)
        predicted = self.predictor(torch.cat([phi.detach(), done], dim=1)).float()
        forward = 0.5 * (predicted - next_phi.detach()).square().mean(dim=1)
        logits = self.action_logits(phi, next_phi)
        named = (logits.argmax(dim=1) == actions).float()
        return forward, F.cross_entropy(logits, actions, reduction="none"), named


def _normalised(features: Tensor) -> Tensor:
    """Features (B, D) with mean 0 and standard deviation 1 over D, fp32."""
    return F.layer_norm(features.float(), features.shape[1:])


def _two_layers(inputs: int, hidden: int, outputs: int, generator: torch.Generator) -> nn.Sequential:
    first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
    init_layer(first, generator)
    init_layer(last, generator, std=1.0)
    return nn.Sequential(first, nn.ReLU(), last)
