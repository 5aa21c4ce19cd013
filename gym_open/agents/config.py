"""Configurations of encoders, world models, explorers and PPO. This module needs no torch: `--help` stays fast."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

from msgspec import Meta

from gym_open.config import Config, Count, Fraction, NonNegativeFloat, PositiveFloat, PositiveInt, matching
from gym_open.precision import PrecisionSetting

Width = Annotated[int, Meta(ge=1, le=16_384)]
"""Width of a layer. It is bounded, because a network is created from its file before its weights are checked."""
Device = Literal["cpu", "cuda"]
Architecture = Literal["cnn", "impala", "slots", "keypoints", "state"]
OBJECT_ENCODERS = ("slots", "keypoints")
"""Architectures that find objects. They learn from exploration alone, and stay as they are while a policy learns."""
SYMMETRIES = 8
"""Reflections and quarter turns of the table."""
STATE_SIZE = 177
"""Numbers in a simulator state: `envs.state.STATE_SIZE`, for which this module would have to load the simulator."""
BOXES = 15
"""Boxes around the agent along each axis, in the features of such an encoder."""
_NAME = r"(?!(?:random|oracle|human)\Z)[a-z0-9][a-z0-9+_-]{0,47}\Z"
_NAME_IN_WORDS = (
    "a name of small letters, digits, +, _ and -, at most 48, and none of random, oracle and human, which are reserved"
)
AgentName = Annotated[str, matching(f"^{_NAME}", _NAME_IN_WORDS)]
"""Name of a table row, and part of folder names."""
AgentNameOrNone = Annotated[str, matching(rf"^(?:\Z|{_NAME})", f"nothing, or {_NAME_IN_WORDS}")]


class EncoderConfig(Config, frozen=True, kw_only=True):
    """An encoder from 84×84 images to features."""

    architecture: Architecture = "cnn"
    """`cnn` is the paper's three-layer network (Mnih et al. 2015), `impala` the deeper one of Espeholt et al. 2018.
    `state` is for policies that see the simulator state instead of images: it shows what learning from images costs.
    Such a policy needs a `trunk`."""
    features: Width = 512
    """Width of the last layer of `cnn` and `impala`."""
    pixel_scale: PositiveFloat = 20.0
    """Pixels minus the mean image are multiplied by this over 255. Objects are only four pixels wide."""
    centre: bool = True
    """Whether to subtract the mean image."""
    slots: Annotated[int, Meta(ge=1, le=64)] = 12
    """Number of maps of an architecture that finds objects: one for each colour or keypoint."""
    frame: Literal["table", "image"] = "table"
    """Where the features of such an architecture say that things are: on the table, as the agent's own moves measure
    it, or in the image."""
    readout: Literal["centroids", "grid", "both"] = "both"
    """Features of an architecture that finds objects: places and masses of all slots, masses in boxes around the agent,
    or both."""

    @property
    def width(self) -> int:
        """Number of features that the encoder gives."""
        if self.architecture == "state":
            return STATE_SIZE
        if self.architecture not in OBJECT_ENCODERS:
            return self.features
        centroids, grid = 4 + 3 * self.slots, BOXES * BOXES * self.slots
        return {"centroids": centroids, "grid": grid, "both": centroids + grid}[self.readout]


def check_symmetric(encoder: EncoderConfig, trunk: tuple[int, ...]) -> None:
    """Raise ValueError unless a trunk of these widths on this encoder can have the symmetries of the table."""
    found = encoder.architecture in OBJECT_ENCODERS and encoder.frame == "table"
    if not found and encoder.architecture != "state":
        raise ValueError(
            "`symmetric` needs features that are places on the table: `encoder.architecture` slots or keypoints with "
            f"`encoder.frame` table, or state, got {encoder.architecture!r} and {encoder.frame!r}"
        )
    if not trunk or any(width % SYMMETRIES for width in trunk):
        raise ValueError(f"`symmetric` needs a `trunk` of widths that are multiples of 8, got {list(trunk)}")


class ImagePasses(NamedTuple):
    """How often an image passes through the networks of a world model; `gym_open.forecast` needs it."""

    learned: int
    """Forward and backward, per update."""
    looked: int
    """Only forward, per update: for keys and targets."""
    judged: int
    """Only forward, to compute the model's own error or the loss of a world."""


class WorldModelConfig(Config, frozen=True, kw_only=True):
    """Base of the sections of all world models. It is enough for a world model without further settings."""

    passes: ClassVar[ImagePasses] = ImagePasses(learned=1, looked=1, judged=2)

    loss_scale: PositiveFloat = 1.0
    """The loss of a world is multiplied by this before the curriculum compares it with its threshold."""


class IcmConfig(WorldModelConfig, frozen=True, kw_only=True):
    """Intrinsic curiosity module (Pathak et al. 2017; `pathak22/noreward-rl`)."""

    passes: ClassVar[ImagePasses] = ImagePasses(learned=2, looked=0, judged=2)

    hidden: Width = 256
    """Width of the hidden layer of the inverse and of the forward model."""
    beta: Fraction = 0.2
    """Share of the forward error in the loss. The inverse error has the remaining share."""
    eta: PositiveFloat = 0.01
    """Weight of the forward error in the reward."""
    eta_inverse: NonNegativeFloat = 0.0
    """Weight of the inverse error in the reward. ICM has none; OPEn's table names both errors."""
    loss_scale: PositiveFloat = 0.0067
    """The loss of a world is multiplied by this before the curriculum compares it with its threshold."""


class RndConfig(WorldModelConfig, frozen=True, kw_only=True):
    """Random network distillation (Burda et al. 2018; `openai/random-network-distillation`)."""

    hidden: Width = 512
    """Width of the predictor's two hidden layers."""
    outputs: Width = 512
    """Number of outputs of the target, which the predictor predicts."""
    clip: PositiveFloat = 5.0
    """The target's pixels are clipped to this many standard deviations."""
    loss_scale: PositiveFloat = 0.005
    """The loss of a world is multiplied by this before the curriculum compares it with its threshold."""


class CurlConfig(WorldModelConfig, frozen=True, kw_only=True):
    """Contrastive world model (Srinivas et al. 2020, `MishaLaskin/curl`), with random shift in place of its crop."""

    latent: Width = 50
    """Width of the projection in which images are compared."""
    pad: Count = 4
    """Largest random shift of an image, in pixels."""
    tau: Fraction = 0.05
    """Share of the query encoder that enters the key encoder at each of its updates."""
    update_every: PositiveInt = 2
    """Gradient steps between two updates of the key encoder."""
    loss_scale: PositiveFloat = 0.00067
    """The loss of a world is multiplied by this before the curriculum compares it with its threshold."""


class ObjectsConfig(WorldModelConfig, frozen=True, kw_only=True):
    """Objects from exploration: colour slots or keypoints, and which of them is the agent."""

    passes: ClassVar[ImagePasses] = ImagePasses(learned=2, looked=0, judged=2)

    hidden: Width = 64
    """Width of the inverse model's hidden layer."""


class WorldModelSections(Config, frozen=True, kw_only=True):
    """One section per world model. The key `world_model` of the whole configuration says which section is used.

    The section `ae` belongs to the class `Ae` in `gym_open/agents/ae.py`.
    """

    icm: IcmConfig = IcmConfig()
    """Used if `world_model` is `icm`."""
    rnd: RndConfig = RndConfig()
    """Used if `world_model` is `rnd`."""
    curl: CurlConfig = CurlConfig()
    """Used if `world_model` is `curl`."""

    def section(self, name: "WorldModelName") -> WorldModelConfig:
        """The section of the world model `name`."""
        return getattr(self, name)


INTRINSIC_REWARDS = {
    "error": "rewards.OwnError",
    "ride": "rewards.Ride",
    "counted-ride": "rewards.CountedRide",
}
"""Intrinsic rewards by name, with the module and class of each in `gym_open/agents/`."""
if TYPE_CHECKING:  # type checkers cannot compute the names; at run time, configurations accept no others
    WorldModelName = ExplorerModelName = OfflineModelName = RewardName = str
else:
    WorldModelName = Literal[WorldModelSections.__struct_fields__]
    OfflineModelName = Literal[*WorldModelSections.__struct_fields__, "objects"]
    ExplorerModelName = Literal["none", *WorldModelSections.__struct_fields__]
    RewardName = Literal["none", *INTRINSIC_REWARDS]


class PPOConfig(Config, frozen=True, kw_only=True):
    """Proximal policy optimisation (Schulman et al. 2017). Names are those of CleanRL's `ppo_atari.py`."""

    learning_rate: PositiveFloat = 5e-4
    """Adam's step size (its epsilon is 1e-5)."""
    anneal_lr: bool = False
    """Whether the learning rate falls linearly to zero over the run."""
    gamma: Fraction = 0.95
    """Discount per step."""
    gae_lambda: Fraction = 0.95
    """Decay per step of the generalised advantage estimate."""
    minibatch_size: PositiveInt = 512
    """Transitions per gradient step. The last minibatch of an epoch may be smaller."""
    update_epochs: PositiveInt = 4
    """Epochs over each rollout."""
    norm_adv: bool = True
    """Whether to scale the advantages of a minibatch to mean 0 and standard deviation 1."""
    clip_coef: PositiveFloat = 0.2
    """The ratio of probabilities is clipped to 1 ± this; beyond it there is no gradient."""
    clip_vloss: bool = True
    """Whether to clip the change of the value by `clip_coef`, too."""
    ent_coef: NonNegativeFloat = 0.005
    """Weight of the policy's entropy."""
    vf_coef: NonNegativeFloat = 0.5
    """Weight of the value loss."""
    max_grad_norm: PositiveFloat = 0.5
    """Norm to which the gradient is clipped."""
    target_kl: PositiveFloat | None = None
    """The update stops after the first epoch whose KL divergence exceeds this."""
    shift_pad: Count = 8
    """Largest random shift, in pixels, of images in the update (Kostrikov et al. 2021). 0 for no shift."""
    precision: PrecisionSetting = "auto"
    """Arithmetic of the network. `auto` is bf16 on a processor or GPU that multiplies it natively, else fp32. Weights
    are fp32 in any case."""


EXPLORER_PPO = PPOConfig(learning_rate=1e-3, minibatch_size=128, update_epochs=3, shift_pad=4, ent_coef=0.15)
"""PPO for exploration. The defaults of `PPOConfig` are those of fine-tuning."""


class ExplorerConfig(WorldModelSections, frozen=True, kw_only=True):
    """An explorer: a world model and a reward that is computed from it, over one PPO."""

    world_model: ExplorerModelName = "curl"
    """The world model that learns. With `none`, nothing is learned and actions are random."""
    reward: RewardName = "ride"
    """The intrinsic reward: `error` is the world model's own error. `ride` is the distance that an action moved the
    world in the model's latent space. `counted-ride` is the same, but smaller where the agent has been before in this
    segment. With `none`, actions are uniformly random, and the world model, if there is one, still learns."""
    share_encoder: bool = True
    """Whether policy and world model share one encoder, as in the paper. If not, each has its own encoder."""
    encoder: EncoderConfig = EncoderConfig()
    """From images to features."""
    ppo: PPOConfig = EXPLORER_PPO
    """The learner of the policy. The world model uses the same Adam, minibatches and epochs. `anneal_lr` is refused."""

    def __post_init__(self) -> None:
        if self.world_model == "none" and self.reward != "none":
            raise ValueError(
                f"`reward` {self.reward!r} needs a world model, got `world_model` 'none'; choose "
                f"{' or '.join(WorldModelSections.__struct_fields__)}, or "
                "give `reward` 'none'"
            )
        if self.encoder.architecture == "state":
            raise ValueError("`encoder.architecture` 'state' is for policies on a task; explorers see images")
        if self.encoder.architecture in OBJECT_ENCODERS:
            raise ValueError(
                f"`encoder.architecture` {self.encoder.architecture!r} is for `gym-open train encoder`, which needs a "
                "finished exploration run; give cnn or impala"
            )
        if self.ppo.anneal_lr:
            raise ValueError(
                "`ppo.anneal_lr` needs to know where a run ends, but exploration may end before its budget is spent: "
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
