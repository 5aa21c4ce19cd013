"""`gym-open run`: a workspace through all stages, skipping what is up to date.

Every stage's result is an artefact that knows the digests of its inputs, so "up to date" is read from disk, and a
killed stage goes on from its own checkpoint: the pipeline itself keeps no state.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
from rich.console import Console

from gym_open import artefacts, workspace
from gym_open.artefacts import Outcome
from gym_open.collect.config import CollectConfig
from gym_open.config import Config, check, load
from gym_open.datasets.config import ReleaseConfig
from gym_open.evaluate.config import EvaluateConfig
from gym_open.summary import PAPER_NOTE, probe_table, proof_text, score_table, short, stage_table, word
from gym_open.terminal import markup
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig
from gym_open.viz.config import VizConfig

C = TypeVar("C", bound=Config)


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """The configurations of one run, all read and checked before anything starts."""

    collect: CollectConfig
    release: ReleaseConfig
    encoder: EncoderTrainConfig
    probe: ProbeConfig
    policy: PolicyTrainConfig
    evaluate: EvaluateConfig
    viz: VizConfig


def read_plan(root: Path, seed: int) -> Plan:
    """Read the seven configurations that a run uses, with `seed` in each.

    Raises:
        ConfigError: naming the file and key that is wrong.
    """

    def read(name: str, kind: type[C]) -> C:
        config = load(root / name, kind)
        if "seed" in kind.__struct_fields__:
            config = check(msgspec.structs.replace(config, seed=seed), source="--seed")
        return config

    return Plan(
        collect=read("collect/curl-ride.toml", CollectConfig),
        release=read("datasets/explore.toml", ReleaseConfig),
        encoder=read("train/encoder-curl.toml", EncoderTrainConfig),
        probe=read("train/probe.toml", ProbeConfig),
        policy=read("train/policy-goal-seeking.toml", PolicyTrainConfig),
        evaluate=read("evaluate/goal-seeking.toml", EvaluateConfig),
        viz=read("viz/default.toml", VizConfig),
    )


@dataclass
class Journal:
    """Runs the stages one by one and remembers what came of each."""

    console: Console
    rows: list[tuple[str, str, str, str]] = field(default_factory=list)
    made: int = 0

    def stage(self, name: str, work: Callable[[], Outcome]) -> Path:
        """Run one stage, or find it up to date."""
        started = time.perf_counter()
        outcome = work()
        seconds = time.perf_counter() - started
        self.made += outcome.made
        result = "made" if outcome.made else "up to date"
        self.rows.append((name, result, f"{seconds:.1f} s", artefacts.digest(outcome.path)[:12]))
        kept = f", the earlier one is now {markup(outcome.earlier.name)}" if outcome.earlier else ""
        self.console.print(f"[bold]{name:<27}[/] {result} ({seconds:.1f} s){kept}", highlight=False)
        return outcome.path


def run(root: Path, seed: int, console: Console) -> None:
    """Take the workspace at `root` through all stages with one root seed.

    Raises:
        UsageError: if `root` is no workspace or a configuration is wrong; nothing was started then.
        GymOpenError: if a stage fails; what earlier stages made stays.
    """
    workspace.check(root)
    plan = read_plan(root, seed)
    journal = Journal(console)
    started = time.perf_counter()
    log, release, encoder = _learn_without_task(plan, root, seed, journal)
    probe, policies, scores = _learn_the_task(plan, root, seed, encoder, journal)
    recording, figure = _look(plan, root, seed, [log, *policies, *scores.values()], journal)
    if not journal.made:
        console.print(f"[bold green]nothing to do:[/] all {len(journal.rows)} stages are up to date", highlight=False)
    for table in (stage_table(journal.rows), probe_table(probe), score_table(scores)):
        console.print(table)
    for name, path in scores.items():
        console.print(markup(proof_text(name, path)), highlight=False)
    console.print(f"({PAPER_NOTE})\ntotal {time.perf_counter() - started:.0f} s", highlight=False)
    console.print(f"\ncurves: {markup(short(figure / 'run.png'))}", highlight=False, soft_wrap=True)
    longer = root / "train/policy-strong.toml"
    for line in (
        f"rerun {word(recording / 'recording.rrd')}",
        f"gym-open viz {word(release)} --save release.rrd",
        f"gym-open train policy --config {word(longer)} --encoder {word(encoder)}",
        f"gym-open run --workspace {word(root)} --seed {seed + 1}",
    ):
        console.print(f"next: {markup(line)}", highlight=False, soft_wrap=True)


def _learn_without_task(plan: Plan, root: Path, seed: int, journal: Journal) -> tuple[Path, Path, Path]:
    from gym_open.collect.explore import collect
    from gym_open.datasets.build import build_release
    from gym_open.train.encoder import train_encoder

    log = journal.stage("collect", lambda: collect(plan.collect, root / f"collect/logs/curl-ride-seed{seed}"))
    named = msgspec.structs.replace(plan.release, name=f"{plan.release.name}-seed{seed}")
    folder = root / "datasets" / named.name / named.version
    release = journal.stage("dataset build", lambda: build_release(named, [log], folder, replace=True))
    encoder = journal.stage(
        "train encoder", lambda: train_encoder(plan.encoder, release, root / f"train/encoders/curl-seed{seed}")
    )
    return log, release, encoder


def _learn_the_task(
    plan: Plan, root: Path, seed: int, encoder: Path, journal: Journal
) -> tuple[Path, list[Path], dict[str, Path]]:
    from gym_open.evaluate.play import evaluate
    from gym_open.train.policy import train_policy
    from gym_open.train.probe import probe

    probed = journal.stage("train probe", lambda: probe(plan.probe, encoder, root / f"train/probes/curl-seed{seed}"))
    task = plan.policy.task
    policies: dict[str, Path | None] = {}
    for name, start in (("from encoder", encoder), ("from scratch", None)):
        folder = root / f"train/policies/{task}-{'curl' if start else 'scratch'}-seed{seed}"
        policies[f"PPO {name}"] = journal.stage(
            f"train policy {name}", lambda start=start, folder=folder: train_policy(plan.policy, start, folder)
        )
    policies["random"] = None
    scores = {}
    for name, policy in policies.items():
        folder = root / "evaluate/scores" / (policy.name if policy else f"{task}-random-seed{seed}")
        config = plan.evaluate if policy else msgspec.structs.replace(plan.evaluate, actions="sampled")
        scores[name] = journal.stage(
            f"evaluate {name}",
            lambda policy=policy, folder=folder, config=config: evaluate(config, policy, folder),
        )
    return probed, [policy for policy in policies.values() if policy], scores


def _look(plan: Plan, root: Path, seed: int, sources: list[Path], journal: Journal) -> tuple[Path, Path]:
    from gym_open.viz.figures import draw_run_figure
    from gym_open.viz.recording import visualize

    log, *others = sources

    def record(partial: Path) -> dict[str, str]:
        visualize(plan.viz, log, partial / "recording.rrd")
        return {}

    def draw(partial: Path) -> dict[str, str]:
        draw_run_figure(log, others, partial / "run.png")
        return {}

    def artefact(kind: str, parents: list[Path], work: Callable[[Path], dict[str, str]], folder: str) -> Outcome:
        return artefacts.build(root / folder, kind=kind, config=plan.viz, parents=parents, work=work)

    recording = journal.stage(
        "viz recording", lambda: artefact("recording", [log], record, f"viz/recordings/run-seed{seed}")
    )
    figure = journal.stage("viz figure", lambda: artefact("figure", sources, draw, f"viz/figures/run-seed{seed}"))
    return recording, figure
