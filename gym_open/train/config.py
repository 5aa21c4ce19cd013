"""Configurations of `gym-open train encoder`, `train policy` and `train probe`."""

from typing import Literal

from gym_open.agents.config import (
    OBJECT_ENCODERS,
    AgentNameOrNone,
    Device,
    EncoderConfig,
    ObjectsConfig,
    OfflineModelName,
    PPOConfig,
    Width,
    WorldModelSections,
    check_symmetric,
)
from gym_open.config import Config, Count, PositiveFloat, PositiveInt, Seed
from gym_open.precision import PrecisionSetting


class EncoderTrainConfig(WorldModelSections, frozen=True, kw_only=True):
    """Configuration of off-line training: a world model is learned from a release, and its encoder is kept."""

    world_model: OfflineModelName = "curl"
    """World model that trains the encoder."""
    updates: PositiveInt = 400
    """Gradient steps."""
    batch_size: PositiveInt = 128
    """Steps of exploration per gradient step. In `curl`, the negatives of a step are all others of its batch."""
    learning_rate: PositiveFloat = 3e-4
    """Adam's step size. At 1e-3, the value for exploration, about half of the features die within 400 updates."""
    shift_pad: Count = 4
    """Largest random shift of the images, in pixels (Kostrikov et al. 2021); 0 for none."""
    report_every: PositiveInt = 100
    """Updates between two rows of the learning curve. A killed run continues from the last row."""
    objects: ObjectsConfig = ObjectsConfig()
    """Used if `world_model` is `objects`, which explorers do not have."""
    encoder: EncoderConfig = EncoderConfig()
    """The network."""
    precision: PrecisionSetting = "auto"
    """Arithmetic of the network: `auto` is bf16 on a processor or GPU that multiplies it natively, else fp32. Weights
    stay fp32."""
    device: Device = "cpu"
    """Device of the network: `cpu`, or `cuda` for a GPU, where the last bits of two runs may differ."""
    threads: PositiveInt = 2
    """Threads. They are part of the configuration because their number may change the last bits."""
    seed: Seed = 0
    """Root seed."""

    def __post_init__(self) -> None:
        if self.encoder.architecture == "state":
            raise ValueError("`encoder.architecture` 'state' takes no images; give cnn, impala, slots or keypoints")
        if (self.world_model == "objects") != (self.encoder.architecture in OBJECT_ENCODERS):
            raise ValueError(
                f"`world_model` 'objects' needs `encoder.architecture` slots or keypoints, and only it takes these; "
                f"got {self.world_model!r} with {self.encoder.architecture!r}"
            )


Transfer = Literal["scaled", "weights", "convolutions"]


class PolicyTrainConfig(Config, frozen=True, kw_only=True):
    """Configuration of PPO on one task, with puzzles drawn from its training distribution."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task to learn."""
    steps: PositiveInt = 40_960
    """Agent steps in all environments together, rounded up to whole rollouts."""
    num_envs: PositiveInt = 32
    """Environments of the vector environment."""
    num_steps: PositiveInt = 128
    """Steps of each environment in a rollout."""
    mean_images: PositiveInt = 1000
    """Number of puzzles whose images are averaged to the mean image. Used from scratch only: an encoder has its own."""
    checkpoints: tuple[PositiveInt, ...] = (200_000, 500_000, 1_000_000)
    """Step numbers, up to whole rollouts, after which the policy is also saved. The paper scores these."""
    agent: AgentNameOrNone = ""
    """Name in tables and reports. If empty, it follows from the start: `scratch`, `curl+ride`, …"""
    encoder: EncoderConfig = EncoderConfig()
    """The network. It must be that of the encoder from which training starts, if there is one."""
    transfer: Transfer = "scaled"
    """What a policy takes from an encoder: its `weights` unchanged; `scaled`, the same weights, scaled so that features
    are as large as those of an untrained encoder; or only its `convolutions`, with a fresh last layer."""
    trunk: tuple[Width, ...] = ()
    """Widths of hidden layers, with tanh, between the encoder and the linear heads."""
    symmetric: bool = False
    """Give the trunk and the heads the symmetries of the table: reflections and quarter turns. They need an encoder
    that finds objects on the table, and a trunk whose widths are multiples of 8."""
    encoder_learning_rate: PositiveFloat | None = None
    """Adam's step size for the encoder, if it is another than `ppo.learning_rate`."""
    frozen: bool = False
    """Keep the encoder unchanged and learn only the heads, from unshifted images."""
    ppo: PPOConfig = PPOConfig()
    """Settings of PPO."""
    device: Device = "cpu"
    """Device of the network: `cpu`, or `cuda` for a GPU."""
    threads: PositiveInt = 2
    """Threads. They are part of the configuration because their number may change the last bits."""
    seed: Seed = 0
    """Root seed."""

    def __post_init__(self) -> None:
        if self.encoder.architecture in OBJECT_ENCODERS and not self.frozen:
            raise ValueError(
                f"`frozen` must be true for `encoder.architecture` {self.encoder.architecture!r}: its features have no "
                "gradients, got false"
            )
        if self.encoder.architecture == "state" and not self.trunk:
            raise ValueError("`trunk` needs a layer if `encoder.architecture` is 'state', got none: give [256, 256]")
        if self.symmetric:
            check_symmetric(self.encoder, self.trunk)


class ProbeConfig(Config, frozen=True, kw_only=True):
    """Configuration of linear probes: where are the objects, and what does a move do?"""

    train_worlds: PositiveInt = 1500
    """Worlds to which the linear maps are fitted."""
    validation_worlds: PositiveInt = 400
    """Worlds on which the strength of regularisation is chosen."""
    test_worlds: PositiveInt = 800
    """Worlds on which the maps are scored."""
    moves: PositiveInt = 3
    """Random moves per world."""
    ridge: tuple[PositiveFloat, ...] = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
    """Strengths to choose from: penalties on squared weights, for features of mean square length 1."""
    untrained: PositiveInt = 2
    """Number of untrained encoders for comparison. Their R² differs by up to .05."""
    pixels: bool = True
    """Also probe the pixels themselves."""
    threads: PositiveInt = 2
    """Threads. They are part of the configuration because their number may change the last bits."""
    seed: Seed = 0
    """Root seed."""
