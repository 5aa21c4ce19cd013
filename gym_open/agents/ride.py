"""RIDE's intrinsic reward: how far an action moved the world in latent space (Raileanu & Rocktäschel 2020)."""

from torch import Tensor


def ride_reward(latent: Tensor, next_latent: Tensor) -> Tensor:
    """Impact of a step, `reward[b] = ‖next_latent[b] − latent[b]‖₂`.

    There are no episodic counts: OPEn's text names only the distance, and play in a sandbox has no episodes.

    Args:
        latent: features of the observation before the action, (B, D).
        next_latent: features of the observation after it, (B, D).

    Returns:
        (B,), not negative.
    """
    return (next_latent - latent).norm(dim=-1)
