"""RND: a world model that predicts the output of a random network for each observation (Burda et al. 2018).

    loss = mean_d (f̂_d(s) − f_d(s))²,     reward = mean_d (f̂_d(s′) − f_d(s′))²,     f frozen

The target f sees pixels minus their running mean, divided by their running standard deviation, and clipped. The running
statistics cover all images so far. The first rollout initialises them, and its policy is still nearly uniform.

Departures from `openai/random-network-distillation`, each with its reason:

- The predictor is the policy's encoder (OPEn shares them) with a head of its own. It therefore sees the encoder's
  centred image and not the target's.
- It learns from s, not from s′, so that it can use the policy's pass through the encoder. All images of a segment but
  the last are the s of some step.
- The standard deviation of a pixel is at least one grey level, because most pixels of a table never change.
- Images are shifted in the update, alike for target and predictor. The mean image fills the uncovered edge.
- Intrinsic value is non-episodic and has no second head, because there is no extrinsic reward.
- The running standard deviation of the reward discounts with PPO's γ, .95, not .99: it scales the return that PPO
  estimates.
"""

import torch
from torch import Tensor, nn

from gym_open.agents.augment import no_shifts, shift_each
from gym_open.agents.config import RndConfig
from gym_open.agents.encoder import IMAGE_SHAPE, Encoder, convolutions, init_layer
from gym_open.agents.threads import through
from gym_open.agents.world_model import TransitionBatch, WorldModel


class Rnd(WorldModel):
    """A frozen random network, and a predictor of its output.

    Attributes:
        target: from normalised images (B, 3, 84, 84) to (B, outputs); it never learns.
        predictor: from the encoder's features to (B, outputs).
    """

    error_parts = ("error",)
    _watched: Tensor
    _sums: Tensor
    _squares: Tensor
    encoder: Encoder

    def __init__(self, encoder: Encoder, config: RndConfig, n_actions: int, generator: torch.Generator) -> None:
        super().__init__(encoder, config, n_actions)
        self.config = config
        self.target = convolutions(config.outputs, lambda: nn.LeakyReLU(0.2), generator)
        self.target.requires_grad_(requires_grad=False)
        self.predictor = nn.Sequential(
            nn.Linear(encoder.config.width, config.hidden), nn.ReLU(),
            nn.Linear(config.hidden, config.hidden), nn.ReLU(),
            nn.Linear(config.hidden, config.outputs),
        )  # fmt: skip
        for layer in self.predictor:
            if isinstance(layer, nn.Linear):
                init_layer(layer, generator)
        # Sums of integers are exact, so they do not depend on the order in which threads add.
        self.register_buffer("_watched", torch.zeros((), dtype=torch.int64))
        self.register_buffer("_sums", torch.zeros(IMAGE_SHAPE, dtype=torch.int64))
        self.register_buffer("_squares", torch.zeros(IMAGE_SHAPE, dtype=torch.int64))

    def watch(self, images: Tensor) -> None:
        """Add images (B, 84, 84, 3) uint8 to the mean and standard deviation of each pixel."""
        self._watched += len(images)
        for part in images.split(256):  # such sums are exact in fp32 (256 · 255² < 2²⁴), and much faster
            pixels = part.float()
            self._sums += pixels.sum(dim=0).long()
            self._squares += pixels.square_().sum(dim=0).long()

    def normalised(self, images: Tensor, shifts: Tensor) -> Tensor:
        """The input of the target: `clip((image − mean) / max(deviation, 1), ±clip)`, then shifted; the edge is 0.

        Args:
            images: (B, 84, 84, 3) uint8.
            shifts: (B, 2) int64.

        Returns:
            (B, 3, 84, 84) fp32 in channels-last memory order.
        """
        count = self._watched.clamp(min=1)
        mean = self._sums.double() / count
        deviation = (self._squares.double() / count - mean.square()).clamp(min=1).sqrt()
        weight, offset = (1 / deviation).float(), (-mean / deviation).float()
        return shift_each(images, shifts, weight, offset, torch.float32).clamp_(-self.config.clip, self.config.clip)

    def measure(
        self,
        transitions: TransitionBatch,
        shifts: Tensor,
        generator: torch.Generator,  # noqa: ARG002  (all shifts are given)
        features: Tensor | None = None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the prediction over B observations."""
        if features is None:
            features = self.features(transitions.obs, shifts)
        return self._error(transitions.obs, shifts, features).mean(), {}

    @torch.no_grad()
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """`error`: the mean square error for the observation that each step led to."""
        shifts = no_shifts(len(transitions.next_obs))
        return {"error": self._error(transitions.next_obs, shifts, self.features(transitions.next_obs, shifts))}

    @torch.no_grad()
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        """Output of the predictor for B images, (B, outputs)."""
        return self.predictor(self.unshifted(images) if features is None else features).float()

    def _error(self, images: Tensor, shifts: Tensor, features: Tensor) -> Tensor:
        """Mean square error over the outputs, (B,) fp32, given the encoder's features of the shifted images."""
        with torch.no_grad():
            target = through(self.target, self.normalised(images, shifts)).float()
        return (self.predictor(features).float() - target).square().mean(dim=1)
