"""Configuration of exploration."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.agents.config import ExplorerConfig
from gym_open.config import Config, NonNegativeFloat, PositiveInt, Seed
from gym_open.envs.puzzles.generators import SandboxConfig

RuleName = Literal["loss", "never", "interval", "uniform", "progress"]


class CurriculumConfig(Config, frozen=True, kw_only=True):
    """When a stream leaves its world, and which world it enters next."""

    rule: RuleName = "loss"
    """`loss`, the paper's rule, leaves a learned world for the world of highest loss, and stops when all are learned.
    Three others leave every `interval` steps: `interval` enters the next world in order, `uniform` a random one, and
    `progress` the one whose loss changed most since the last decision. `never` stays."""
    threshold: NonNegativeFloat = 0.001
    """A world is learned when its scaled loss is below this: the paper's value. collect/README.md has the scales."""
    window: PositiveInt = 4
    """Number of rollouts over which the loss of a current world is averaged. It is not learned before them."""
    interval: PositiveInt = 2048
    """Steps in a world between two decisions of `interval`, `uniform` and `progress`, rounded up to whole rollouts."""


class LogConfig(Config, frozen=True, kw_only=True):
    """Optional contents of the logs, and the sizes of their parts."""

    depth: bool = False
    """Whether to log depth in metres (84×84 float32)."""
    segmentation: bool = False
    """Whether to log segmentation as numbers of geoms (84×84 int32)."""
    keyframe_every: PositiveInt = 256
    """Steps of a segment between two full states of the simulation. A replay can start from each."""
    roll_mb: PositiveInt = 256
    """Size in MiB after which a stream's log continues in a new file, from the next keyframe on."""


class CollectConfig(Config, frozen=True, kw_only=True):
    """How to explore the sandbox: explorer, worlds, number of steps, and when a world is learned."""

    steps: PositiveInt = 20_000
    """Budget: steps of all streams together. The paper's is 2,000,000."""
    streams: PositiveInt = 4
    """Number of streams: worlds that are explored in parallel, with one learner. The paper has 1."""
    rollout: PositiveInt = 64
    """Steps of each stream between two updates. The curriculum decides after an update."""
    pool: PositiveInt = 12
    """Distinct sandbox worlds to switch between."""
    probe: Annotated[int, Meta(ge=16)] = 64
    """Latest transitions of each world, with distinct observations, on which its loss is measured. CURL's loss is small
    for few images, which are easy to tell apart. Its scale is for 64."""
    checkpoint_every: PositiveInt = 20
    """Rollouts between two checkpoints."""
    threads: PositiveInt = 2
    """Threads of the learner. Their number may change the last bits, so it is part of the configuration."""
    seed: Seed = 0
    """Root of all randomness."""
    sandbox: SandboxConfig = SandboxConfig()
    """Contents of the worlds of the pool."""
    explorer: ExplorerConfig = ExplorerConfig()
    """The explorer: world model, reward, learner."""
    curriculum: CurriculumConfig = CurriculumConfig()
    """Which world each stream explores."""
    log: LogConfig = LogConfig()
    """Contents of the logs."""
