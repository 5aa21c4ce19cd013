"""Configurations of the agents' parts; no torch here, so that `gym-open --help` answers at once."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.config import Config, Count, Fraction, NonNegativeFloat, PositiveFloat, PositiveInt, matching
from gym_open.precision import PrecisionSetting

Width = Annotated[int, Meta(ge=1, le=16_384)]
"""Of a layer; bounded, since a network is made as its file says before its weights are looked at."""
Device = Literal["cpu", "cuda"]
Architecture = Literal["cnn", "impala", "state"]
WorldModelName = Literal["none", "icm", "rnd", "curl"]
RewardName = Literal["none", "error", "ride", "counted-ride"]
_NAME = r"(?!(?:random|oracle|human)\Z)[a-z0-9][a-z0-9+_-]{0,47}\Z"
_NAME_IN_WORDS = (
    "a name of small letters, digits, +, _ and -, at most 48, and none of random, oracle and human, which are always "
    "rows of their own"
)
AgentName = Annotated[str, matching(f"^{_NAME}", _NAME_IN_WORDS)]
"""Row of a table, and part of folders' names."""
AgentNameOrNone = Annotated[str, matching(rf"^(?:\Z|{_NAME})", f"nothing, or {_NAME_IN_WORDS}")]


class EncoderConfig(Config, frozen=True, kw_only=True):
    """From an 84×84 picture to features."""

    architecture: Architecture = "cnn"
    """`cnn` is the paper's three-layer network (Mnih et al. 2015), `impala` the deeper one of Espeholt et al. 2018.
    `state` looks at no picture: a policy is told where everything is, which shows what seeing costs."""
    features: Width = 512
    """Width of the last layer."""
    pixel_scale: PositiveFloat = 20.0
    """Pixels, less the mean picture, are multiplied by this over 255: objects are only four pixels wide."""
    centre: bool = True
    """Subtract the mean picture."""


class IcmConfig(Config, frozen=True, kw_only=True):
    """Intrinsic curiosity module (Pathak et al. 2017; `pathak22/noreward-rl`)."""

    hidden: Width = 256
    """Width of the hidden layer of the inverse and of the forward model."""
    beta: Fraction = 0.2
    """Share of the forward error in the loss; the inverse error has the rest."""
    eta: PositiveFloat = 0.01
    """Weight of the forward error in the reward."""
    eta_inverse: NonNegativeFloat = 0.0
    """Weight of the inverse error in the reward: ICM's own has none, OPEn's table names both."""
    loss_scale: PositiveFloat = 0.0067
    """What the loss of a world is multiplied by before the curriculum looks at it."""


class RndConfig(Config, frozen=True, kw_only=True):
    """Random network distillation (Burda et al. 2018; `openai/random-network-distillation`)."""

    hidden: Width = 512
    """Width of the predictor's two hidden layers."""
    outputs: Width = 512
    """Features that the target gives and the predictor predicts."""
    clip: PositiveFloat = 5.0
    """Deviations beyond which the target's pixels are clipped."""
    loss_scale: PositiveFloat = 0.005
    """What the loss of a world is multiplied by before the curriculum looks at it."""


class CurlConfig(Config, frozen=True, kw_only=True):
    """Contrastive world model (Srinivas et al. 2020, `MishaLaskin/curl`), with random shift in place of its crop."""

    latent: Width = 50
    """Width of the projection that is compared."""
    pad: Count = 4
    """Largest random shift, in pixels, of the views of a picture."""
    tau: Fraction = 0.05
    """Share of the query encoder that enters the key encoder at an update."""
    update_every: PositiveInt = 2
    """The key encoder is updated every so many gradient steps."""
    loss_scale: PositiveFloat = 0.00067
    """What the loss of a world is multiplied by before the curriculum of exploration looks at it."""


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
    precision: PrecisionSetting = "auto"
    """Arithmetic of the network: `auto` is bf16 on a processor or GPU that multiplies it natively, else fp32. Weights
    stay fp32."""


EXPLORER_PPO = PPOConfig(learning_rate=1e-3, minibatch_size=128, update_epochs=3, shift_pad=4, ent_coef=0.15)
"""What exploration changes of PPO's defaults, which are those of fine-tuning."""


class ExplorerConfig(Config, frozen=True, kw_only=True):
    """Who plays: a world model and the reward that is made of it, over one PPO."""

    world_model: WorldModelName = "curl"
    """What is learned of the world; `none` learns nothing, and acts at random."""
    reward: RewardName = "ride"
    """From within: the world model's own `error`, `ride` (how far an action moved the world in the model's latent
    space), `counted-ride` (the same, less where the agent has been before in its stay), or `none`, which acts uniformly
    at random while the model, if there is one, still learns."""
    share_encoder: bool = True
    """Policy and world model share one encoder, as the paper insists; else each has one of its own."""
    encoder: EncoderConfig = EncoderConfig()
    """From pictures to features."""
    icm: IcmConfig = IcmConfig()
    """Looked at if `world_model` is `icm`."""
    rnd: RndConfig = RndConfig()
    """Looked at if `world_model` is `rnd`."""
    curl: CurlConfig = CurlConfig()
    """Looked at if `world_model` is `curl`."""
    ppo: PPOConfig = EXPLORER_PPO
    """The learner of the policy; its Adam, minibatches and epochs are the world model's too; no `anneal_lr` here."""

    def __post_init__(self) -> None:
        if self.world_model == "none" and self.reward != "none":
            raise ValueError(
                f"`reward` {self.reward!r} needs a world model, got `world_model` 'none'; choose icm, rnd or curl, or "
                "give `reward` 'none'"
            )
        if self.encoder.architecture == "state":
            raise ValueError("`encoder.architecture` 'state' is for policies on a task; explorers look at pictures")
        if self.ppo.anneal_lr:
            raise ValueError(
                "`ppo.anneal_lr` needs to know where a run ends, and exploration may end before its budget is spent: "
                "give false, or train with `gym-open train policy`"
            )

    @property
    def name(self) -> str:
        """The paper's name in small letters: `icm`, `rnd+ride`, `curl+random`, …, `random`."""
        if self.world_model == "none":
            return "random"
        match self.reward:
            case "none":
                return f"{self.world_model}+random"
            case "error":
                return self.world_model
            case reward:
                return f"{self.world_model}+{reward}"
