"""CURL: a world model that tells pictures apart (Srinivas et al. 2020; `MishaLaskin/curl`)."""

import copy

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import CurlConfig
from gym_open.agents.encoder import Encoder, init_layer


def info_nce(logits: Tensor) -> Tensor:
    """Contrastive loss `−mean_i log softmax(logits[i])[i]` of (B, B) logits: the partner of query i is key i."""
    return F.cross_entropy(logits.float(), torch.arange(len(logits)))


def contrastive_accuracy(logits: Tensor) -> Tensor:
    """Share of queries whose own key has the highest of (B, B) logits; chance is 1/B."""
    return (logits.argmax(dim=1) == torch.arange(len(logits))).float().mean()


class Curl(nn.Module):
    """An encoder, a projection of its features, a bilinear similarity, and a slow copy of both that makes the keys.

    The encoder is shared with whoever else holds it. The key network learns only by `update_key`.
    """

    def __init__(self, encoder: Encoder, config: CurlConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.config = config
        self.encoder = encoder
        linear = nn.Linear(encoder.config.features, config.latent)
        init_layer(linear, generator)
        self.projection = nn.Sequential(linear, nn.LayerNorm(config.latent))
        self.W = nn.Parameter(torch.rand(config.latent, config.latent, generator=generator))
        self.key = copy.deepcopy(nn.Sequential(encoder.layers, self.projection)).requires_grad_(requires_grad=False)

    def logits(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Similarity `qᵀ W k` of two random shifts of every picture, less its row's maximum.

        Args:
            images: (B, 84, 84, 3) uint8.
            generator: source of the shifts.

        Returns:
            (B, B): row i compares query i with every key.
        """
        query = self.projection(self.encoder(self.encoder.prepare_shifted(images, self.config.pad, generator)))
        with torch.no_grad():
            key = self.key(self.encoder.prepare_shifted(images, self.config.pad, generator))
        logits = query.float() @ self.W @ key.float().T
        return logits - logits.max(dim=1, keepdim=True).values.detach()

    def loss(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """InfoNCE between two random shifts of `images`, (B, 84, 84, 3) uint8; a scalar."""
        return info_nce(self.logits(images, generator))

    @torch.no_grad()
    def latent(self, images: Tensor) -> Tensor:
        """Projected features (B, latent) of unshifted pictures (B, 84, 84, 3) uint8, without gradient."""
        return self.projection(self.encoder(self.encoder.prepare(images)))

    @torch.no_grad()
    def update_key(self) -> None:
        """Move the key network towards the query's: `key ← key + tau · (query − key)`."""
        query = [*self.encoder.layers.parameters(), *self.projection.parameters()]
        for slow, fast in zip(self.key.parameters(), query, strict=True):
            slow.lerp_(fast, self.config.tau)
