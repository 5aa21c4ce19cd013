"""Sub-commands on results: many runs at a time, reports of scores, scores played again, encoders handed on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gym_open.cli.base import Command, Making, out, report, say
from gym_open.config import load
from gym_open.errors import UsageError
from gym_open.evaluate.config import ReportConfig
from gym_open.summary import short, word


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Train and score a grid of agents, tasks and seeds, as many jobs side by side as there are cores, and report.

    What is up to date is skipped; after a kill, the same command goes on where it was.

    Example: gym-open benchmark evaluate/benchmark-small.toml --out evaluate/benchmarks/small
    """

    grid: Annotated[Path, tyro.conf.Positional]
    """TOML file with the agents, tasks and seeds."""
    out: Path
    """Folder for all that is made: logs, releases, encoders, policies, scores, report."""
    workspace: Path = Path()
    """Folder whose configurations the grid names."""
    jobs: int | None = None
    """Jobs side by side, of one thread each; default one for each core."""

    about = "a grid of agents, tasks and seeds, side by side"

    def run(self) -> None:
        """Run all."""
        from gym_open.grid import run_grid
        from gym_open.grid.config import GridConfig

        grid = load(self.grid, GridConfig)
        made = run_grid(grid, self.out, root=self.workspace, jobs=self.jobs, console=out)
        say(short(made / "report.html"), verb="made")


@dataclass(frozen=True, kw_only=True)
class Report(Making):
    """Put all scores below some folders on one page: tables, intervals, curves, proofs, configurations.

    Example: gym-open report evaluate/scores --out evaluate/reports/first
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("evaluate/scores"),)
    """Folders that hold scores, at any depth; probes below them are shown, too. What trained the agents is looked up in
    the workspace around them."""
    out: Path = Path("evaluate/reports/report")
    """Folder for the page."""
    settings: Annotated[ReportConfig, tyro.conf.arg(name="")] = ReportConfig()  # noqa: RUF009  (frozen)
    """How intervals are drawn, and what the agents are compared with."""

    about = "one page of scores, with intervals and proofs"

    def run(self) -> None:
        """Write it."""
        from gym_open.evaluate.report import write_report

        made = write_report(self.settings, self.sources, self.out)
        report(made, f"open {word(made.path / 'report.html')} in a browser, or read {word(made.path / 'report.md')}")


@dataclass(frozen=True, kw_only=True)
class ScoreVerify(Command):
    """Play again what was scored, and work out anew what it claims: rewards, scores, who played, the proof.

    The random agent's actions are drawn again, and the oracle's are the witnesses. A policy's are chosen again if its
    folder is given; without it, nothing shows that the policy chose them.

    Example: gym-open score verify evaluate/scores/policy-goal-seeking --policy train/policies/policy-goal-seeking

    Example: gym-open score verify evaluate/scores/policy-goal-seeking --puzzle goal-seeking/017
    """

    scores: Annotated[Path, tyro.conf.Positional]
    """Folder of scores."""
    puzzle: str | None = None
    """Only the episode on this puzzle, such as goal-seeking/017."""
    policy: Path | None = None
    """Folder of the policy that was scored: let it choose its actions again."""

    about = "play scored episodes again and check the scores"

    def run(self) -> None:
        """Verify."""
        from gym_open.evaluate.verify import verify_scores
        from gym_open.replay.episodes import replay_puzzle

        if self.puzzle is None:
            record, chosen = verify_scores(self.scores, self.policy)
            say(f"{short(self.scores)}: {record.puzzles} episodes, A-Success {record.a_success:.3f}", verb="verified")
            say(f"  {chosen}")
            return
        if self.policy is not None:
            raise UsageError("score verify: --policy chooses again in all puzzles; leave out --puzzle, or --policy")
        found = replay_puzzle(self.scores, self.puzzle)
        end = "done" if found.terminated else "out of actions"
        paid = sum(found.rewards)
        say(f"{found.id}: {len(found.actions)} actions, return {paid:g}, {end}", verb="verified")
        say(f"  next: gym-open render video {found.id} --actions {word(self.scores)} --save episode.mp4")


@dataclass(frozen=True, kw_only=True)
class EncoderPush(Command):
    """Send an encoder to a Hugging Face hub, with a card and its lineage. Without --online, only say what would be.

    Example: gym-open encoder push train/encoders/encoder-curl --repo me/open-curl --online
    """

    encoder: Annotated[Path, tyro.conf.Positional]
    """Folder of an encoder."""
    repo: str
    """OWNER/NAME on the hub."""
    online: bool = False
    """Really send it."""

    about = "send an encoder to a Hugging Face hub"

    def run(self) -> None:
        """Send, or say what would be sent."""
        from gym_open.train.hub import push_encoder

        for line in push_encoder(self.encoder, self.repo, online=self.online):
            say(f"  {line}")
        if not self.online:
            say("nothing was sent; add --online to send it")
