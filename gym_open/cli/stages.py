"""The sub-commands of the pipeline: each passes its configuration and paths to a stage."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import tyro

from gym_open import progress, workspace
from gym_open.cli.base import ArtefactCommand, Command, report, say, say_next, show, voice
from gym_open.collect.config import CollectConfig
from gym_open.config import Config
from gym_open.evaluate.config import EvaluateConfig
from gym_open.summary import probe_table, proof_text, score_table, word
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig

C = TypeVar("C", bound=Config)
Settings = Annotated[C, tyro.conf.arg(name="")]
"""The configuration of a stage, whose fields become options of the sub-command."""


@dataclass(frozen=True, kw_only=True)
class StageCommand(Command):
    """A sub-command that reads its settings from a TOML file of the workspace; options override them."""

    settings: Any
    workspace: Path = Path()
    """Folder with the five stage folders."""
    config: Path = Path()
    """TOML file with the settings; options override them."""

    default: ClassVar[str]
    """TOML file in the workspace that is used without --config."""
    needs_workspace: ClassVar[bool] = True
    """Whether the command needs `default` or --config; if not, it has built-in settings."""

    def place(self, given: Path | None, folder: str, name: str | None = None) -> Path:
        """The output path: the given one, or `folder` of the workspace with a name, by default the configuration's."""
        return given or workspace.check(self.workspace) / folder / (name or self.config.stem)


def _recording(made: Path) -> str:
    return shlex.quote(f"{made.name}.rrd")


@dataclass(frozen=True, kw_only=True)
class CollectCommand(ArtefactCommand, StageCommand):
    """Explore the sandbox without a task, and log every step (MCAP).

    Example: gym-open collect --config collect/icm.toml --steps 5000 --out collect/logs/short
    """

    settings: Settings[CollectConfig]
    out: Path | None = None
    """Folder of the log; default collect/logs/ with the configuration's name."""

    default = "collect/curl-ride.toml"
    about = "explore the sandbox without a task, and log every step"

    def run(self) -> None:
        """Explore."""
        with progress.doing("loading PyTorch"):
            from gym_open.collect.explore import collect
        from gym_open.collect.report import summary_table

        made = collect(self.settings, self.place(self.out, "collect/logs"))
        show(summary_table(made.path))
        path = word(made.path)
        report(
            made,
            f"gym-open log replay {path}",
            f"gym-open dataset build --logs {path}",
            f"gym-open viz {path} --save {_recording(made.path)}",
        )


@dataclass(frozen=True, kw_only=True)
class TrainEncoder(ArtefactCommand, StageCommand):
    """Train an encoder offline from a release.

    Example: gym-open train encoder --release datasets/open/explore/1.0.0 --updates 200
    """

    settings: Settings[EncoderTrainConfig]
    release: Path
    """Folder of a release from `gym-open dataset build`."""
    out: Path | None = None
    """Folder of the encoder; default train/encoders/ with the configuration's name."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's event files, written during training."""
    cache: Path | None = None
    """Folder that keeps the release's decoded images for other trainings."""

    default = "train/encoder-curl.toml"
    about = "train an encoder from a release"

    def run(self) -> None:
        """Train."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.encoder import train_encoder

        folder = self.place(self.out, "train/encoders")
        made = train_encoder(self.settings, self.release, folder, tensorboard=self.tensorboard, cache=self.cache)
        path = word(made.path)
        config = " --config train/policy-objects.toml" if self.settings.world_model == "objects" else ""
        report(made, f"gym-open train probe --encoder {path}", f"gym-open train policy --encoder {path}{config}")


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(ArtefactCommand, StageCommand):
    """Train a policy on one task with PPO, from an encoder or from scratch.

    The encoder is one that was trained offline from a release, or the final encoder of an explorer, in its log.

    Example: gym-open train policy --encoder train/encoders/encoder-curl --task goal-seeking

    Example: gym-open train policy --encoder collect/logs/icm --config train/policy-strong.toml
    """

    settings: Settings[PolicyTrainConfig]
    encoder: Path | None = None
    """Folder of an encoder or of a log to start from; without it, training starts from scratch."""
    out: Path | None = None
    """Folder of the policy; default train/policies/ with the configuration's name."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's event files, written during training."""

    default = "train/policy-goal-seeking.toml"
    about = "train a policy on a task with PPO"

    def run(self) -> None:
        """Train."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.policy import train_policy

        folder = self.place(self.out, "train/policies")
        made = train_policy(self.settings, self.encoder, folder, tensorboard=self.tensorboard)
        report(made, f"gym-open evaluate --task {self.settings.task} --policy {word(made.path)}")


@dataclass(frozen=True, kw_only=True)
class TrainProbe(ArtefactCommand, StageCommand):
    """Measure with linear probes how well an encoder's features locate objects in new worlds.

    Example: gym-open train probe --encoder train/encoders/encoder-curl
    """

    settings: Settings[ProbeConfig]
    encoder: Path
    """Folder of an encoder, or of a log whose explorer trained one."""
    out: Path | None = None
    """Folder of the result; default train/probes/ with the encoder's name."""

    default = "train/probe.toml"
    about = "measure an encoder's features with linear probes"

    def run(self) -> None:
        """Train and score the probes."""
        with progress.doing("loading PyTorch"):
            from gym_open.train.probe import probe

        made = probe(self.settings, self.encoder, self.place(self.out, "train/probes", self.encoder.name))
        show(probe_table(made.path))
        report(made)


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(ArtefactCommand, StageCommand):
    """Score a policy, or random actions, on the 100 fixed puzzles of a task.

    The oracle replays the witnesses of a planner that sees the simulator state. Its score is the highest possible one.

    Example: gym-open evaluate --policy train/policies/policy-goal-seeking
    """

    settings: Settings[EvaluateConfig]
    policy: Path | None = None
    """Folder of a policy; without it, uniformly random actions are scored."""
    oracle: bool = False
    """Score the witnesses of the puzzles instead of a policy."""
    at: int | None = None
    """Score the policy's checkpoint at this step, which its configuration must list; default the final policy."""
    out: Path | None = None
    """Folder of the scores; default evaluate/scores/ with a name that says what was scored, and how."""

    default = "evaluate/goal-seeking.toml"
    about = "score a policy on the 100 fixed puzzles of a task"

    def run(self) -> None:
        """Score the policy."""
        with progress.doing("loading the world"):
            from gym_open.evaluate.play import evaluate

        name = self._name()
        folder = self.place(self.out, "evaluate/scores", name)
        made = evaluate(self.settings, self.policy, folder, oracle=self.oracle, at=self.at)
        show(score_table({name: made.path}))
        say(proof_text(name, made.path))
        chosen = f" --policy {word(self.policy)}" if self.policy else ""
        report(made, f"gym-open score verify {word(made.path)}{chosen}", f"gym-open report {word(made.path.parent)}")

    def _name(self) -> str:
        """A name with the policy and all settings that are not the default, so that other scores get other folders."""
        name = self.policy.name if self.policy else f"{self.settings.task}-{'oracle' if self.oracle else 'random'}"
        name += "" if self.at is None else f"-at{self.at}"
        name += "-greedy" if self.policy and self.settings.actions == "greedy" else ""
        return name + ("" if self.settings.split == "test" else f"-{self.settings.split}")


@dataclass(frozen=True, kw_only=True)
class RunCommand(ArtefactCommand):
    """Run all stages in a workspace: explore, release, train an encoder, fine-tune policies, score, visualise.

    Stages that are up to date are skipped. After an interruption, the same command continues.

    Example: gym-open run --workspace ~/my-workspace --seed 1

    In a script: gym-open run --json --quiet | jq 'select(.kind == "scores") | .figures.a_success'
    """

    workspace: Path = Path()
    """Folder with the five stage folders and their configurations."""
    seed: int = 0
    """Root seed of every stage; part of the artefacts' names."""

    stages = True
    about = "run all stages, from exploration to scores; start here"

    def run(self) -> None:
        """Run all stages."""
        from gym_open.pipeline import run

        run(self.workspace, self.seed, voice)


@dataclass(frozen=True, kw_only=True)
class InitCommand(Command):
    """Make a workspace: five stage folders with default configurations.

    Example: gym-open init ~/my-workspace
    """

    directory: Annotated[Path, tyro.conf.Positional]
    """Folder of the workspace."""

    about = "make a workspace with the default configurations"

    def run(self) -> None:
        """Make the workspace."""
        for path in workspace.init(self.directory):
            say(f"  {path}")
        say(f"the workspace {self.directory}", verb="made")
        say_next(f"gym-open run --workspace {word(self.directory)}")
