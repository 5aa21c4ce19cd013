"""Configuration of exploration."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.agents.config import ExplorerConfig
from gym_open.config import Config, NonNegativeFloat, PositiveInt, Seed
from gym_open.envs.puzzles.generators import SandboxConfig

RuleName = Literal["loss", "never", "interval", "uniform", "progress"]


class CurriculumConfig(Config, frozen=True, kw_only=True):
    """When a stream leaves its world, and for which."""

    rule: RuleName = "loss"
    """`loss`, the paper's: leave a world that is learned for the one of highest loss, stop when all are learned. The
    others leave every `interval` steps: `interval` for the next world in order, `uniform` for one at random, `progress`
    for the one whose loss changed most since the last decision. `never` stays."""
    threshold: NonNegativeFloat = 0.001
    """A world is learned when its scaled loss is under this: the paper's figure; collect/README.md has the scales."""
    window: PositiveInt = 4
    """Rollouts over which the loss of the world being played in is averaged; it is not learned before that many."""
    interval: PositiveInt = 2048
    """Steps in a world between two decisions of `interval`, `uniform` and `progress`, up to whole rollouts."""


class LogConfig(Config, frozen=True, kw_only=True):
    """What is logged beyond what always is, and in what pieces."""

    depth: bool = False
    """Log what the camera sees as metres too (84×84 float32)."""
    segmentation: bool = False
    """Log what the camera sees as numbers of geoms too (84×84 int32)."""
    keyframe_every: PositiveInt = 256
    """Steps of a segment between two full states of the simulation, which a replay starts from."""
    roll_mb: PositiveInt = 256
    """MiB after which a stream's log goes on in a new file, from the next keyframe on."""


class CollectConfig(Config, frozen=True, kw_only=True):
    """How to play in the sandbox: who plays, where, for how long, and when a world has been learned."""

    steps: PositiveInt = 20_000
    """Budget: interactions of all streams together. The paper's is 2,000,000."""
    streams: PositiveInt = 4
    """Worlds played in side by side, with one learner; 1 is the paper's way."""
    rollout: PositiveInt = 64
    """Steps that each stream takes between two updates; the curriculum decides after an update."""
    pool: PositiveInt = 12
    """Distinct sandbox worlds to switch between."""
    probe: Annotated[int, Meta(ge=16)] = 64
    """Latest transitions kept of each world, of distinct observations, on which its loss is measured. CURL's loss is
    small among few pictures, which are easily told apart; its scale is for 64."""
    checkpoint_every: PositiveInt = 20
    """Rollouts between two checkpoints."""
    threads: PositiveInt = 2
    """Threads of the learner; part of the configuration because their number may change the last bits."""
    seed: Seed = 0
    """Root of all randomness."""
    sandbox: SandboxConfig = SandboxConfig()
    """What lies in the worlds of the pool."""
    explorer: ExplorerConfig = ExplorerConfig()
    """Who plays: world model, reward, learner."""
    curriculum: CurriculumConfig = CurriculumConfig()
    """Which world is played in."""
    log: LogConfig = LogConfig()
    """What is written."""
