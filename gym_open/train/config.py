"""Configurations of `gym-open train encoder`, `train policy` and `train probe`."""

from typing import Literal

from gym_open.agents.config import (
    AgentNameOrNone,
    Device,
    EncoderConfig,
    PPOConfig,
    WorldModelName,
    WorldModelSections,
)
from gym_open.config import Config, Count, PositiveFloat, PositiveInt, Seed
from gym_open.precision import PrecisionSetting


class EncoderTrainConfig(WorldModelSections, frozen=True, kw_only=True):
    """A world model from a release, off-line; its encoder is what is kept."""

    world_model: WorldModelName = "curl"
    """What the encoder learns by."""
    updates: PositiveInt = 400
    """Gradient steps."""
    batch_size: PositiveInt = 128
    """Steps of play a gradient step; in `curl`, all others of a batch are the negatives of each."""
    learning_rate: PositiveFloat = 3e-4
    """Adam's step size. At 1e-3, what exploration uses, about half of the features die within 400 updates."""
    shift_pad: Count = 4
    """Largest random shift, in pixels, of the pictures (Kostrikov et al. 2021); 0 for none."""
    report_every: PositiveInt = 100
    """Updates between two rows of the learning curve; a killed run goes on from the last of them."""
    encoder: EncoderConfig = EncoderConfig()
    """The network."""
    precision: PrecisionSetting = "auto"
    """Arithmetic of the network: `auto` is bf16 on a processor or GPU that multiplies it natively, else fp32. Weights
    stay fp32."""
    device: Device = "cpu"
    """Where the network is: `cuda` for a GPU, where the last bits of two runs may differ."""
    threads: PositiveInt = 2
    """Threads; part of the configuration because the number of threads may change the last bits."""
    seed: Seed = 0
    """Root seed."""

    def __post_init__(self) -> None:
        if self.encoder.architecture == "state":
            raise ValueError("`encoder.architecture` 'state' looks at no picture; give cnn or impala")


Transfer = Literal["scaled", "weights", "convolutions"]


class PolicyTrainConfig(Config, frozen=True, kw_only=True):
    """PPO on one task, puzzles drawn from its training distribution."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """What is to be learned."""
    steps: PositiveInt = 40_960
    """Agent steps over all environments, rounded up to whole rollouts."""
    num_envs: PositiveInt = 32
    """Environments side by side."""
    num_steps: PositiveInt = 128
    """Steps of each environment in a rollout."""
    mean_images: PositiveInt = 1000
    """From scratch, the pictures of so many puzzles make the mean picture; an encoder brings its own."""
    checkpoints: tuple[PositiveInt, ...] = (200_000, 500_000, 1_000_000)
    """The policy is kept as it is after so many steps, too, up to whole rollouts: the paper scores these."""
    agent: AgentNameOrNone = ""
    """What tables and reports call it; if empty, how it began: `scratch`, `curl+ride`, `curl+ride-offline-curl`."""
    encoder: EncoderConfig = EncoderConfig()
    """The network; must be that of the encoder that training starts from, if any."""
    transfer: Transfer = "scaled"
    """What is taken over of an encoder: its `weights` as they are, the same `scaled` so that features are as large as
    an untrained encoder's, or its `convolutions` alone, under a fresh last layer."""
    frozen: bool = False
    """Leave the encoder as it is and learn the heads alone, from unshifted pictures."""
    ppo: PPOConfig = PPOConfig()
    """The learner."""
    device: Device = "cpu"
    """Where the network is: `cuda` for a GPU."""
    threads: PositiveInt = 2
    """Threads; part of the configuration because the number of threads may change the last bits."""
    seed: Seed = 0
    """Root seed."""


class ProbeConfig(Config, frozen=True, kw_only=True):
    """Linear probes of an encoder's features: where are things, and what does a move do?"""

    train_worlds: PositiveInt = 1500
    """Worlds that the linear maps are fitted to."""
    validation_worlds: PositiveInt = 400
    """Worlds that choose the strength of their regularisation."""
    test_worlds: PositiveInt = 800
    """Worlds that score them."""
    moves: PositiveInt = 3
    """Random moves looked at in each world."""
    ridge: tuple[PositiveFloat, ...] = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
    """Strengths to choose from: the penalty on squared weights, where features have mean square length 1."""
    untrained: PositiveInt = 2
    """Untrained encoders to compare with; one may be .05 of R² above another."""
    pixels: bool = True
    """Probe the pixels themselves as well."""
    threads: PositiveInt = 2
    """Threads; part of the configuration because the number of threads may change the last bits."""
    seed: Seed = 0
    """Root seed."""
