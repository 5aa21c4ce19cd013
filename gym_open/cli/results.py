"""Sub-commands on results: the grid of many runs, reports, verification of scores, and publishing of encoders."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gym_open.cli.base import ArtefactCommand, Command, out, report, say, say_made, say_next
from gym_open.config import load
from gym_open.errors import UsageError
from gym_open.evaluate.config import ReportConfig
from gym_open.summary import short, word


@dataclass(frozen=True, kw_only=True)
class BenchmarkCommand(Command):
    """Train and score a grid of agents, tasks and seeds, and write a report; one job per core runs at a time.

    Jobs that are up to date are skipped. After an interruption, the same command continues.

    Example: gym-open benchmark evaluate/benchmark-small.toml --out evaluate/benchmarks/small
    """

    grid: Annotated[Path, tyro.conf.Positional]
    """TOML file with agents, tasks and seeds."""
    out: Path
    """Folder for all results: logs, releases, encoders, policies, scores, report."""
    workspace: Path = Path()
    """Folder with the configurations that the grid names."""
    jobs: int | None = None
    """Number of jobs at a time, each with one thread; default one per core."""

    about = "train and score a grid of agents, tasks and seeds"

    def run(self) -> None:
        """Run all jobs."""
        from gym_open.grid import run_grid
        from gym_open.grid.config import GridConfig

        grid = load(self.grid, GridConfig)
        made = run_grid(grid, self.out, root=self.workspace, jobs=self.jobs, console=out)
        say_made(made / "report.html")


@dataclass(frozen=True, kw_only=True)
class ReportCommand(ArtefactCommand):
    """Report all scores in some folders on one page: tables, intervals, curves, proofs, configurations.

    Example: gym-open report evaluate/scores --out evaluate/reports/first
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("evaluate/scores"),)
    """Folders with scores and probes, at any depth. The artefacts that trained the agents are found in the workspace of
    these folders."""
    out: Path = Path("evaluate/reports/report")
    """Folder for the page."""
    settings: Annotated[ReportConfig, tyro.conf.arg(name="")] = ReportConfig()  # noqa: RUF009  (frozen)
    """How intervals are computed, and with which agent the others are compared."""

    about = "report scores on one page, with intervals and proofs"

    def run(self) -> None:
        """Write the report."""
        from gym_open.evaluate.report import write_report

        made = write_report(self.settings, self.sources, self.out)
        report(made, f"open {word(made.path / 'report.html')} in a browser, or read {word(made.path / 'report.md')}")


@dataclass(frozen=True, kw_only=True)
class ScoreVerify(Command):
    """Replay scored episodes, and recompute all claims: rewards, scores, who played, and the task-free proof.

    The random agent's actions are drawn again, and the oracle's actions must be the witnesses. If the folder of the
    policy is given, the policy chooses its actions again. Without it, nothing proves that the policy chose them.

    Example: gym-open score verify evaluate/scores/policy-goal-seeking --policy train/policies/policy-goal-seeking

    Example: gym-open score verify evaluate/scores/policy-goal-seeking --puzzle goal-seeking/017
    """

    scores: Annotated[Path, tyro.conf.Positional]
    """Folder of scores."""
    puzzle: str | None = None
    """Only the episode of this puzzle, such as goal-seeking/017."""
    policy: Path | None = None
    """Folder of the scored policy, which then chooses its actions again."""

    about = "replay scored episodes and check the scores"

    def run(self) -> None:
        """Verify the scores, or one episode."""
        from gym_open.evaluate.verify import verify_scores
        from gym_open.replay.episodes import replay_puzzle

        if self.puzzle is None:
            record, chosen = verify_scores(self.scores, self.policy)
            say(f"{short(self.scores)}: {record.puzzles} episodes, A-Success {record.a_success:.3f}", verb="verified")
            say(f"  {chosen}")
            return
        if self.policy is not None:
            raise UsageError("score verify: --policy checks all puzzles; leave out --puzzle or --policy")
        found = replay_puzzle(self.scores, self.puzzle)
        end = "terminated" if found.terminated else "truncated"
        total = sum(found.rewards)
        say(f"{found.id}: {len(found.actions)} actions, return {total:g}, {end}", verb="verified")
        say_next(f"gym-open render video {found.id} --actions {word(self.scores)} --save episode.mp4")


@dataclass(frozen=True, kw_only=True)
class EncoderPush(Command):
    """Upload an encoder with a card and its lineage to a Hugging Face hub. Without --online, only print the plan.

    Example: gym-open encoder push train/encoders/encoder-curl --repo me/open-curl --online
    """

    encoder: Annotated[Path, tyro.conf.Positional]
    """Folder of an encoder."""
    repo: str
    """OWNER/NAME on the hub."""
    online: bool = False
    """Upload it."""

    about = "upload an encoder to a Hugging Face hub"

    def run(self) -> None:
        """Upload the encoder, or print what would be uploaded."""
        from gym_open.train.hub import push_encoder

        for line in push_encoder(self.encoder, self.repo, online=self.online):
            say(f"  {line}")
        if not self.online:
            say("nothing was uploaded; add --online to upload it")
