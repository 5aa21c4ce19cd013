"""What the runs of an agent on a task say together: a row of a report and of a figure, with the same intervals."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from gym_open import seeding
from gym_open.envs.puzzles import TASKS
from gym_open.results import statistics
from gym_open.results.names import row_order
from gym_open.results.records import Estimate, IntervalCurve, check_steps, check_values
from gym_open.results.runs import ScoredRun


class Resampling(NamedTuple):
    """How intervals are drawn; the defaults are those of `gym-open report`."""

    seed: int = 0
    resamples: int = 2_000
    confidence: float = 0.95

    def generator(self, *names: str) -> np.random.Generator:
        """Return the generator of one interval: each has its own, so that another agent changes no interval."""
        return seeding.generator(self.seed, "report", *names)

    def estimate(self, value: float, draws: np.ndarray | None) -> Estimate:
        """Return a number with the interval of its draws (resamples,), if there are draws."""
        if draws is None:
            return Estimate(value)
        low, high = statistics.percentiles(draws, self.confidence)
        return Estimate(value, float(low), float(high))

    def of_puzzles(self, name: str, row: "AgentRow", x: Sequence[int], values: np.ndarray) -> IntervalCurve:
        """Return the mean over runs and puzzles of values (runs, puzzles, points), with intervals over both."""
        draws = statistics.two_level_bootstrap(values, self.generator(name, row.agent, row.task), self.resamples)
        low, high = statistics.percentiles(draws, self.confidence)
        return IntervalCurve(list(x), values.mean(axis=(0, 1)).tolist(), low.tolist(), high.tolist())


class AgentRow:
    """The runs of one agent on one task."""

    def __init__(self, agent: str, task: str, runs: Sequence[ScoredRun]) -> None:
        self.agent, self.task, self.runs = agent, task, runs
        self.trained = max(run.trained for run in runs)
        self.final = self.at(self.trained)
        self.seeds = [run.seed for run in self.final]

    def at(self, trained: int) -> list[ScoredRun]:
        """Return the runs at a training length, by seed."""
        return sorted((run for run in self.runs if run.trained == trained), key=lambda run: str(run.seed).zfill(20))

    def checkpoints(self) -> list[tuple[int, list[ScoredRun]]]:
        """Return the training lengths at which every run of the final score was scored, and these runs."""
        lengths = sorted({run.trained for run in self.runs})
        there = [(n, [run for run in self.at(n) if run.seed in self.seeds]) for n in lengths]
        return [(n, runs) for n, runs in there if len(runs) == len(self.seeds)]

    def left_behind(self) -> Iterator[str]:
        """Yield a line for each seed that has no score at the final length."""
        for seed in sorted({str(run.seed) for run in self.runs} - {str(seed) for seed in self.seeds}):
            last = max(run.trained for run in self.runs if str(run.seed) == seed)
            yield f"{self.agent}, {self.task}, seed {seed}: scored at {last:,}, not {self.trained:,} steps; left out."


def rows_of(runs: Sequence[ScoredRun]) -> list[AgentRow]:
    """Group runs of one split into rows: agents in `row_order`, and of each agent the tasks in their own order."""
    groups: dict[tuple[str, str], list[ScoredRun]] = {}
    for run in runs:
        groups.setdefault((run.name, run.record.task), []).append(run)
    ordered = sorted(groups, key=lambda key: (row_order(key[0]), TASKS.index(key[1])))
    return [AgentRow(*key, groups[key]) for key in ordered]


def values_of(runs: Sequence[ScoredRun]) -> np.ndarray:
    """Return A-Success of every puzzle, shape (runs, puzzles)."""
    return np.array([run.values for run in runs])


class RowSummary(msgspec.Struct, frozen=True, kw_only=True):
    """An agent on a task, over its runs at the largest training length."""

    agent: str
    task: str
    seeds: list[int | str]
    trained: int
    """That length, in steps."""
    score: Estimate
    """A-Success: mean over runs, interval over runs and puzzles."""
    deviation: float | None
    """Sample deviation of A-Success over runs; None for one run."""
    returns: IntervalCurve
    """Mean return against actions."""
    learning: IntervalCurve
    """A-Success against steps of fine-tuning: the checkpoints at which all of `seeds` were scored."""

    def __post_init__(self) -> None:
        check_steps([self.trained])
        check_values([] if self.deviation is None else [self.deviation])


def summarise_row(row: AgentRow, how: Resampling) -> RowSummary:
    """Compute the summary of a row."""
    values = values_of(row.final)
    score, deviation = statistics.mean_and_deviation(values.mean(axis=1))
    draws = statistics.two_level_bootstrap(values, how.generator("score", row.agent, row.task), how.resamples)
    returns = np.array([run.returns for run in row.final])
    lengths, runs = zip(*row.checkpoints(), strict=True)
    learning = np.stack([values_of(there) for there in runs], axis=-1)
    return RowSummary(
        agent=row.agent, task=row.task, seeds=row.seeds, trained=row.trained,
        score=how.estimate(score, draws), deviation=deviation,
        returns=how.of_puzzles("return", row, range(1, returns.shape[2] + 1), returns),
        learning=how.of_puzzles("learning", row, lengths, learning),
    )  # fmt: skip
