"""The world model of objects: an inverse model learns which slot is the agent.

    p = Σ_k softmax(α)_k · centroid_k,     loss = CE(inverse(p, p′ − p), action) [+ reconstruction, of keypoints]

The slot whose centroid tells the action best is the agent's: nothing else in the world moves with each action. The
inverse model is that of ICM (Pathak et al. 2017), on four numbers instead of two vectors of features. At the end, the
moves of this slot show where on the table each place in the image is (`plane`).
"""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import ObjectsConfig
from gym_open.agents.encoder import init_layer
from gym_open.agents.objects.encoders import KeypointEncoder, ObjectEncoder, SlotEncoder
from gym_open.agents.objects.plane import CELLS, fit_plane
from gym_open.agents.objects.readout import EMPTY, centroids
from gym_open.agents.world_model import TransitionBatch, WorldModel
from gym_open.envs.constants import MOVES

MIDDLE, LENGTH = CELLS / 2, 10.0
"""The inverse model sees a coordinate c in cells as `(c − MIDDLE) / LENGTH`."""
_KEEP = 0.95
"""Share of the running mean of each map that a gradient step keeps."""


class Objects(WorldModel):
    """An inverse model over the agent's centroid; with keypoints, a reconstruction as well."""

    figures = ("inverse", "inverse_accuracy", "agent_share", "reconstruction")
    error_parts = ("inverse",)
    encoder: ObjectEncoder

    def __init__(
        self, encoder: ObjectEncoder, config: ObjectsConfig, n_actions: int, generator: torch.Generator
    ) -> None:
        super().__init__(encoder, config, n_actions)
        first, last = nn.Linear(4, config.hidden), nn.Linear(config.hidden, n_actions)
        init_layer(first, generator)
        init_layer(last, generator, std=1.0)
        self.inverse = nn.Sequential(first, nn.ReLU(), last)
        self._seed = generator.initial_seed()

    def watch(self, images: Tensor) -> None:
        """Group the colours of `images`, (N, 84, 84, 3) uint8, before anything is learned."""
        if isinstance(self.encoder, SlotEncoder):
            self.encoder.fit_colours(images, np.random.default_rng(self._seed))

    def measure(
        self,
        transitions: TransitionBatch,
        shifts: Tensor,  # noqa: ARG002  (places must not move)
        generator: torch.Generator,  # noqa: ARG002
        features: Tensor | None = None,  # noqa: ARG002  (the readout has no gradients)
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross-entropy of the action, plus the reconstruction's error for keypoints; and how well each goes."""
        maps, reconstruction = self._maps(torch.cat([transitions.obs, transitions.next_obs]))
        logits = self._action_logits(maps)
        inverse = F.cross_entropy(logits, transitions.actions)
        named = (logits.argmax(dim=1) == transitions.actions).float().mean()
        share = self.encoder.agent_shares.max()
        values = (inverse, named, share, reconstruction)
        return inverse + reconstruction, dict(zip(self.figures, (value.detach() for value in values), strict=True))

    def finish(self, transitions: TransitionBatch) -> dict[str, float]:
        """Measure the table by the moves of the agent's slot.

        Returns:
            `plane_moves`, the number of moves that agree on the table, and `plane_error`, by how much (median, moves).

        Raises:
            ValueError: if the moves do not agree on a table.
        """
        encoder = self.encoder
        if encoder.config.frame == "image":
            return {}
        begin, end = self._agent_places(transitions.obs), self._agent_places(transitions.next_obs)
        both = np.isfinite(begin + end).all(axis=1)
        directions = np.array(MOVES, np.float64)[transitions.actions.numpy()]
        fit = fit_plane(begin[both], end[both], directions[both])
        if fit is None:
            raise ValueError(f"the moves of slot {encoder.agent}, {both.sum()} of them, do not agree on one table")
        encoder.homography.copy_(torch.from_numpy(fit.homography))
        encoder.reach.copy_(torch.from_numpy(fit.reach))
        return {"plane_moves": fit.moves, "plane_error": round(fit.error, 4)}

    @torch.no_grad()
    def _agent_places(self, images: Tensor) -> np.ndarray:
        """Centroid (row, column) of the agent's slot in each image, (B, 2) float64; NaN if the agent is not seen."""
        parts = [centroids(self.encoder.maps(part)) for part in images.split(500)]
        mass, places = (torch.cat(part)[:, self.encoder.agent].double().numpy() for part in zip(*parts, strict=True))
        return np.where(mass[:, None] > EMPTY, places, np.nan)

    def _maps(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (B, 42, 42, K), with gradients if the encoder learns them, and the reconstruction's error."""
        encoder = self.encoder
        if not isinstance(encoder, KeypointEncoder):
            return encoder.maps(images), torch.zeros(())
        shares = encoder.shares(images)
        mean = shares.mean(dim=(0, 1, 2))
        if torch.is_grad_enabled():
            encoder.mean_map.mul_(_KEEP).add_((1 - _KEEP) * mean.detach())
        return encoder.standing_out(shares, mean), encoder.reconstruction(shares, images)

    def _action_logits(self, maps: Tensor) -> Tensor:
        """Logits (B, n_actions) of the actions between the first and the second half of the maps."""
        _, places = centroids(maps)
        agent = (places * self.encoder.agent_shares[:, None]).sum(dim=1)
        before, after = agent.chunk(2)
        return self.inverse(torch.cat([(before - MIDDLE) / LENGTH, after - before], dim=1))

    @torch.no_grad()
    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        """Cross-entropy of each action, (B,)."""
        maps = self.encoder.maps(torch.cat([transitions.obs, transitions.next_obs]))
        return {"inverse": F.cross_entropy(self._action_logits(maps), transitions.actions, reduction="none")}

    @torch.no_grad()
    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:  # noqa: ARG002
        """Centroids of all slots in cells, each weighed by mass / (mass + ½), (B, 2 K)."""
        mass, places = centroids(self.encoder.maps(images))
        return ((places - MIDDLE) * (mass / (mass + 0.5))[..., None]).flatten(1)
