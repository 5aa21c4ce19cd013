"""Configurations of the agents' parts; no torch here, so that `gym-open --help` answers at once."""

from typing import Literal

from gym_open.config import Config, Count, Fraction, NonNegativeFloat, PositiveFloat, PositiveInt

Precision = Literal["fp32", "bf16"]
ExplorerKind = Literal["curl+ride", "curl+random"]
"""World model and reward: `curl+random` plays uniformly random actions and learns the world model alone."""


class EncoderConfig(Config, frozen=True, kw_only=True):
    """The three-layer CNN of the paper (Mnih et al. 2015), from an 84×84 picture to features."""

    features: PositiveInt = 512
    """Width of the last layer."""
    pixel_scale: PositiveFloat = 20.0
    """Pixels, less the mean picture, are multiplied by this over 255: objects are only four pixels wide."""


class CurlConfig(Config, frozen=True, kw_only=True):
    """Contrastive world model (Srinivas et al. 2020, `MishaLaskin/curl`), with random shift in place of its crop."""

    latent: PositiveInt = 50
    """Width of the projection that is compared."""
    pad: Count = 4
    """Largest random shift, in pixels, of the two views of a picture."""
    tau: Fraction = 0.05
    """Share of the query encoder that enters the key encoder at an update."""
    update_every: PositiveInt = 2
    """The key encoder is updated every so many losses."""


class PPOConfig(Config, frozen=True, kw_only=True):
    """Proximal policy optimisation (Schulman et al. 2017); names are those of CleanRL's `ppo_atari.py`."""

    learning_rate: PositiveFloat = 5e-4
    """Adam's step size (its epsilon is 1e-5)."""
    anneal_lr: bool = False
    """Let the learning rate fall linearly to zero over the run."""
    gamma: Fraction = 0.95
    """Discount a step."""
    gae_lambda: Fraction = 0.95
    """Decay a step of the generalised advantage estimate."""
    minibatch_size: PositiveInt = 512
    """Transitions a gradient step; the last minibatch of an epoch may be smaller."""
    update_epochs: PositiveInt = 4
    """Passes over each rollout."""
    norm_adv: bool = True
    """Scale the advantages of a minibatch to mean 0 and deviation 1."""
    clip_coef: PositiveFloat = 0.2
    """Ratio of probabilities beyond which there is no more gradient."""
    clip_vloss: bool = True
    """Clip the value's change by `clip_coef` as well."""
    ent_coef: NonNegativeFloat = 0.005
    """Weight of the policy's entropy."""
    vf_coef: NonNegativeFloat = 0.5
    """Weight of the value loss."""
    max_grad_norm: PositiveFloat = 0.5
    """Norm to which the gradient is clipped."""
    target_kl: PositiveFloat | None = None
    """Stop the update after the epoch whose KL divergence passes this."""
    shift_pad: Count = 8
    """Largest random shift, in pixels, of the pictures in the update (Kostrikov et al. 2021); 0 for none."""
    precision: Precision = "bf16"
    """Arithmetic of the network: bf16 is the faster on CPUs that have it, weights stay fp32."""
