"""Configuration of exploration."""

from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerKind, PPOConfig
from gym_open.config import Config, NonNegativeFloat, PositiveInt, Seed
from gym_open.envs.puzzles.generators import SandboxConfig


class CollectConfig(Config, frozen=True, kw_only=True):
    """How to play in the sandbox: who plays, where, for how long, and when a world has been learned."""

    explorer: ExplorerKind = "curl+ride"
    """World model and intrinsic reward."""
    steps: PositiveInt = 20_000
    """Budget: interactions of all streams together. The paper's is 2,000,000."""
    streams: PositiveInt = 4
    """Worlds played in side by side, with one learner; 1 is the paper's way."""
    rollout: PositiveInt = 64
    """Steps that each stream takes between two updates; the curriculum decides after an update."""
    pool: PositiveInt = 12
    """Distinct sandbox worlds to switch between."""
    threshold: NonNegativeFloat = 1.75
    """A world is learned when its loss is under this (nats of InfoNCE); collect/README.md says how it was chosen."""
    window: PositiveInt = 2
    """Rollouts over which the loss of the world being played in is averaged."""
    probe: PositiveInt = 64
    """Distinct latest observations kept of each world, on which its loss is measured."""
    checkpoint_every: PositiveInt = 5
    """Rollouts between two checkpoints."""
    threads: PositiveInt = 1
    """Threads of the learner. Another number rounds sums in another order, so it plays otherwise. Two are faster on an
    idle machine and several times slower than one on a busy one."""
    seed: Seed = 0
    """Root of all randomness."""
    sandbox: SandboxConfig = SandboxConfig()
    """What lies in the worlds of the pool."""
    encoder: EncoderConfig = EncoderConfig()
    """The encoder that policy and world model share."""
    curl: CurlConfig = CurlConfig()
    """The world model."""
    ppo: PPOConfig = PPOConfig(learning_rate=1e-3, minibatch_size=128, update_epochs=3, shift_pad=4, ent_coef=0.15)
    """The learner of the policy; its Adam learns the world model too."""
