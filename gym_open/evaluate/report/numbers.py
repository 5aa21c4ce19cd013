"""All numbers of a report, as plain records (`table.json` holds them), and how they are written."""

import statistics as plain
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from gym_open.envs.puzzles import TASKS
from gym_open.errors import UsageError
from gym_open.evaluate.config import ReportConfig
from gym_open.results import statistics
from gym_open.results.names import is_trained, row_order
from gym_open.results.paper import PAPER, PaperScore, paper_name
from gym_open.results.records import Estimate
from gym_open.results.rows import AgentRow, Resampling, RowSummary, rows_of, summarise_row, values_of
from gym_open.results.runs import ScoredRun


class Crossing(msgspec.Struct, frozen=True):
    """When A-Success first reached a threshold in fine-tuning."""

    threshold: float
    steps: list[float | None]
    """Per run, in the order of `seeds`; None: not reached. The steps of the first checkpoint are an upper bound."""
    median: float | None
    """Over runs; None if half of them or more never reached it."""


class ReportCell(RowSummary, frozen=True, kw_only=True):
    """An agent on a task, as the tables of a report show it."""

    per_run: list[float]
    """A-Success, in the order of `seeds`."""
    mean_return: float
    mean_steps: float
    gain: Estimate | None
    """A-Success minus that of the reference, on the same puzzles."""
    paper: PaperScore | None
    crossings: list[Crossing]


class Aggregate(msgspec.Struct, frozen=True):
    """An agent over all tasks."""

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


class ReportNumbers(msgspec.Struct, frozen=True):
    """All numbers of a report."""

    agents: list[str]
    """In the order of the rows."""
    tasks: list[str]
    reference: str | None
    cells: list[ReportCell]
    aggregates: list[Aggregate]
    improvements: list[Improvement]
    left_behind: list[str]
    """Runs without a score at the training length of their row."""

    def cell(self, agent: str, task: str) -> ReportCell | None:
        """Return the agent's cell on the task, if the agent was scored there."""
        return next((cell for cell in self.cells if (cell.agent, cell.task) == (agent, task)), None)


def evaluate_runs(runs: Sequence[ScoredRun], config: ReportConfig) -> ReportNumbers:
    """Compute all numbers; each interval has its own generator, so that another agent changes no interval."""
    how = Resampling(config.seed, config.resamples, config.confidence)
    rows = {(row.agent, row.task): row for row in rows_of(runs)}
    agents = sorted({agent for agent, _ in rows}, key=row_order)
    reference = _reference(agents, config)
    cells = [_cell(row, rows.get((reference or "", row.task)), config, how) for row in rows.values()]
    per_run = {(cell.agent, cell.task): np.array(cell.per_run) for cell in cells}
    learners = [agent for agent in agents if is_trained(agent) or agent == "random"]
    return ReportNumbers(
        agents=agents,
        tasks=[task for task in TASKS if any(row.task == task for row in rows.values())],
        reference=reference,
        cells=cells,
        aggregates=[_aggregate(agent, _strata(per_run, agent), how) for agent in agents],
        improvements=list(_improvements(learners, per_run, how)),
        left_behind=[line for row in rows.values() for line in row.left_behind()],
    )


def _reference(agents: Sequence[str], config: ReportConfig) -> str | None:
    if config.reference:
        if config.reference not in agents:
            raise UsageError(f"key `reference`: no scores of {config.reference!r}; there are {', '.join(agents)}")
        return config.reference
    return next((agent for agent in agents if paper_name(agent) == "PPO (From scratch)"), None)


def _cell(row: AgentRow, reference: AgentRow | None, config: ReportConfig, how: Resampling) -> ReportCell:
    summary, values = summarise_row(row, how), values_of(row.final)
    printed = paper_name(row.agent)
    return ReportCell(
        **msgspec.structs.asdict(summary),
        per_run=values.mean(axis=1).tolist(),
        mean_return=float(np.mean([run.returns[:, -1].mean() for run in row.final])),
        mean_steps=float(np.mean([run.record.mean_steps for run in row.final])),
        gain=_gain(row, values, reference, how),
        paper=PAPER[printed][row.task] if printed else None,  # pyright: ignore[reportArgumentType]
        crossings=[_crossing(row, threshold) for threshold in config.thresholds],
    )


def _gain(row: AgentRow, values: np.ndarray, reference: AgentRow | None, how: Resampling) -> Estimate | None:
    if reference is None or reference.agent == row.agent or reference.final[0].puzzles != row.final[0].puzzles:
        return None
    others = values_of(reference.final)
    rng = how.generator("gain", row.agent, reference.agent, row.task)
    draws = statistics.difference_bootstrap(values, others, rng, how.resamples)
    return how.estimate(float(values.mean() - others.mean()), draws)


def _crossing(row: AgentRow, threshold: float) -> Crossing:
    scores = {n: [run.record.a_success for run in runs] for n, runs in row.checkpoints()}
    found = [
        statistics.first_reached(threshold, list(scores), [own[i] for own in scores.values()])
        for i in range(len(row.seeds))
    ]
    middle = plain.median([np.inf if steps is None else steps for steps in found])
    return Crossing(threshold=threshold, steps=found, median=middle if np.isfinite(middle) else None)


def _strata(per_run: dict[tuple[str, str], np.ndarray], agent: str) -> dict[str, np.ndarray]:
    return {task: scores for (name, task), scores in per_run.items() if name == agent}


def _aggregate(agent: str, strata: dict[str, np.ndarray], how: Resampling) -> Aggregate:
    own = list(strata.values())

    def estimate(name: str, statistic: statistics.Statistic) -> Estimate:
        value = float(statistic(own))
        if min(map(len, own)) < 2:
            return Estimate(value)
        rng = how.generator(name, agent)
        return how.estimate(value, statistics.stratified_bootstrap(own, statistic, rng, how.resamples))

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
    agents: Sequence[str], per_run: dict[tuple[str, str], np.ndarray], how: Resampling
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
                rng = how.generator("improvement", agent, other)
                draws = statistics.stratified_bootstrap(both, statistic, rng, how.resamples)
            yield Improvement(agent, other, tasks, how.estimate(value, draws))


def number(value: float, digits: int = 3) -> str:
    """Format as `.532`, `1.000` or `−.012`: no zero before the point, as in the tables of papers."""
    text = f"{abs(value):.{digits}f}".removeprefix("0" if digits else "")
    return f"−{text}" if value < 0 and text.strip(".0") else text


def interval(estimate: Estimate, digits: int = 2) -> str:
    """Format as `[.50, .56]`; an empty text if there is no interval."""
    if estimate.low is None or estimate.high is None:
        return ""
    return f"[{number(estimate.low, digits)}, {number(estimate.high, digits)}]"


def signed(estimate: Estimate) -> str:
    """Format as `+.023 [−.011, .054]`."""
    value = number(estimate.value)
    sign = "" if value.startswith("−") else "+"
    return f"{sign}{value} {interval(estimate, 3)}".rstrip()


def steps(value: float | None) -> str:
    """Format as `200K`, `1.05M` or `0`."""
    if value is None:
        return "not reached"
    if value < 1000:
        return f"{value:.0f}"
    scaled, unit = (value / 1e6, "M") if value >= 999_500 else (value / 1e3, "K")
    return f"{scaled:.3g}{unit}"


def count(n: int, noun: str) -> str:
    """Format as `1 run` or `3 runs`."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"
