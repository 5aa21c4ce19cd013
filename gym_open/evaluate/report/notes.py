"""What a reader must know before believing a report, told from the data: short sentences, only those that apply."""

from collections import Counter
from collections.abc import Iterator, Sequence

from gym_open.envs.puzzles.sets import PER_SET
from gym_open.evaluate.report.numbers import ReportCell, ReportNumbers, count, interval, number, signed, steps
from gym_open.evaluate.report.provenance import ProofGroup
from gym_open.results.names import is_trained, one_line, standing
from gym_open.results.paper import PAPER_STEPS
from gym_open.results.runs import ScoredRun
from gym_open.results.statistics import least_p_value

_FEW = 5
"""Runs below which comparisons of agents are hardly ever firm."""
_FEWEST = 3
"""Runs of either side below which nothing is said to be told apart: of two equal agents with one run each, the interval
of the difference missed 0 in 19 to 57% of simulated cases (puzzles spread .2, runs .02 to .06), with three in 3 to 11%.
"""


def findings(results: ReportNumbers) -> Iterator[str]:
    """Two sentences a task: who is best, and who differs from the reference beyond the interval of the difference."""
    for task in results.tasks:
        cells = [cell for cell in results.cells if cell.task == task]
        compared = [cell for cell in cells if standing(cell.agent) == 0]
        if not compared:
            continue
        best = max(compared, key=lambda cell: cell.score.value)
        others = ", ".join(
            f"{cell.agent} {number(cell.score.value)}"
            for cell in cells
            if (standing(cell.agent) or cell.agent == results.reference) and cell is not best
        )
        text = f"{task}: best is {best.agent} with {number(best.score.value)} {interval(best.score)}"
        yield text + (f"; {others}." if others else ".") + _gains(compared, results.reference)


def _gains(trained: Sequence[ReportCell], reference: str | None) -> str:
    compared = [(cell, cell.gain) for cell in trained if cell.gain is not None]
    if not compared or reference is None:
        return ""
    own = next((len(cell.seeds) for cell in trained if cell.agent == reference), 0)
    firm, loose = [], []
    for cell, gain in compared:
        if (gain.low or 0) > 0 or (gain.high or 0) < 0:
            enough = min(len(cell.seeds), own) >= _FEWEST
            (firm if enough else loose).append(f"{cell.agent} {signed(gain)}")
    if not firm and not loose:
        return f" No agent trained on pictures is told apart from {reference}: every interval of a difference holds 0."
    found = f" Told apart from {reference}: {', '.join(firm)}." if firm else ""
    if loose:
        found += (
            f" On these puzzles another than {reference}, but from fewer than {_FEWEST} seeds, which tells nothing of "
            f"another seed: {', '.join(loose)}."
        )
    return found


def notes(
    results: ReportNumbers, runs: Sequence[ScoredRun], proven: Sequence[ProofGroup], unchecked: Sequence[str]
) -> Iterator[str]:
    """Everything that weakens what the tables say; `unchecked` are agents whose configurations were not all seen."""
    yield from _on_runs(results)
    yield from _on_encoders(runs)
    yield from _on_comparisons(results)
    yield from _on_proofs(proven)
    yield from _on_makers(runs)
    if any(cell.paper for cell in results.cells):
        yield (
            "The paper's numbers come from its own simulator, another implementation of the same tasks, after "
            f"{PAPER_STEPS:,} steps; it does not say of what kind its ± is. Compare orders and gaps rather than digits."
        )
    if unchecked:
        yield (
            f"Whether the runs of {', '.join(unchecked)} differ in seeds alone could not be checked in full: some of "
            "their configurations are not at hand."
        )
    yield from results.left_behind


def _on_encoders(runs: Sequence[ScoredRun]) -> Iterator[str]:
    """Runs that share one encoder are no samples of what play is worth."""
    made: dict[tuple[str, str], dict[int | str, str]] = {}
    for run in runs:
        for policy in run.lineage.parents:
            for encoder in policy.lineage.parents:
                made.setdefault((run.name, run.record.task), {})[run.seed] = encoder.digest
    shared = {name for (name, _), encoders in made.items() if len(set(encoders.values())) < len(encoders)}
    if shared:
        yield (
            f"One play and one encoder for several seeds: {', '.join(sorted(shared))}. Their deviation and intervals "
            "are those of fine-tuning alone: another play, or another encoder of the same, may do better or worse."
        )


def _on_runs(results: ReportNumbers) -> Iterator[str]:
    trained = [cell for cell in results.cells if is_trained(cell.agent)]
    single = Counter(cell.agent for cell in trained if len(cell.seeds) == 1)
    if single:
        names = ", ".join(single)
        yield (
            f"One seed only on some task or all: {names}. There is no deviation then, and the interval is over puzzles "
            "alone: it says nothing of another training seed."
        )
    budgets = sorted({cell.trained for cell in trained})
    if len(budgets) > 1:
        listed = ", ".join(map(steps, budgets))
        yield f"Agents were trained for different lengths ({listed} steps): their scores differ for that reason, too."
    holes = [
        f"{agent} on {task}"
        for agent in results.agents
        for task in results.tasks
        if is_trained(agent) and results.cell(agent, task) is None
    ]
    if holes:
        yield f"Not scored: {', '.join(holes)}. Figures over tasks take the tasks that an agent has."


def _on_comparisons(results: ReportNumbers) -> Iterator[str]:
    runs = [len(cell.seeds) for cell in results.cells if is_trained(cell.agent) and len(cell.seeds) > 1]
    if len(runs) > 1 and min(runs) < _FEW:
        n = min(runs)
        yield (
            f"With {count(n, 'run')} a task and agent, even complete separation of two agents on one task has p = "
            f"{number(least_p_value(n, n), 2)} by Mann and Whitney's exact test. Bootstrap intervals of so few runs "
            "are too narrow."
        )
    ceilings = [agent for agent in results.agents if standing(agent) == 1]
    if ceilings:
        yield f"{', '.join(ceilings)} sees the simulator's state, no pictures: a ceiling, never called the best."
    if any(aggregate.runs < 4 for aggregate in results.aggregates):
        yield "Of fewer than four scores the interquartile mean cuts none: it is the mean of the scores then."


def _on_proofs(proven: Sequence[ProofGroup]) -> Iterator[str]:
    missing = [one for one in proven if one.verdict == "missing"]
    for agent in dict.fromkeys(one.agent for one in missing):
        yield f"Nothing certifies that the encoder of {agent} is task-free: see the proof below."
    for one in proven:
        if one.recorded:
            yield (
                f"Scores of {one.agent} say of themselves {', '.join(map(repr, one.recorded))}; walked again, their "
                f"records say {one.verdict!r}, which is what stands here."
            )


def _on_makers(runs: Sequence[ScoredRun]) -> Iterator[str]:
    codes = Counter(one_line(run.lineage.code) for run in runs)
    if len(codes) > 1:
        listed = ", ".join(f"{code} ({count(n, 'score')})" for code, n in sorted(codes.items()))
        yield f"Scored by {len(codes)} versions of the code: {listed}."
    seeds = {run.record.evaluation_seed for run in runs if is_trained(run.name)}
    if len(seeds) > 1:
        listed = ", ".join(sorted(map(str, seeds)))
        yield f"Policies' actions were drawn with different evaluation seeds ({listed})."
    short = sorted({run.name for run in runs if len(run.puzzles) < PER_SET})
    if short:
        yield f"Fewer than {PER_SET} puzzles were played by: {', '.join(short)}. Other rows are of more puzzles."
