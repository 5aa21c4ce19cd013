"""CURL: a contrastive world model, which learns to tell images apart (Srinivas et al. 2020).

    loss = −log softmax_k(q_iᵀ W k_k)[i],     q and k: projections of two random shifts of one image

Departures from `MishaLaskin/curl`, each with its reason:

- Random shift in place of random crop: the image is 84×84 already, and the policy sees all of it.
- The encoder is OPEn's three-layer one, and the query has the same shift as the policy: one pass serves both.
- Own error as a reward, which CURL does not define: InfoNCE of the image that a step led to, among its rollout's.
"""

import copy

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.augment import draw_shifts, no_shifts
from gym_open.agents.config import CurlConfig
from gym_open.agents.encoder import Encoder, autocast, init_layer
from gym_open.agents.threads import through
from gym_open.agents.world_model import TransitionBatch, WorldModel


class Curl(WorldModel):
    """An encoder, a projection of its features, a bilinear similarity, and slow copies of both networks for the keys.

    The policy may share the encoder. The key network changes only in `stepped`.
    """

    error_parts = ("error",)
    figures = ("accuracy",)
    _steps: Tensor
    encoder: Encoder

    def __init__(self, encoder: Encoder, config: CurlConfig, n_actions: int, generator: torch.Generator) -> None:
        super().__init__(encoder, config, n_actions)
        self.config = config
        linear = nn.Linear(encoder.config.width, config.latent)
        init_layer(linear, generator)
        self.projection = nn.Sequential(linear, nn.LayerNorm(config.latent))
        self.W = nn.Parameter(torch.rand(config.latent, config.latent, generator=generator))
        self.key = copy.deepcopy(nn.Sequential(encoder.layers, self.projection)).requires_grad_(requires_grad=False)
        self.register_buffer("_steps", torch.zeros((), dtype=torch.int64))

    def measure(
        self, transitions: TransitionBatch, shifts: Tensor, generator: torch.Generator, features: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """InfoNCE of B observations, between the given shifts and other random shifts.

        `accuracy` is how often the most similar key of a query is its own. Chance is 1 in B.
        """
        images = transitions.obs
        if features is None:
            features = self.features(images, shifts)
        logits = self._logits(self.projection(features), self._keys(images, self._draw(images, generator)))
        own = torch.arange(len(logits), device=logits.device)
        return F.cross_entropy(logits, own), {"accuracy": (logits.argmax(dim=1) == own).float().mean()}

    @torch.no_grad()
    def world_loss(self, transitions: TransitionBatch, generator: torch.Generator) -> float:
        """`loss` of B transitions of one world, between two random shifts of each image."""
        return float(self.loss(transitions, self._draw(transitions.obs, generator), generator))

    @torch.no_grad()
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """`error`: InfoNCE of the image that each step led to, among those of all B steps, unshifted."""
        images = transitions.next_obs
        logits = self._logits(self.latent(images), self._keys(images, no_shifts(len(images))))
        own = torch.arange(len(logits), device=logits.device)
        return {"error": F.cross_entropy(logits, own, reduction="none")}

    @torch.no_grad()
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        """Projected features (B, latent) of unshifted images (B, 84, 84, 3) uint8, without gradient."""
        return self.projection(self.unshifted(images) if features is None else features).float()

    @torch.no_grad()
    def stepped(self) -> None:
        """Every `update_every` steps, move the key network towards the query: `key ← key + tau · (query − key)`."""
        self._steps += 1
        if self._steps % self.config.update_every:
            return
        query = [*self.encoder.layers.parameters(), *self.projection.parameters()]
        for slow, fast in zip(self.key.parameters(), query, strict=True):
            slow.lerp_(fast, self.config.tau)

    def _draw(self, images: Tensor, generator: torch.Generator) -> Tensor:
        return draw_shifts(len(images), self.config.pad, generator)

    @torch.no_grad()
    def _keys(self, images: Tensor, shifts: Tensor) -> Tensor:
        """Output of the key network for images, (B, latent) fp32."""
        return through(self.key, self.encoder.prepare_shifted(images, shifts)).float()

    def _logits(self, query: Tensor, keys: Tensor) -> Tensor:
        """Similarity `qᵀ W k` of each query and each key, (B, B) fp32. bf16 would limit how low the loss can fall."""
        with autocast("fp32", query.device.type):
            return query.float() @ self.W @ keys.T
