"""Findings of a report and reasons to doubt them, derived from the data: only sentences that apply."""

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
"""With fewer runs, comparisons of agents are rarely reliable."""
_FEWEST = 3
"""With fewer runs of either agent, no difference is called reliable.

In simulations of two equal agents (deviation .2 of puzzles, .02 to .06 of runs), the interval of the difference
excluded 0 in 19 to 57% of cases with one run each, and in 3 to 11% with three.
"""


def findings(results: ReportNumbers) -> Iterator[str]:
    """Yield a line per task: the best agent, and the agents that differ from the reference."""
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
        return f" No agent trained on images differs from {reference}: every interval of a difference includes 0."
    found = f" Different from {reference}: {', '.join(firm)}." if firm else ""
    if loose:
        found += (
            f" Different from {reference} on these puzzles, but with fewer than {_FEWEST} seeds, which says nothing "
            f"about other seeds: {', '.join(loose)}."
        )
    return found


def notes(
    results: ReportNumbers, runs: Sequence[ScoredRun], proven: Sequence[ProofGroup], unchecked: Sequence[str]
) -> Iterator[str]:
    """Yield everything that weakens the tables; `unchecked` are agents with missing configurations."""
    yield from _on_runs(results)
    yield from _on_encoders(runs)
    yield from _on_comparisons(results)
    yield from _on_proofs(proven)
    yield from _on_makers(runs)
    if any(cell.paper for cell in results.cells):
        yield (
            "The paper's numbers come from its own simulator, another implementation of the same tasks, after "
            f"{PAPER_STEPS:,} steps; the paper does not define its ±. Compare orders and gaps rather than digits."
        )
    if unchecked:
        yield (
            f"It could not be fully checked that the runs of {', '.join(unchecked)} differ only in seeds: some of "
            "their configurations were not found."
        )
    yield from results.left_behind


def _on_encoders(runs: Sequence[ScoredRun]) -> Iterator[str]:
    """Note agents whose runs share an encoder: they are no sample of exploration runs."""
    made: dict[tuple[str, str], dict[int | str, str]] = {}
    for run in runs:
        for policy in run.lineage.parents:
            for encoder in policy.lineage.parents:
                made.setdefault((run.name, run.record.task), {})[run.seed] = encoder.digest
    shared = {name for (name, _), encoders in made.items() if len(set(encoders.values())) < len(encoders)}
    if shared:
        yield (
            f"One exploration run and one encoder for several seeds: {', '.join(sorted(shared))}. Their deviation and "
            "intervals cover fine-tuning alone: another exploration run or encoder may do better or worse."
        )


def _on_runs(results: ReportNumbers) -> Iterator[str]:
    trained = [cell for cell in results.cells if is_trained(cell.agent)]
    single = Counter(cell.agent for cell in trained if len(cell.seeds) == 1)
    if single:
        names = ", ".join(single)
        yield (
            f"Only one seed on at least one task: {names}. Such a score has no deviation, and its interval is over "
            "puzzles alone: it says nothing about another training seed."
        )
    budgets = sorted({cell.trained for cell in trained})
    if len(budgets) > 1:
        listed = ", ".join(map(steps, budgets))
        yield f"Agents were trained for different lengths ({listed} steps), which also makes their scores differ."
    holes = [
        f"{agent} on {task}"
        for agent in results.agents
        for task in results.tasks
        if is_trained(agent) and results.cell(agent, task) is None
    ]
    if holes:
        yield f"Not scored: {', '.join(holes)}. Numbers over all tasks use only the tasks on which an agent was scored."


def _on_comparisons(results: ReportNumbers) -> Iterator[str]:
    runs = [len(cell.seeds) for cell in results.cells if is_trained(cell.agent) and len(cell.seeds) > 1]
    if len(runs) > 1 and min(runs) < _FEW:
        n = min(runs)
        yield (
            f"With {count(n, 'run')} per task and agent, even complete separation of two agents on one task has p = "
            f"{number(least_p_value(n, n), 2)} by Mann and Whitney's exact test. Bootstrap intervals of so few runs "
            "are too narrow."
        )
    ceilings = [agent for agent in results.agents if standing(agent) == 1]
    if ceilings:
        names = ", ".join(ceilings)
        yield f"{names} sees the simulator state instead of images: an upper bound, never called the best."
    if any(aggregate.runs < 4 for aggregate in results.aggregates):
        yield "The interquartile mean of fewer than four scores cuts none of them: it is their mean."


def _on_proofs(proven: Sequence[ProofGroup]) -> Iterator[str]:
    missing = [one for one in proven if one.verdict == "missing"]
    for agent in dict.fromkeys(one.agent for one in missing):
        yield f"Nothing proves that the encoder of {agent} is task-free: see the proof below."
    for one in proven:
        if one.recorded:
            yield (
                f"The verdict in scores of {one.agent} is {', '.join(map(repr, one.recorded))}; their lineage gives "
                f"{one.verdict!r}, which this report shows."
            )


def _on_makers(runs: Sequence[ScoredRun]) -> Iterator[str]:
    codes = Counter(one_line(run.lineage.code) for run in runs)
    if len(codes) > 1:
        listed = ", ".join(f"{code} ({count(n, 'score')})" for code, n in sorted(codes.items()))
        yield f"The scores were made by {len(codes)} versions of the code: {listed}."
    seeds = {run.record.evaluation_seed for run in runs if is_trained(run.name)}
    if len(seeds) > 1:
        listed = ", ".join(sorted(map(str, seeds)))
        yield f"Policies' actions were drawn with different evaluation seeds ({listed})."
    short = sorted({run.name for run in runs if len(run.puzzles) < PER_SET})
    if short:
        yield f"Fewer than {PER_SET} puzzles were played by: {', '.join(short)}. Other rows have more puzzles."
