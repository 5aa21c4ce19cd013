"""Configuration of `gym-open benchmark`: agents, tasks, seeds, and numbers of steps."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gym_open.agents.config import AgentName
from gym_open.config import Config, PositiveInt, Seed

TaskName = Literal["goal-seeking", "preferences", "avoidance", "tool-use"]
File = Annotated[str, Meta(min_length=1)]
"""A configuration file of the workspace."""


class AgentConfig(Config, frozen=True, kw_only=True):
    """One agent: how it explores without a task, what it keeps of that, and how it learns a task."""

    name: AgentName
    """Name of its row in tables, and part of folder names."""
    policy: File
    """Configuration of `train policy`. Task, seed and other values of the grid replace those in the file."""
    policies: dict[TaskName, File] = msgspec.field(default_factory=dict[TaskName, File])
    """Configurations of `train policy` for tasks that need another one than `policy`."""
    collect: File | None = None
    """Configuration of its exploration. Without it, the agent learns each task from scratch."""
    collect_steps: PositiveInt | None = None
    """Steps of its exploration, in place of the grid's `collect_steps`."""
    online: bool = False
    """Start from the explorer's own encoder at the end of exploration, as in the paper."""
    encoder: File | None = None
    """Configuration of `train encoder`: start from an encoder that is trained from the release of the exploration."""
    release: File = "datasets/explore.toml"
    """Configuration of that release (`dataset build`)."""
    frozen: bool = False
    """Do not train the encoder while the task is learned."""
    play_seed: Seed | None = None
    """Seed of one exploration run and one encoder, which all runs share. Without it, each run has its own, as in the
    paper."""

    def __post_init__(self) -> None:
        starts = self.online or self.encoder is not None
        if self.online and self.encoder is not None:
            raise ValueError(
                f"agent {self.name!r}: both `online` and `encoder` are given, but a policy starts from one encoder; "
                "leave one out, or make two agents of it"
            )
        if starts and self.collect is None:
            raise ValueError(f"agent {self.name!r}: an encoder needs exploration to learn from; give `collect`")
        if self.collect is not None and not starts:
            raise ValueError(f"agent {self.name!r}: its exploration is not used; give `online = true` or `encoder`")
        for field in ("collect_steps", "play_seed"):
            if getattr(self, field) is not None and self.collect is None:
                raise ValueError(f"agent {self.name!r}: `{field}` without exploration; give `collect`, or leave it out")
        if self.frozen and not starts:
            raise ValueError(f"agent {self.name!r}: `frozen` without an encoder from exploration; leave it out")


class GridConfig(Config, frozen=True, kw_only=True):
    """A grid of agents × tasks × seeds. Files are those of the workspace; values given here replace values in them."""

    tasks: Annotated[tuple[TaskName, ...], Meta(min_length=1)]
    """Tasks that every agent learns."""
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1)]
    """Root seeds. Each agent has one run per task and seed."""
    agents: Annotated[tuple[AgentConfig, ...], Meta(min_length=1)]
    """Rows of the table."""
    collect_steps: PositiveInt | None = None
    """Steps of every exploration run."""
    collect_pool: PositiveInt | None = None
    """Worlds in the pool of every exploration run. A longer run needs more worlds, or it ends when all are learned."""
    encoder_updates: PositiveInt | None = None
    """Gradient steps of every encoder that is trained from a release."""
    policy_steps: PositiveInt | None = None
    """Steps of every policy."""
    checkpoints: tuple[PositiveInt, ...] | None = None
    """Steps at which a policy is scored, in addition to its end."""
    probe: File | None = None
    """Configuration of `train probe` for every encoder. Without it, no encoder is probed."""
    evaluate: File = "evaluate/goal-seeking.toml"
    """Configuration of `evaluate`. The grid replaces its task."""

    def __post_init__(self) -> None:
        lists = {"tasks": self.tasks, "seeds": self.seeds, "agents": [agent.name for agent in self.agents]}
        for field, values in lists.items():
            if twice := [value for i, value in enumerate(values) if value in values[:i]]:
                raise ValueError(f"`{field}`: {twice[0]!r} is given twice; leave one out or rename it")
