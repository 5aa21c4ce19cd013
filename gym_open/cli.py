"""The command `gym-open`: sub-commands only; each hands its configuration and paths to a stage.

Slow libraries (torch, mujoco, lerobot, rerun) are imported when a sub-command runs, so that `--help` answers at once.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, get_type_hints

import tyro
from rich.console import Console

import gym_open
from gym_open import artefacts, workspace
from gym_open.collect.config import CollectConfig
from gym_open.config import Config, check, load
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import GymOpenError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.summary import probe_table, proof_text, score_table, short
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig
from gym_open.viz.config import VizConfig

C = TypeVar("C", bound=Config)
Settings = Annotated[C, tyro.conf.arg(name="")]
"""A stage's configuration: its fields become options of the sub-command."""

out = Console()


@dataclass(frozen=True, kw_only=True)
class StageCommand(ABC):
    """A sub-command whose settings start from a TOML file of the workspace."""

    settings: Any
    workspace: Path = Path()
    """Folder with the five stage folders."""
    config: Path = Path()
    """TOML file that the settings start from."""

    default: ClassVar[str]
    about: ClassVar[str]

    def place(self, given: Path | None, folder: str, name: str | None = None) -> Path:
        """Where to write: the path given, or `folder` of the workspace and a name (the configuration's)."""
        return given or workspace.check(self.workspace) / folder / (name or self.config.stem)

    @abstractmethod
    def run(self) -> None:
        """Do it."""


def report(made: artefacts.Outcome, *then: str) -> None:
    """Say what came of it and which commands to type next."""
    verb = "made" if made.made else "up to date, nothing to do:"
    out.print(f"[bold green]{verb}[/] {short(made.path)}  (digest {artefacts.digest(made.path)[:16]})", soft_wrap=True)
    if made.earlier is not None:
        out.print(f"  what was there before, of other inputs, is now {short(made.earlier)}", soft_wrap=True)
    for line in then:
        out.print(f"  next: {line}", highlight=False, soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class Collect(StageCommand):
    """Explore the sandbox without a task and log every step (MCAP).

    Example: gym-open collect --steps 5000 --out collect/logs/short
    """

    settings: Settings[CollectConfig]
    out: Path | None = None
    """Folder of the logs; default collect/logs/ and the configuration's name."""

    default = "collect/curl-ride.toml"
    about = "explore the sandbox without a task and log it"

    def run(self) -> None:
        """Collect."""
        from gym_open.collect.explore import collect

        made = collect(self.settings, self.place(self.out, "collect/logs"))
        path = short(made.path)
        report(made, f"gym-open dataset build --logs {path}", f"gym-open viz {path} --save {made.path.name}.rrd")


@dataclass(frozen=True, kw_only=True)
class DatasetBuild(StageCommand):
    """Turn logs into a LeRobot v3.0 release, frames bit-exact.

    Example: gym-open dataset build --logs collect/logs/curl-ride --out datasets/open/explore
    """

    settings: Settings[ReleaseConfig]
    logs: Path
    """Folder of logs that `gym-open collect` made."""
    out: Path | None = None
    """Folder of the release; default datasets/open/ and the configuration's name."""

    default = "datasets/explore.toml"
    about = "logs to a LeRobot release"

    def run(self) -> None:
        """Build."""
        from gym_open.datasets.build import build_release

        made = build_release(self.settings, self.logs, self.place(self.out, "datasets/open"))
        path = short(made.path)
        report(made, f"gym-open train encoder --release {path}", f"gym-open viz {path} --save {made.path.name}.rrd")


@dataclass(frozen=True, kw_only=True)
class TrainEncoder(StageCommand):
    """Learn an encoder from a release, off-line.

    Example: gym-open train encoder --release datasets/open/explore --updates 200
    """

    settings: Settings[EncoderTrainConfig]
    release: Path
    """Folder of a release that `gym-open dataset build` made."""
    out: Path | None = None
    """Folder of the encoder; default train/encoders/ and the configuration's name."""

    default = "train/encoder-curl.toml"
    about = "learn an encoder from a release"

    def run(self) -> None:
        """Train."""
        from gym_open.train.encoder import train_encoder

        made = train_encoder(self.settings, self.release, self.place(self.out, "train/encoders"))
        path = short(made.path)
        report(made, f"gym-open train probe --encoder {path}", f"gym-open train policy --encoder {path}")


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(StageCommand):
    """Train a policy on one task with PPO, from an encoder or from scratch.

    Example: gym-open train policy --encoder train/encoders/encoder-curl --task goal-seeking
    """

    settings: Settings[PolicyTrainConfig]
    encoder: Path | None = None
    """Folder of an encoder to start from; without it, from scratch."""
    out: Path | None = None
    """Folder of the policy; default train/policies/ and the configuration's name."""

    default = "train/policy-goal-seeking.toml"
    about = "PPO on a task, from an encoder or from scratch"

    def run(self) -> None:
        """Train."""
        from gym_open.train.policy import train_policy

        made = train_policy(self.settings, self.encoder, self.place(self.out, "train/policies"))
        report(made, f"gym-open evaluate --task {self.settings.task} --policy {short(made.path)}")


@dataclass(frozen=True, kw_only=True)
class TrainProbe(StageCommand):
    """Ask an encoder, by linear probes, where things are on tables that it never saw.

    Example: gym-open train probe --encoder train/encoders/encoder-curl
    """

    settings: Settings[ProbeConfig]
    encoder: Path
    """Folder of an encoder."""
    out: Path | None = None
    """Folder of the result; default train/probes/ and the encoder's name."""

    default = "train/probe.toml"
    about = "what an encoder knows, by linear probes"

    def run(self) -> None:
        """Probe."""
        from gym_open.train.probe import probe

        made = probe(self.settings, self.encoder, self.place(self.out, "train/probes", self.encoder.name))
        out.print(probe_table(made.path))
        report(made)


@dataclass(frozen=True, kw_only=True)
class Evaluate(StageCommand):
    """Score a policy, or without one uniformly random actions, on a task's 100 fixed puzzles.

    Example: gym-open evaluate --policy train/policies/policy-goal-seeking
    """

    settings: Settings[EvaluateConfig]
    policy: Path | None = None
    """Folder of a policy; without it, a random one is scored."""
    out: Path | None = None
    """Folder of the scores; default evaluate/scores/ and the policy's name."""

    default = "evaluate/goal-seeking.toml"
    about = "score a policy on the 100 fixed puzzles"

    def run(self) -> None:
        """Evaluate."""
        from gym_open.evaluate.play import evaluate

        name = self.policy.name if self.policy else f"{self.settings.task}-random"
        made = evaluate(self.settings, self.policy, self.place(self.out, "evaluate/scores", name))
        out.print(score_table({name: made.path}))
        out.print(proof_text(name, made.path))
        report(made)


@dataclass(frozen=True, kw_only=True)
class Viz(StageCommand):
    """Write a Rerun recording of a log, a release, or a model's learning curves.

    Example: gym-open viz collect/logs/curl-ride --save play.rrd   (then: rerun play.rrd)
    """

    source: Annotated[Path, tyro.conf.Positional]
    """Folder of logs, one .mcap file, a release, an encoder or a policy."""
    settings: Settings[VizConfig]
    save: Path
    """The .rrd file to write."""

    default = "viz/default.toml"
    about = "a Rerun recording of a log, a release or a model"

    def run(self) -> None:
        """Write the recording."""
        from gym_open.viz.recording import visualize

        path = visualize(self.settings, self.source, self.save)
        out.print(
            f"[bold green]made[/] {short(path)}  ({path.stat().st_size / 1e6:.1f} MB)\n  next: rerun {short(path)}"
        )


@dataclass(frozen=True, kw_only=True)
class Run:
    """Take a workspace through all stages: play, log, release, learn, fine-tune, score, look.

    What is up to date is skipped; after a kill, the same command goes on where it was.

    Example: gym-open run --workspace ~/my-workspace --seed 1
    """

    workspace: Path = Path()
    """Folder with the five stage folders and their configurations."""
    seed: int = 0
    """Root seed of every stage; part of the artefacts' names."""

    about: ClassVar[str] = "all stages, from play to score; the place to start"

    def run(self) -> None:
        """Run all."""
        from gym_open.pipeline import run

        run(self.workspace, self.seed, out)


@dataclass(frozen=True, kw_only=True)
class Init:
    """Make a workspace: the five stage folders with their default configurations.

    Example: gym-open init ~/my-workspace
    """

    directory: Annotated[Path, tyro.conf.Positional]
    """Folder to make it in."""

    about: ClassVar[str] = "make a workspace with the default configurations"

    def run(self) -> None:
        """Make it."""
        for path in workspace.init(self.directory):
            out.print(f"  {path}", highlight=False)
        out.print(f"[bold green]made[/] the workspace {self.directory}", highlight=False)
        out.print(f"  next: gym-open run --workspace {self.directory}", highlight=False)


COMMANDS: dict[str, type[StageCommand] | type[Run] | type[Init]] = {
    "run": Run,
    "init": Init,
    "collect": Collect,
    "dataset build": DatasetBuild,
    "train encoder": TrainEncoder,
    "train policy": TrainPolicy,
    "train probe": TrainProbe,
    "evaluate": Evaluate,
    "viz": Viz,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return the exit code: 0 done, 1 the run or the check failed, 2 wrong use."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        _overview()
        return 0
    if words[0] == "--version":
        print(gym_open.__version__)
        return 0
    name = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in COMMANDS), None)
    if name is None:
        return _unknown(words)
    try:
        _parse(name, words[len(name.split()) :]).run()
    except GymOpenError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


def _parse(name: str, words: list[str]) -> StageCommand | Run | Init:
    kind = COMMANDS[name]
    program = f"gym-open {name}"
    if not issubclass(kind, StageCommand):
        return tyro.cli(kind, args=words, prog=program)
    root = Path(_value(words, "--workspace") or ".")
    file = Path(_value(words, "--config") or root / kind.default)
    settings_type = get_type_hints(kind)["settings"]
    asks_help = any(word in ("-h", "--help") for word in words)
    settings = settings_type() if asks_help and not file.is_file() else load(file, settings_type)
    given: dict[str, Any] = {"settings": settings, "workspace": root, "config": file}
    required = {f.name: tyro.MISSING for f in fields(kind) if f.default is MISSING and f.name not in given}
    command = tyro.cli(kind, args=words, prog=program, default=kind(**given, **required))
    check(command.settings, source="options")
    return command


def _value(words: Sequence[str], option: str) -> str | None:
    for i, word in enumerate(words):
        if word == option and i + 1 < len(words):
            return words[i + 1]
        if word.startswith(f"{option}="):
            return word.split("=", 1)[1]
    return None


def _overview() -> None:
    print(f"gym-open {gym_open.__version__}: play without a task, released as data, scored by what it was worth\n")
    print("usage: gym-open COMMAND [options]      gym-open COMMAND --help shows its options and an example\n")
    for name, kind in COMMANDS.items():
        print(f"  {name:<15} {kind.about}")
    print("\nexample: gym-open run")


def _unknown(words: Sequence[str]) -> int:
    near = [name for name in COMMANDS if words[0] in name.split()]
    if near and len(words) > 1 and words[1] in ("-h", "--help"):
        print("\n".join(f"  gym-open {name:<15} {COMMANDS[name].about}" for name in near))
        return 0
    hint = f"did you mean {' or '.join(f'`gym-open {name}`' for name in near)}?" if near else "see gym-open --help"
    print(f"error: no command {' '.join(words[:2])!r}; {hint}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
