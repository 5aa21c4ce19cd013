"""From single runs to what a report says of agents: all its numbers, as plain records (`table.json` holds them)."""

import statistics as plain
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from gym_open import seeding
from gym_open.envs.puzzles import TASKS
from gym_open.errors import UsageError
from gym_open.evaluate.config import ReportConfig
from gym_open.evaluate.paper import PAPER, PaperScore, paper_name
from gym_open.evaluate.report.gather import Run, is_trained, standing
from gym_open.formats import statistics


class Estimate(msgspec.Struct, frozen=True):
    """A number and its interval; None where a single run allows none."""

    value: float
    low: float | None = None
    high: float | None = None


class Band(msgspec.Struct, frozen=True):
    """A curve and its interval, point by point."""

    x: list[int]
    value: list[float]
    low: list[float]
    high: list[float]


class Crossing(msgspec.Struct, frozen=True):
    """When A-Success first reached a threshold in fine-tuning."""

    threshold: float
    steps: list[float | None]
    """A run each, in the order of `seeds`; None: not reached. The first checkpoint's steps are a bound from above."""
    median: float | None
    """Over runs; None if half of them or more never got there."""


class Cell(msgspec.Struct, frozen=True):
    """An agent on a task: its runs at their largest common training length."""

    agent: str
    task: str
    seeds: list[int | str]
    trained: int
    per_run: list[float]
    """A-Success, in the order of `seeds`."""
    score: Estimate
    """A-Success: mean over runs, interval over runs and puzzles."""
    deviation: float | None
    """Sample deviation over runs."""
    mean_return: float
    mean_steps: float
    gain: Estimate | None
    """A-Success minus the reference's, on the same puzzles."""
    paper: PaperScore | None
    returns: Band
    """Mean return against actions."""
    learning: Band
    """A-Success against fine-tuning steps: the checkpoints at which all of `seeds` were scored."""
    crossings: list[Crossing]


class Aggregate(msgspec.Struct, frozen=True):
    """An agent over tasks."""

    agent: str
    tasks: list[str]
    runs: int
    iqm: Estimate
    mean: Estimate
    median: Estimate
    gap: Estimate


class Improvement(msgspec.Struct, frozen=True):
    """Probability that a run of one agent scores higher than a run of another."""

    agent: str
    other: str
    tasks: list[str]
    probability: Estimate


class Results(msgspec.Struct, frozen=True):
    """All numbers of a report."""

    agents: list[str]
    """In the order of the rows."""
    tasks: list[str]
    reference: str | None
    cells: list[Cell]
    aggregates: list[Aggregate]
    improvements: list[Improvement]
    left_behind: list[str]
    """Runs without a score at their row's training length."""

    def cell(self, agent: str, task: str) -> Cell | None:
        """The agent's cell on the task, if it was scored there."""
        return next((cell for cell in self.cells if (cell.agent, cell.task) == (agent, task)), None)


def evaluate_runs(runs: Sequence[Run], config: ReportConfig) -> Results:
    """Compute everything; each interval has a generator of its own, so that one more agent changes no other's."""
    agents = sorted({run.name for run in runs}, key=_place)
    tasks = [task for task in TASKS if any(run.record.task == task for run in runs)]
    reference = _reference(agents, config)
    rows = {(a, t): _Row(a, t, [r for r in runs if (r.name, r.record.task) == (a, t)]) for a in agents for t in tasks}
    rows = {key: row for key, row in rows.items() if row.final}
    cells = [_cell(row, rows.get((reference or "", row.task)), config) for row in rows.values()]
    per_run = {(cell.agent, cell.task): np.array(cell.per_run) for cell in cells}
    learners = [agent for agent in agents if is_trained(agent) or agent == "random"]
    return Results(
        agents=agents,
        tasks=list(tasks),
        reference=reference,
        cells=cells,
        aggregates=[_aggregate(agent, _strata(per_run, agent), config) for agent in agents],
        improvements=list(_improvements(learners, per_run, config)),
        left_behind=[line for row in rows.values() for line in row.left_behind()],
    )


def _place(agent: str) -> tuple[int, int, str]:
    """Trained agents as the paper orders them, others by name; then what sees the state, random, oracle, human."""
    paper = paper_name(agent)
    return standing(agent), list(PAPER).index(paper) if paper else len(PAPER), agent


def _reference(agents: Sequence[str], config: ReportConfig) -> str | None:
    if config.reference:
        if config.reference not in agents:
            raise UsageError(f"key `reference`: no scores of {config.reference!r}; there are {', '.join(agents)}")
        return config.reference
    return next((agent for agent in agents if paper_name(agent) == "PPO (From scratch)"), None)


class _Row:
    """The runs of one agent on one task."""

    def __init__(self, agent: str, task: str, runs: Sequence[Run]) -> None:
        self.agent, self.task, self.runs = agent, task, runs
        self.trained = max((run.trained for run in runs), default=0)
        self.final = self.at(self.trained)
        self.seeds = [run.seed for run in self.final]

    def at(self, trained: int) -> list[Run]:
        """Runs at a training length, by seed."""
        return sorted((run for run in self.runs if run.trained == trained), key=lambda run: str(run.seed).zfill(20))

    def checkpoints(self) -> list[tuple[int, list[Run]]]:
        """Training lengths at which every run of the final score was scored, and the runs there."""
        lengths = sorted({run.trained for run in self.runs})
        there = [(n, [run for run in self.at(n) if run.seed in self.seeds]) for n in lengths]
        return [(n, runs) for n, runs in there if len(runs) == len(self.seeds)]

    def left_behind(self) -> Iterator[str]:
        """A line for each seed that has no score at the final length."""
        for seed in sorted({str(run.seed) for run in self.runs} - {str(seed) for seed in self.seeds}):
            last = max(run.trained for run in self.runs if str(run.seed) == seed)
            yield f"{self.agent}, {self.task}, seed {seed}: scored at {last:,}, not {self.trained:,} steps; left out."


def _values(runs: Sequence[Run]) -> np.ndarray:
    """A-Success of every puzzle, shape (runs, puzzles)."""
    return np.array([run.values for run in runs])


def _cell(row: _Row, reference: _Row | None, config: ReportConfig) -> Cell:
    values = _values(row.final)
    per_run = values.mean(axis=1)
    value, deviation = statistics.mean_and_deviation(per_run)
    draws = statistics.two_level_bootstrap(values, _rng(config, "score", row.agent, row.task), config.resamples)
    printed = paper_name(row.agent)
    return Cell(
        agent=row.agent,
        task=row.task,
        seeds=row.seeds,
        trained=row.trained,
        per_run=per_run.tolist(),
        score=_estimate(value, draws, config),
        deviation=deviation,
        mean_return=float(np.mean([run.returns[:, -1].mean() for run in row.final])),
        mean_steps=float(np.mean([run.record.mean_steps for run in row.final])),
        gain=_gain(row, values, reference, config),
        paper=PAPER[printed][row.task] if printed else None,  # pyright: ignore[reportArgumentType]
        returns=_returns(row, config),
        learning=_learning(row, config),
        crossings=[_crossing(row, threshold) for threshold in config.thresholds],
    )


def _gain(row: _Row, values: np.ndarray, reference: _Row | None, config: ReportConfig) -> Estimate | None:
    if reference is None or reference.agent == row.agent or reference.final[0].puzzles != row.final[0].puzzles:
        return None
    others = _values(reference.final)
    rng = _rng(config, "gain", row.agent, reference.agent, row.task)
    draws = statistics.difference_bootstrap(values, others, rng, config.resamples)
    return _estimate(float(values.mean() - others.mean()), draws, config)


def _returns(row: _Row, config: ReportConfig) -> Band:
    curves = np.array([run.returns for run in row.final])
    draws = statistics.two_level_bootstrap(curves, _rng(config, "return", row.agent, row.task), config.resamples)
    return _band(range(1, curves.shape[2] + 1), curves.mean(axis=(0, 1)), draws, config)


def _learning(row: _Row, config: ReportConfig) -> Band:
    lengths, runs = zip(*row.checkpoints(), strict=True)
    values = np.stack([_values(there) for there in runs], axis=-1)
    draws = statistics.two_level_bootstrap(values, _rng(config, "learning", row.agent, row.task), config.resamples)
    return _band(lengths, values.mean(axis=(0, 1)), draws, config)


def _crossing(row: _Row, threshold: float) -> Crossing:
    scores = {n: [run.record.a_success for run in runs] for n, runs in row.checkpoints()}
    found = [
        statistics.first_reached(threshold, list(scores), [own[i] for own in scores.values()])
        for i in range(len(row.seeds))
    ]
    middle = plain.median([np.inf if steps is None else steps for steps in found])
    return Crossing(threshold=threshold, steps=found, median=middle if np.isfinite(middle) else None)


def _strata(per_run: dict[tuple[str, str], np.ndarray], agent: str) -> dict[str, np.ndarray]:
    return {task: scores for (name, task), scores in per_run.items() if name == agent}


def _aggregate(agent: str, strata: dict[str, np.ndarray], config: ReportConfig) -> Aggregate:
    own = list(strata.values())

    def estimate(name: str, statistic: statistics.Statistic) -> Estimate:
        value = float(statistic(own))
        if min(map(len, own)) < 2:
            return Estimate(value)
        rng = _rng(config, name, agent)
        return _estimate(value, statistics.stratified_bootstrap(own, statistic, rng, config.resamples), config)

    return Aggregate(
        agent=agent,
        tasks=list(strata),
        runs=sum(map(len, own)),
        iqm=estimate("iqm", statistics.interquartile_mean),
        mean=estimate("mean", statistics.mean),
        median=estimate("median", statistics.median),
        gap=estimate("gap", statistics.optimality_gap),
    )


def _improvements(
    agents: Sequence[str], per_run: dict[tuple[str, str], np.ndarray], config: ReportConfig
) -> Iterator[Improvement]:
    for agent in agents:
        for other in agents:
            ours, theirs = _strata(per_run, agent), _strata(per_run, other)
            tasks = [task for task in ours if task in theirs]
            if agent == other or not tasks:
                continue
            both = [ours[task] for task in tasks] + [theirs[task] for task in tasks]

            def statistic(strata: statistics.Strata, n: int = len(tasks)) -> np.ndarray:
                return statistics.probability_of_improvement(strata[:n], strata[n:])

            value = float(statistic(both))
            draws = None
            if min(map(len, both)) > 1:
                rng = _rng(config, "improvement", agent, other)
                draws = statistics.stratified_bootstrap(both, statistic, rng, config.resamples)
            yield Improvement(agent, other, tasks, _estimate(value, draws, config))


def _rng(config: ReportConfig, *names: str) -> np.random.Generator:
    return seeding.generator(config.seed, "report", *names)


def _estimate(value: float, draws: np.ndarray | None, config: ReportConfig) -> Estimate:
    if draws is None:
        return Estimate(value)
    low, high = statistics.percentiles(draws, config.confidence)
    return Estimate(value, float(low), float(high))


def _band(x: Sequence[int], value: np.ndarray, draws: np.ndarray, config: ReportConfig) -> Band:
    low, high = statistics.percentiles(draws, config.confidence)
    return Band(x=list(x), value=value.tolist(), low=low.tolist(), high=high.tolist())
