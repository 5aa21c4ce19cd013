"""The pipeline's sub-commands: each hands its configuration and paths to a stage."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import tyro

from gym_open import progress, workspace
from gym_open.cli.base import Command, Making, out, report, say, voice
from gym_open.collect.config import CollectConfig
from gym_open.config import Config
from gym_open.evaluate.config import EvaluateConfig
from gym_open.summary import probe_table, proof_text, score_table, word
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig

C = TypeVar("C", bound=Config)
Settings = Annotated[C, tyro.conf.arg(name="")]
"""A stage's configuration: its fields become options of the sub-command."""


@dataclass(frozen=True, kw_only=True)
class StageCommand(Command):
    """A sub-command whose settings start from a TOML file of the workspace."""

    settings: Any
    workspace: Path = Path()
    """Folder with the five stage folders."""
    config: Path = Path()
    """TOML file that the settings start from."""

    default: ClassVar[str]
    needs_workspace: ClassVar[bool] = True
    """Whether it is wrong use where there is no `default` and no --config."""

    def place(self, given: Path | None, folder: str, name: str | None = None) -> Path:
        """Where to write: the path given, or `folder` of the workspace and a name (the configuration's)."""
        return given or workspace.check(self.workspace) / folder / (name or self.config.stem)


def _recording(made: Path) -> str:
    return shlex.quote(f"{made.name}.rrd")


@dataclass(frozen=True, kw_only=True)
class Collect(Making, StageCommand):
    """Explore the sandbox without a task and log every step (MCAP).

    Example: gym-open collect --config collect/icm.toml --steps 5000 --out collect/logs/short
    """

    settings: Settings[CollectConfig]
    out: Path | None = None
    """Folder of the logs; default collect/logs/ and the configuration's name."""

    default = "collect/curl-ride.toml"
    about = "explore the sandbox without a task and log it"

    def run(self) -> None:
        """Collect."""
        with progress.doing("loading PyTorch"):
            from gym_open.collect.explore import collect
        from gym_open.collect.report import summary_table

        made = collect(self.settings, self.place(self.out, "collect/logs"))
        out.print(summary_table(made.path))
        path = word(made.path)
        report(
            made,
            f"gym-open log replay {path}",
            f"gym-open dataset build --logs {path}",
            f"gym-open viz {path} --save {_recording(made.path)}",
        )


@dataclass(frozen=True, kw_only=True)
class TrainEncoder(Making, StageCommand):
    """Learn an encoder from a release, off-line.

    Example: gym-open train encoder --release datasets/open/explore/1.0.0 --updates 200
    """

    settings: Settings[EncoderTrainConfig]
    release: Path
    """Folder of a release that `gym-open dataset build` made."""
    out: Path | None = None
    """Folder of the encoder; default train/encoders/ and the configuration's name."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's event files, written while it learns."""
    cache: Path | None = None
    """Folder that keeps the release's decoded pictures for the next encoder."""

    default = "train/encoder-curl.toml"
    about = "learn an encoder from a release"

    def run(self) -> None:
        """Train."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.encoder import train_encoder

        folder = self.place(self.out, "train/encoders")
        made = train_encoder(self.settings, self.release, folder, tensorboard=self.tensorboard, cache=self.cache)
        path = word(made.path)
        report(made, f"gym-open train probe --encoder {path}", f"gym-open train policy --encoder {path}")


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(Making, StageCommand):
    """Train a policy on one task with PPO, from an encoder or from scratch.

    The encoder may be one trained off-line from a release, or the one that an explorer ended with, in its log.

    Example: gym-open train policy --encoder train/encoders/encoder-curl --task goal-seeking

    Example: gym-open train policy --encoder collect/logs/icm --config train/policy-strong.toml
    """

    settings: Settings[PolicyTrainConfig]
    encoder: Path | None = None
    """Folder of an encoder, or of logs, to start from; without it, from scratch."""
    out: Path | None = None
    """Folder of the policy; default train/policies/ and the configuration's name."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's event files, written while it learns."""

    default = "train/policy-goal-seeking.toml"
    about = "PPO on a task, from an encoder or from scratch"

    def run(self) -> None:
        """Train."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.policy import train_policy

        folder = self.place(self.out, "train/policies")
        made = train_policy(self.settings, self.encoder, folder, tensorboard=self.tensorboard)
        report(made, f"gym-open evaluate --task {self.settings.task} --policy {word(made.path)}")


@dataclass(frozen=True, kw_only=True)
class TrainProbe(Making, StageCommand):
    """Ask an encoder, by linear probes, where things are on tables that it never saw.

    Example: gym-open train probe --encoder train/encoders/encoder-curl
    """

    settings: Settings[ProbeConfig]
    encoder: Path
    """Folder of an encoder, or of logs whose explorer learned one."""
    out: Path | None = None
    """Folder of the result; default train/probes/ and the encoder's name."""

    default = "train/probe.toml"
    about = "what an encoder knows, by linear probes"

    def run(self) -> None:
        """Probe."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.probe import probe

        made = probe(self.settings, self.encoder, self.place(self.out, "train/probes", self.encoder.name))
        out.print(probe_table(made.path))
        report(made)


@dataclass(frozen=True, kw_only=True)
class Evaluate(Making, StageCommand):
    """Score a policy, or without one uniformly random actions, on a task's 100 fixed puzzles.

    The oracle replays what a planner that sees everything found: what can be scored at most.

    Example: gym-open evaluate --policy train/policies/policy-goal-seeking
    """

    settings: Settings[EvaluateConfig]
    policy: Path | None = None
    """Folder of a policy; without it, a random one is scored."""
    oracle: bool = False
    """Score the puzzles' witnesses instead of a policy."""
    at: int | None = None
    """Score the policy as it was at this checkpoint, one that its configuration asked for; default its end."""
    out: Path | None = None
    """Folder of the scores; default evaluate/scores/ and what was scored, and how."""

    default = "evaluate/goal-seeking.toml"
    about = "score a policy on the 100 fixed puzzles"

    def run(self) -> None:
        """Evaluate."""
        with progress.doing("loading the world"):
            from gym_open.evaluate.play import evaluate

        name = self._name()
        folder = self.place(self.out, "evaluate/scores", name)
        made = evaluate(self.settings, self.policy, folder, oracle=self.oracle, at=self.at)
        out.print(score_table({name: made.path}))
        say(proof_text(name, made.path))
        chosen = f" --policy {word(self.policy)}" if self.policy else ""
        report(made, f"gym-open score verify {word(made.path)}{chosen}", f"gym-open report {word(made.path.parent)}")

    def _name(self) -> str:
        """What was scored, and how if that is not the usual: scores that differ in it stand side by side."""
        name = self.policy.name if self.policy else f"{self.settings.task}-{'oracle' if self.oracle else 'random'}"
        name += "" if self.at is None else f"-at{self.at}"
        name += "-greedy" if self.policy and self.settings.actions == "greedy" else ""
        return name + ("" if self.settings.split == "test" else f"-{self.settings.split}")


@dataclass(frozen=True, kw_only=True)
class Run(Making):
    """Take a workspace through all stages: play, log, release, learn, fine-tune, score, look.

    What is up to date is skipped; after a kill, the same command goes on where it was.

    Example: gym-open run --workspace ~/my-workspace --seed 1

    In a script: gym-open run --json --quiet | jq 'select(.kind == "scores") | .figures.a_success'
    """

    workspace: Path = Path()
    """Folder with the five stage folders and their configurations."""
    seed: int = 0
    """Root seed of every stage; part of the artefacts' names."""

    stages = True
    about = "all stages, from play to score; the place to start"

    def run(self) -> None:
        """Run all."""
        from gym_open.pipeline import run

        run(self.workspace, self.seed, voice)


@dataclass(frozen=True, kw_only=True)
class Init(Command):
    """Make a workspace: the five stage folders with their default configurations.

    Example: gym-open init ~/my-workspace
    """

    directory: Annotated[Path, tyro.conf.Positional]
    """Folder to make it in."""

    about = "make a workspace with the default configurations"

    def run(self) -> None:
        """Make it."""
        for path in workspace.init(self.directory):
            say(f"  {path}")
        say(f"the workspace {self.directory}", verb="made")
        say(f"  next: gym-open run --workspace {word(self.directory)}")
