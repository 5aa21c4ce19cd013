"""Turns the configuration of a grid into jobs: each is one `gym-open` command with the jobs that it needs.

An exploration run, a release or an encoder that several agents share is one job. Nothing is started here, but all
configurations are read and checked, so that mistakes show before hours of work and not after.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from gym_open import artefacts
from gym_open.collect.config import CollectConfig
from gym_open.config import Config, check, load, to_dict, to_toml
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.puzzles.sets import published_digests
from gym_open.envs.puzzles.witnesses import witness_name
from gym_open.errors import ConfigError
from gym_open.evaluate.config import CheckpointConfig, EvaluateConfig, OracleConfig
from gym_open.grid.config import AgentConfig, GridConfig, TaskName
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig

C = TypeVar("C", bound=Config)
StageName = Literal["collect", "dataset build", "train encoder", "train probe", "train policy", "evaluate"]

SPEEDS: dict[StageName, float] = {
    "collect": 250, "dataset build": 500, "train encoder": 12, "train probe": 0.025, "train policy": 500,
    "evaluate": 15,
}  # fmt: skip
"""Approximate speed of one core, in units of the stage per second: steps, steps, updates, probes, steps, puzzles."""
KINDS: dict[StageName, str] = {
    "collect": "log", "dataset build": "release", "train encoder": "encoder", "train probe": "probe",
    "train policy": "policy", "evaluate": "scores",
}  # fmt: skip
"""Kind of the artefact that each stage makes."""
START = 6.0
"""Approximate seconds that a job needs for its imports."""
_PUZZLES = 100


@dataclass(frozen=True)
class GridJob:
    """One command that makes one artefact."""

    name: str
    """Name of the job and of its files."""
    stage: StageName
    """Sub-command of `gym-open`."""
    out: Path
    """Folder of the artefact."""
    config: Config
    """Its whole configuration."""
    units: int
    """Amount of work, in units of its stage."""
    options: tuple[str, ...] = ()
    """Options of the command in addition to its configuration and `out`."""
    needs: tuple["GridJob", ...] = ()
    """Jobs whose artefacts it reads."""
    key: Config | None = None
    """Configuration that the artefact records, if it differs from `config`."""

    def is_up_to_date(self) -> bool:
        """Whether the command would have nothing to do. False in case of doubt. This is cheaper than starting it."""
        parents = [need.out for need in self.needs]
        return artefacts.is_up_to_date(
            self.out, kind=KINDS[self.stage], config=self.key or self.config, parents=parents
        )

    def words(self, folder: Path) -> list[str]:
        """Words of the command after `gym-open`; `folder` holds the job's configuration."""
        file = folder / f"{self.name}.toml"
        return [*self.stage.split(), "--config", str(file), *self.options, "--out", str(self.out)]

    def toml(self) -> str:
        """The configuration as TOML. TOML has no null, so values that are None are left out; None is their default."""
        return to_toml(to_dict(self.config))


def make_plan(config: GridConfig, out: Path, *, root: Path) -> list[GridJob]:
    """All jobs of a grid, each after the jobs that it needs.

    Args:
        config: agents, tasks and seeds.
        out: folder of the grid; the jobs' artefacts lie in it as in a workspace.
        root: workspace that the configuration files belong to.

    Raises:
        ConfigError: if a file is missing or wrong, or two different jobs would have the same name.
    """
    planner = _Planner(config, out, root)
    for seed in config.seeds:
        for agent in config.agents:
            for task in config.tasks:
                planner.run(agent, task, seed)
    for task in config.tasks:
        planner.references(task)
    return list(planner.jobs.values())


class _Planner:
    """Collects the jobs, each of them once."""

    def __init__(self, config: GridConfig, out: Path, root: Path) -> None:
        self.config, self.out, self.root = config, out.absolute(), root  # as an option, a path must not begin with -
        self.jobs: dict[str, GridJob] = {}
        self.evaluation = self.read("evaluate", config.evaluate, EvaluateConfig, threads=1)

    def read(self, field: str, file: str, kind: type[C], **changes: Any) -> C:
        """Read a configuration of the workspace and replace some of its values."""
        path = self.root / file
        if not path.is_file():
            raise ConfigError(f"`{field}`: {path}: no such configuration file; give one of the workspace {self.root}")
        changed = {name: value for name, value in changes.items() if value is not None}
        return check(msgspec.structs.replace(load(path, kind), **changed), source=f"{path} as `{field}`")

    def add(self, job: GridJob) -> GridJob:
        """Add a job, unless the same job is there already, and return it."""
        there = self.jobs.setdefault(job.name, job)
        if there != job:
            raise ConfigError(
                f"two different jobs would be called {job.name!r}: agents use files of the same name with "
                "different contents; give the files (or agents) other names"
            )
        return there

    def exploration(self, agent: AgentConfig, seed: int) -> GridJob:
        """Add an exploration run."""
        assert agent.collect is not None
        steps = agent.collect_steps or self.config.collect_steps
        pool = self.config.collect_pool
        config = self.read("collect", agent.collect, CollectConfig, steps=steps, pool=pool, seed=seed, threads=1)
        name = f"{Path(agent.collect).stem}{f'-{agent.collect_steps}' if agent.collect_steps else ''}-seed{seed}"
        out = self.out / "collect/logs" / name
        return self.add(GridJob(f"collect-{name}", "collect", out, config, config.steps))

    def encoder(self, agent: AgentConfig, seed: int) -> GridJob | None:
        """Add the job that makes the agent's encoder: its exploration run, or training from the release of that run.

        None for an agent that learns from scratch.
        """
        if agent.collect is None:
            return None
        seed = seed if agent.play_seed is None else agent.play_seed
        exploration = self.exploration(agent, seed)
        made = exploration if agent.encoder is None else self.offline_encoder(agent, agent.encoder, exploration, seed)
        if self.config.probe is not None:
            probe = self.read("probe", self.config.probe, ProbeConfig, threads=1)
            out = self.out / "train/probes" / made.out.name
            options = ("--encoder", str(made.out))
            self.add(GridJob(f"probe-{made.out.name}", "train probe", out, probe, 1, options, (made,)))
        return made

    def offline_encoder(self, agent: AgentConfig, file: str, exploration: GridJob, seed: int) -> GridJob:
        """Add the release of an exploration run, and the encoder that is trained from it."""
        name = re.sub(r"[^a-z0-9-]", "-", exploration.out.name.lower())
        release = self.read("release", agent.release, ReleaseConfig, name=f"open/{name}", version="1.0.0")
        folder = self.out / "datasets" / release.name / release.version
        logs = ("--logs", str(exploration.out), "--workers", "1", "--replace")
        built = self.add(
            GridJob(f"release-{name}", "dataset build", folder, release, exploration.units, logs, (exploration,))
        )
        updates = self.config.encoder_updates
        config = self.read("encoder", file, EncoderTrainConfig, updates=updates, seed=seed, threads=1)
        name = f"{Path(file).stem}-of-{exploration.out.name}"
        options = ("--release", str(folder))
        out = self.out / "train/encoders" / name
        return self.add(GridJob(name, "train encoder", out, config, config.updates, options, (built,)))

    def run(self, agent: AgentConfig, task: TaskName, seed: int) -> None:
        """Add one agent's training on one task with one seed, and its scores at every checkpoint."""
        made = self.encoder(agent, seed)
        config = self.read(
            "policy", agent.policies.get(task, agent.policy), PolicyTrainConfig,
            task=task, seed=seed, threads=1, agent=agent.name, frozen=agent.frozen,
            steps=self.config.policy_steps, checkpoints=self.config.checkpoints,
        )  # fmt: skip
        _check_network(agent, config, made)
        name = f"{agent.name}-{task}-seed{seed}"
        policy = self.add(
            GridJob(
                f"policy-{name}", "train policy", self.out / "train/policies" / name, config, config.steps,
                ("--encoder", str(made.out)) if made else (), (made,) if made else (),
            )
        )  # fmt: skip
        options = ("--policy", str(policy.out))
        self.score(name, task, options, policy)
        for at in before_the_end(config):
            key = CheckpointConfig(**{**to_dict(self.evaluation), "task": task}, at=at)
            self.score(f"{name}-at{at}", task, (*options, "--at", str(at)), policy, key=key)

    def references(self, task: TaskName) -> None:
        """Add the lower and the upper reference for all scores: random actions, and the planner's actions."""
        split = self.evaluation.split
        witnesses = published_digests()[witness_name(task, split)]
        self.score(f"random-{task}", task, ())
        self.score(f"oracle-{task}", task, ("--oracle",), key=OracleConfig(task=task, split=split, witnesses=witnesses))

    def score(
        self, name: str, task: TaskName, options: Sequence[str], *needs: GridJob, key: Config | None = None
    ) -> None:
        """Add one evaluation."""
        changed = msgspec.structs.replace(self.evaluation, task=task)
        if not needs:  # without a policy there are no greedy actions
            changed = msgspec.structs.replace(changed, actions="sampled")
        config = check(changed, source="tasks")
        out = self.out / "evaluate/scores" / name
        self.add(GridJob(f"score-{name}", "evaluate", out, config, _PUZZLES, tuple(options), needs, key))


def _check_network(agent: AgentConfig, policy: PolicyTrainConfig, made: GridJob | None) -> None:
    """Raise ConfigError if the policy cannot start from the encoder that the job `made` makes."""
    match made.config if made else None:
        case CollectConfig(explorer=explorer):
            if explorer.world_model == "none":
                raise ConfigError(
                    f"agent {agent.name!r}: {agent.collect} has no world model, so its exploration yields no encoder; "
                    "give `encoder` in place of `online`"
                )
            network, file = explorer.encoder, agent.collect
        case EncoderTrainConfig(encoder=network):
            file = agent.encoder
        case _:
            return
    for name, ours in to_dict(policy.encoder).items():
        if (theirs := getattr(network, name)) != ours:
            raise ConfigError(
                f"agent {agent.name!r}: `encoder.{name}` is {ours!r} in {agent.policy} and {theirs!r} in {file}; a "
                "policy that starts from an encoder has the same network: make the two agree"
            )


def before_the_end(config: PolicyTrainConfig) -> Iterator[int]:
    """Steps of the configured checkpoints whose weights differ from each other and from the weights at the end."""
    rollout = config.num_envs * config.num_steps
    seen = {-(-config.steps // rollout)}
    for at in sorted(config.checkpoints):
        number = -(-at // rollout)
        if number < max(seen) and number not in seen:
            seen.add(number)
            yield at


def seconds(job: GridJob, speeds: dict[StageName, float]) -> float:
    """Approximate run time of a job."""
    return START + job.units / speeds[job.stage]


def chains(jobs: Sequence[GridJob], left: dict[str, float]) -> dict[str, float]:
    """Seconds from the start of each job to the end of the longest dependency chain that begins with it.

    Args:
        jobs: each after the jobs that it needs.
        left: remaining seconds of each job, by name.
    """
    longest = dict.fromkeys((job.name for job in jobs), 0.0)
    for job in reversed(jobs):
        longest[job.name] += left[job.name]
        for need in job.needs:
            longest[need.name] = max(longest[need.name], longest[job.name])
    return longest
