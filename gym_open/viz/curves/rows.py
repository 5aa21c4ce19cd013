"""What the runs of each agent say together: A-Success against steps, return against actions, with intervals."""

from collections.abc import Sequence

import msgspec
import numpy as np

from gym_open import seeding
from gym_open.envs.puzzles import TASKS
from gym_open.envs.puzzles.sets import PER_SET, locate
from gym_open.errors import ArtefactError
from gym_open.formats.statistics import mean_and_deviation, percentiles, two_level_bootstrap
from gym_open.viz.curves.sources import Report, Scored, check_steps, check_values

FIXED = ("random", "oracle", "human")
"""Agents that no training made."""
_RESAMPLES, _SEED = 2_000, 0
"""As a report's by default, so that it gives the same intervals."""


class Band(msgspec.Struct, frozen=True):
    """A curve and its 95% interval, point by point."""

    x: list[int]
    value: list[float]
    low: list[float]
    high: list[float]

    def __post_init__(self) -> None:
        if len({len(self.x), len(self.value), len(self.low), len(self.high)}) != 1 or not self.x:
            raise ValueError("as many of `x`, `value`, `low` and `high` expected, and at least one")
        check_steps(self.x)
        check_values([*self.value, *self.low, *self.high])


class Row(msgspec.Struct, frozen=True):
    """An agent on a task."""

    agent: str
    task: str
    """And the split, if it is not the one for tests."""
    runs: list[str]
    """What tells apart the runs at the largest training length."""
    trained: int
    """That length, in steps."""
    deviation: float | None
    """Of A-Success over those runs; None of one."""
    learning: Band
    """A-Success against steps of fine-tuning; at each, of the runs that were scored there."""
    returns: Band
    """Mean return within so many actions, of the runs at the largest training length."""
    single: dict[str, tuple[list[int], list[float]]]
    """A-Success against steps of each run."""


def rows_of(scored: Sequence[Scored]) -> list[Row]:
    """A row for each agent on each task, tasks in their own order, trained agents by name and then the others."""
    groups: dict[tuple[str, str], dict[int, dict[str, Scored]]] = {}
    for one in scored:
        lengths = groups.setdefault((_task(one), _agent(one)), {})
        lengths.setdefault(one.record.trained, {}).setdefault(one.run, one)
    return [_row(agent, task, groups[task, agent]) for task, agent in sorted(groups, key=_place)]


def _task(one: Scored) -> str:
    return one.record.task if one.record.split == "test" else f"{one.record.task}, {one.record.split}"


def _agent(one: Scored) -> str:
    """Its name, with what sets its scores apart from others of that name."""
    parts = [one.record.agent]
    if one.record.actions == "greedy":
        parts.append("greedy")
    if len(one.puzzles) < PER_SET:
        parts.append(f"puzzles {_ranges([locate(name)[2] for name in one.puzzles])}")
    return ", ".join(parts)


def _ranges(numbers: Sequence[int]) -> str:
    """Rising numbers as `000–004, 007`: two sets of them are never called the same."""
    begins = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    pairs = zip(begins, ends, strict=True)
    return ", ".join(f"{first:03d}" if first == last else f"{first:03d}–{last:03d}" for first, last in pairs)


def _place(key: tuple[str, str]) -> tuple[int, str, int, str]:
    task, agent = key
    return TASKS.index(task.partition(",")[0]), task, standing(agent), agent


def standing(agent: str) -> int:
    """0 for what was trained, more for what was not."""
    name = agent.partition(",")[0]
    return FIXED.index(name) + 1 if name in FIXED else 0


def _row(agent: str, task: str, lengths: dict[int, dict[str, Scored]]) -> Row:
    trained = max(lengths)
    final = lengths[trained]
    single: dict[str, tuple[list[int], list[float]]] = {}
    for steps in sorted(lengths):
        for run, one in lengths[steps].items():
            x, y = single.setdefault(run, ([], []))
            x.append(steps)
            y.append(float(one.values.mean()))
    points = [
        _interval(agent, task, "learning", [one.values for one in lengths[at].values()]) for at in sorted(lengths)
    ]
    returns = _interval(agent, task, "return", [one.returns for one in final.values()])
    _, deviation = mean_and_deviation([one.values.mean() for one in final.values()])
    return Row(
        agent, task, list(final), trained, deviation,
        learning=Band(sorted(lengths), *(np.ravel(part).tolist() for part in zip(*points, strict=True))),
        returns=Band(list(range(1, len(returns[0]) + 1)), *(part.tolist() for part in returns)),
        single=single,
    )  # fmt: skip


def _interval(agent: str, task: str, name: str, runs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean over runs and puzzles of values (puzzles, …), and its interval over both."""
    values = np.array(runs)
    rng = seeding.generator(_SEED, "report", name, agent, task)
    low, high = percentiles(two_level_bootstrap(values, rng, _RESAMPLES))
    return values.mean(axis=(0, 1)), low, high


class _Cell(msgspec.Struct, frozen=True):
    """What is asked of a cell of a report's table."""

    agent: str
    task: str
    seeds: list[int | str]
    trained: int
    deviation: float | None
    learning: Band
    returns: Band

    def __post_init__(self) -> None:
        check_steps([self.trained])
        check_values([] if self.deviation is None else [self.deviation])


def rows_of_report(report: Report) -> list[Row]:
    """The rows that a report's `table.json` holds.

    Raises:
        ArtefactError: if it is not as `gym-open report` writes it.
    """
    try:
        cells = msgspec.convert(report.table["results"]["cells"], list[_Cell])
    except (msgspec.ValidationError, KeyError, TypeError) as error:
        raise ArtefactError(
            f"{report.name}: table.json: not a report's table: {error}; make the report again"
        ) from None
    return [
        Row(
            cell.agent, cell.task, list(map(str, cell.seeds)), cell.trained, cell.deviation, cell.learning,
            cell.returns, {},
        )
        for cell in cells
    ]  # fmt: skip
