"""Configuration of `gym-open benchmark`: which agents learn which tasks with which seeds, and for how long."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.agents.config import AgentName
from gym_open.config import Config, PositiveInt, Seed

TaskName = Literal["goal-seeking", "preferences", "avoidance", "tool-use"]
File = Annotated[str, Meta(min_length=1)]
"""A configuration file of the workspace."""


class AgentConfig(Config, frozen=True, kw_only=True):
    """One agent: how it plays before there is a task, what it keeps of that, and how it learns a task."""

    name: AgentName
    """Its row in tables and its part of folders' names."""
    policy: File
    """Configuration of `train policy`; task, seed and what else is given here replace its own."""
    collect: File | None = None
    """Configuration of its play; without one it learns each task from scratch."""
    collect_steps: PositiveInt | None = None
    """Steps of its play, if not the benchmark's."""
    online: bool = False
    """Start from the encoder that the explorer itself ended with, as the paper does."""
    encoder: File | None = None
    """Configuration of an encoder that is trained from the play's release, to start from that."""
    release: File = "datasets/explore.toml"
    """Configuration of that release."""
    frozen: bool = False
    """Keep the encoder as it is while the task is learned."""
    play_seed: Seed | None = None
    """Seed of one play, and of one encoder, for all runs; if not given, each run has its own, as in the paper."""

    def __post_init__(self) -> None:
        starts = self.online or self.encoder is not None
        if self.online and self.encoder is not None:
            raise ValueError(
                f"agent {self.name!r}: both `online` and `encoder`, but a policy starts from one encoder; leave one "
                "out, or make two agents of it"
            )
        if starts and self.collect is None:
            raise ValueError(f"agent {self.name!r}: an encoder needs play to learn from; give `collect`")
        if self.collect is not None and not starts:
            raise ValueError(f"agent {self.name!r}: nothing is made of its play; give `online = true` or `encoder`")
        for field in ("collect_steps", "play_seed"):
            if getattr(self, field) is not None and self.collect is None:
                raise ValueError(f"agent {self.name!r}: `{field}` without play; give `collect`, or leave it out")
        if self.frozen and not starts:
            raise ValueError(f"agent {self.name!r}: `frozen` without an encoder that play has made; leave it out")


class GridConfig(Config, frozen=True, kw_only=True):
    """A grid of agents × tasks × seeds. Files are those of the workspace; what is given here replaces what they say."""

    tasks: Annotated[tuple[TaskName, ...], Meta(min_length=1)]
    """Tasks that every agent learns."""
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1)]
    """Root seeds: a run each of every agent on every task."""
    agents: Annotated[tuple[AgentConfig, ...], Meta(min_length=1)]
    """Rows of the table."""
    collect_steps: PositiveInt | None = None
    """Steps of every play."""
    collect_pool: PositiveInt | None = None
    """Worlds of every play: a longer one needs more, or it ends when all are learned."""
    encoder_updates: PositiveInt | None = None
    """Gradient steps of every encoder that is trained from a release."""
    policy_steps: PositiveInt | None = None
    """Steps of every policy."""
    checkpoints: tuple[PositiveInt, ...] | None = None
    """Steps at which a policy is scored, besides its end."""
    probe: File | None = None
    """Configuration of `train probe`, for every encoder; without one, none is probed."""
    evaluate: File = "evaluate/goal-seeking.toml"
    """Configuration of the scoring; the task is replaced."""

    def __post_init__(self) -> None:
        lists = {"tasks": self.tasks, "seeds": self.seeds, "agents": [agent.name for agent in self.agents]}
        for field, values in lists.items():
            if twice := [value for i, value in enumerate(values) if value in values[:i]]:
                raise ValueError(f"`{field}`: {twice[0]!r} is there twice; leave one out or rename it")
