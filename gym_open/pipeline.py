"""`gym-open run`: takes a workspace through all stages, and skips what is up to date.

The result of every stage is an artefact that records the digests of its inputs. So "up to date" is read from disk, and
a killed stage resumes from its own checkpoint. The pipeline itself keeps no state.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec

from gym_open import artefacts, progress, workspace
from gym_open.artefacts import Outcome
from gym_open.collect.config import CollectConfig
from gym_open.config import Config, check, load
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.puzzles.sets import puzzle_id
from gym_open.evaluate.config import EvaluateConfig
from gym_open.forecast import outlook, work
from gym_open.summary import (
    PAPER_NOTE,
    probe_table,
    proof_text,
    read_json,
    score_table,
    short,
    stage_record,
    stage_table,
    word,
)
from gym_open.terminal import Voice, markup
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig
from gym_open.version import __version__
from gym_open.viz.config import VizConfig

C = TypeVar("C", bound=Config)


class PipelineConfigs(msgspec.Struct, frozen=True, kw_only=True):
    """The configurations of one run. All are read and checked before anything starts."""

    collect: CollectConfig
    release: ReleaseConfig
    encoder: EncoderTrainConfig
    probe: ProbeConfig
    policy: PolicyTrainConfig
    scratch: PolicyTrainConfig
    evaluate: EvaluateConfig
    viz: VizConfig


def read_plan(root: Path, seed: int) -> PipelineConfigs:
    """Read the eight configurations that a run uses, with `seed` in each. Both policies learn for as many steps.

    Raises:
        ConfigError: if a file or value is wrong; it names the file and the key.
    """

    def read(name: str, kind: type[C]) -> C:
        config = load(root / name, kind)
        if "seed" in kind.__struct_fields__:
            config = check(msgspec.structs.replace(config, seed=seed), source="--seed")
        return config

    scratch = read("train/policy-goal-seeking.toml", PolicyTrainConfig)
    policy = read("train/policy-objects.toml", PolicyTrainConfig)
    return PipelineConfigs(
        collect=read("collect/curl-ride.toml", CollectConfig),
        release=read("datasets/explore.toml", ReleaseConfig),
        encoder=read("train/encoder-objects.toml", EncoderTrainConfig),
        probe=read("train/probe.toml", ProbeConfig),
        policy=msgspec.structs.replace(policy, task=scratch.task, steps=scratch.steps),
        scratch=scratch,
        evaluate=read("evaluate/goal-seeking.toml", EvaluateConfig),
        viz=read("viz/default.toml", VizConfig),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class PipelineStage(outlook.PlannedStage):
    """A stage of the run."""

    make: Callable[[], Outcome]
    """Makes the artefact, unless it is up to date."""


def stages(plan: PipelineConfigs, root: Path, seed: int) -> list[PipelineStage]:
    """The stages of a run, in order. Each stage finds its inputs in the folders of earlier stages."""
    log = PipelineStage(
        name="collect",
        folder=(logs := root / f"collect/logs/curl-ride-seed{seed}"),
        config=plan.collect,
        work=work.collecting(plan.collect),
        make=lambda: _collect(plan.collect, logs),
    )
    named = msgspec.structs.replace(plan.release, name=f"{plan.release.name}-seed{seed}")
    release = PipelineStage(
        name="dataset build",
        folder=(built := root / "datasets" / named.name / named.version),
        config=named,
        needs=(log,),
        work=work.releasing(plan.collect),
        make=lambda: _build(named, logs, built),
    )
    encoder = PipelineStage(
        name="train encoder",
        folder=(learned := root / f"train/encoders/objects-seed{seed}"),
        config=plan.encoder,
        needs=(release,),
        work=work.encoding(plan.encoder, plan.collect.steps),
        make=lambda: _train_encoder(plan.encoder, built, learned),
    )
    probe = PipelineStage(
        name="train probe",
        folder=(probed := root / f"train/probes/objects-seed{seed}"),
        config=plan.probe,
        needs=(encoder,),
        work=work.probing(plan.probe, plan.encoder.encoder),
        make=lambda: _probe(plan.probe, learned, probed),
    )
    policies = [_policy(plan, root, seed, start) for start in (encoder, None)]
    scores = [_scores(plan, root, seed, policy) for policy in (*policies, None)]
    shown, filmed = [log, *policies, *scores], [score.folder for score in scores[:-1]]
    recording = PipelineStage(
        name="viz recording",
        folder=(recorded := root / f"viz/recordings/run-seed{seed}"),
        config=plan.viz,
        needs=(log,),
        work=work.drawing(plan.collect),
        make=lambda: _record(plan.viz, logs, recorded),
    )
    figure = PipelineStage(
        name="viz figure",
        folder=(drawn := root / f"viz/figures/run-seed{seed}"),
        config=plan.viz,
        needs=tuple(shown),
        work=work.Work(),
        make=lambda: _draw(plan.viz, [stage.folder for stage in shown], filmed, drawn),
    )
    return [log, release, encoder, probe, *policies, *scores, recording, figure]


def _policy(plan: PipelineConfigs, root: Path, seed: int, encoder: PipelineStage | None) -> PipelineStage:
    start, config = (encoder.folder, plan.policy) if encoder else (None, plan.scratch)
    folder = root / f"train/policies/{config.task}-{'objects' if encoder else 'scratch'}-seed{seed}"
    return PipelineStage(
        name=f"train policy from {'play' if encoder else 'scratch'}",
        folder=folder,
        config=config,
        needs=(encoder,) if encoder else (),
        work=work.learning(config, encoder=encoder is not None),
        make=lambda: _train_policy(config, start, folder),
    )


def _scores(plan: PipelineConfigs, root: Path, seed: int, policy: PipelineStage | None) -> PipelineStage:
    played = policy.folder if policy else None
    trained = policy.config if policy else None
    folder = root / "evaluate/scores" / (played.name if played else f"{plan.policy.task}-random-seed{seed}")
    config = plan.evaluate if policy else msgspec.structs.replace(plan.evaluate, actions="sampled")
    return PipelineStage(
        name=f"evaluate {policy.name.replace('train policy', 'PPO') if policy else 'random'}",
        folder=folder,
        config=config,
        needs=(policy,) if policy else (),
        work=work.playing(config, trained.encoder if isinstance(trained, PolicyTrainConfig) else None),
        make=lambda: _evaluate(config, played, folder),
    )


def _collect(config: CollectConfig, out: Path) -> Outcome:
    from gym_open.collect.explore import collect

    return collect(config, out)


def _build(config: ReleaseConfig, log: Path, out: Path) -> Outcome:
    from gym_open.datasets.build import build_release

    return build_release(config, [log], out, replace=True)


def _train_encoder(config: EncoderTrainConfig, release: Path, out: Path) -> Outcome:
    from gym_open.train.encoder import train_encoder

    return train_encoder(config, release, out)


def _probe(config: ProbeConfig, encoder: Path, out: Path) -> Outcome:
    from gym_open.train.probe import probe

    return probe(config, encoder, out)


def _train_policy(config: PolicyTrainConfig, encoder: Path | None, out: Path) -> Outcome:
    from gym_open.train.policy import train_policy

    return train_policy(config, encoder, out)


def _evaluate(config: EvaluateConfig, policy: Path | None, out: Path) -> Outcome:
    from gym_open.evaluate.play import evaluate

    return evaluate(config, policy, out)


def _record(config: VizConfig, log: Path, out: Path) -> Outcome:
    def work(partial: Path) -> dict[str, str]:
        from gym_open.viz.recording import visualize

        visualize(config, log, partial / "recording.rrd")
        return {}

    return artefacts.build(out, kind="recording", config=config, parents=[log], work=work)


def _draw(config: VizConfig, sources: list[Path], filmed: list[Path], out: Path) -> Outcome:
    """The figure, and a film of the policies on the first puzzle in the observation's look, which needs no OpenGL."""
    log, *others = sources

    def work(partial: Path) -> dict[str, str]:
        from gym_open.viz.config import Choice
        from gym_open.viz.export import write_video
        from gym_open.viz.figures import draw_run_figure

        draw_run_figure(log, others, partial / "run.png")
        first = Choice(puzzle=puzzle_id(artefacts.config_of(filmed[0])["task"], "test", 0))
        write_video(msgspec.structs.replace(config, film_look="observation"), filmed, first, partial / "run.mp4")
        return {}

    return artefacts.build(out, kind="figure", config=config, parents=sources, work=work)


@dataclass
class Journal:
    """Runs the stages one by one, prints each, and keeps their results."""

    voice: Voice
    total: int
    """Number of stages."""
    rows: list[tuple[str, str, str, str]] = field(default_factory=list)
    made: int = 0

    def stage(self, stage: PipelineStage) -> None:
        """Run one stage, unless it is up to date."""
        console = self.voice.console
        if not (console.is_terminal and progress.on_terminal()):  # there, its progress bar shows it
            console.print(f"{len(self.rows) + 1}/{self.total} {stage.name} …", highlight=False)
        started = time.perf_counter()
        with progress.stage(stage.name):
            outcome = stage.make()
        seconds = time.perf_counter() - started
        self.made += outcome.made
        result = "made" if outcome.made else "up to date"
        self.rows.append((stage.name, result, f"{seconds:.1f} s", artefacts.digest(outcome.path)[:12]))
        kept = f", the earlier one is now {markup(outcome.earlier.name)}" if outcome.earlier else ""
        console.print(f"[bold]{stage.name:<27}[/] {result} ({seconds:.1f} s){kept}", highlight=False, soft_wrap=True)
        self.voice.record(stage_record(stage.name, outcome, seconds))


def run(root: Path, seed: int, voice: Voice) -> None:
    """Run all stages in the workspace at `root`, with one root seed.

    Raises:
        UsageError: if `root` is no workspace or a configuration is wrong. Nothing was started.
        GymOpenError: if a stage fails. The artefacts of earlier stages stay.
    """
    started = time.perf_counter()
    workspace.check(root)
    plan = read_plan(root, seed)
    row = stages(plan, root, seed)
    expected = _begin(plan, root, row, voice)
    journal = Journal(voice, len(row))
    for stage in row:
        journal.stage(stage)
    folders = {stage.name: stage.folder for stage in row}
    scores = {name.removeprefix("evaluate "): path for name, path in folders.items() if name.startswith("evaluate ")}
    for table in (stage_table(journal.rows), probe_table(folders["train probe"]), score_table(scores)):
        voice.console.print(table)
    for name, path in scores.items():
        voice.console.print(markup(proof_text(name, path)), highlight=False)
    voice.console.print(f"({PAPER_NOTE})\n", highlight=False)
    _end(journal, scores, f"{_exact(time.perf_counter() - started)}{expected}", voice)
    voice.say(f"  {_sentence(plan, list(scores.values()))}")
    voice.say(f"  curves: {short(folders['viz figure'] / 'run.png')}, film: {short(folders['viz figure'] / 'run.mp4')}")
    longer = f"--config {word(root / 'train/policy-objects.toml')} --encoder {word(folders['train encoder'])}"
    for line in (
        f"rerun {word(folders['viz recording'] / 'recording.rrd')}",
        f"gym-open viz {word(folders['dataset build'])} --save release.rrd",
        f"gym-open train policy {longer}",
        f"gym-open run --workspace {word(root)} --seed {seed + 1}",
    ):
        voice.say(f"  next: {line}")


def _begin(plan: PipelineConfigs, root: Path, row: Sequence[PipelineStage], voice: Voice) -> str:
    """Print this machine and the expected time. Return the expected time for the last line, if there is one."""
    if voice.quiet:  # it would not be printed
        return ""
    if warning := outlook.too_full(root, work.bytes_written(plan.collect)):
        voice.console.print(f"[bold yellow]warning:[/] {markup(warning)}", highlight=False, soft_wrap=True)
    found, left = f"gym-open {__version__} on {outlook.found(row, root)}", outlook.to_do(row)
    if not left:
        voice.say(f"{found}: all {len(row)} stages seem to be up to date")
        return ""
    expected = outlook.expected(left)
    which = f"{len(row)} stages" if len(left) == len(row) else f"the {len(left)} of {len(row)} stages that are left"
    voice.say(f"{found}: {expected} for {which}")
    return f" ({expected} expected)"


def _end(journal: Journal, scores: dict[str, Path], took: str, voice: Voice) -> None:
    reached = ", ".join(f"{name} {read_json(path / 'scores.json')['a_success']:.3f}" for name, path in scores.items())
    if journal.made:
        voice.result(f"{journal.made} of {journal.total} stages in {took}; A-Success: {reached}", verb="made")
    else:
        voice.result(f"all {journal.total} stages are up to date; A-Success: {reached}", verb="nothing to do:")


def _sentence(plan: PipelineConfigs, scores: Sequence[Path]) -> str:
    """What the run shows: the two policies at the same number of steps."""
    found = [read_json(path / "scores.json") for path in scores[:2]]
    play, scratch = (record["a_success"] for record in found)
    return (
        f"after the same {found[0]['trained']:,} steps of {found[0]['task']}, the policy from play has an A-Success of "
        f"{play:.2f}, the policy from scratch {scratch:.2f}; play took {plan.collect.steps:,} steps without a task"
    )


def _exact(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
