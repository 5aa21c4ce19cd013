"""Scores of many agents as tables: what each earned in each puzzle, and which puzzles are hard."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.sets import Split, locate, puzzles_of
from gym_open.envs.tasks import REWARDS, step_budget
from gym_open.results.names import distinct_names
from gym_open.results.runs import ScoredRun, read_run
from gym_open.terminal import printable

HARDEST = 10
"""Puzzles that are named as the hardest."""
_COMPARED = 3
"""Agents in a command that opens a puzzle: more would be hard to compare."""


class AgentOutcomes(msgspec.Struct, frozen=True, eq=False):
    """How one agent did in each of P puzzles."""

    path: Path
    name: str
    """Printable; no other agent of the table has it."""
    run: ScoredRun
    numbers: np.ndarray
    """Places of the puzzles in their set, shape (P,)."""
    solved: np.ndarray
    """Whether the agent earned all of the return, shape (P,), bool."""
    in_danger: np.ndarray
    """Whether the danger patch ended the episode, shape (P,), bool."""

    def outcomes(self) -> list[str]:
        """Return how each puzzle ended, in words."""
        how = np.where(self.solved, "solved", np.where(self.in_danger, "in the danger patch", "not solved"))
        ends = zip(how, self.run.steps, self.run.returns[:, -1], strict=True)
        return [f"{outcome} in {n}, return {total:g}" for outcome, n, total in ends]


class TaskTable(msgspec.Struct, frozen=True, eq=False):
    """All agents that were scored on one set of one task."""

    task: Task
    split: Split
    agents: list[AgentOutcomes]
    best: np.ndarray
    """The largest possible return of each puzzle, shape (puzzles of the set,)."""
    hardest: list[str]
    """Ids of the puzzles that were played, by rising mean A-Success."""
    difficulty: list[float]
    """Their mean A-Success over the agents that played them."""

    @property
    def name(self) -> str:
        """The task, and the set if it is not the test set."""
        return self.task if self.split == "test" else f"{self.task} {self.split}"

    @property
    def budget(self) -> int:
        """N actions."""
        return step_budget(self.task)


def read_tables(sources: Sequence[Path]) -> list[TaskTable]:
    """Read scores into one table per task and set, in the order of the sources.

    Raises:
        ArtefactError: if a source is damaged or holds no scores.
    """
    groups: dict[tuple[Task, Split], dict[Path, ScoredRun]] = {}
    for source in sources:
        run = read_run(source)
        groups.setdefault((run.record.task, run.record.split), {})[source] = run
    return [_table(*key, group) for key, group in groups.items()]


def commands(group: TaskTable) -> list[str]:
    """Return command lines that open the hardest puzzles, played by the best agents."""
    best = sorted(group.agents, key=lambda agent: -agent.run.record.a_success)[:_COMPARED]
    paths = " ".join(shlex.quote(printable(str(agent.path))) for agent in best)
    return [f"gym-open viz {paths} --puzzle {item}" for item in group.hardest[:HARDEST]]


def _table(task: Task, split: Split, runs: Mapping[Path, ScoredRun]) -> TaskTable:
    best = np.array([
        sum(REWARDS[task].get(item.kind, 0.0) for item in puzzle.objects) for puzzle in puzzles_of(task, split)
    ])  # fmt: skip
    names = distinct_names({source: run.record for source, run in runs.items()})
    found: dict[str, list[float]] = {}
    for run in runs.values():
        for item, value in zip(run.puzzles, run.values.tolist(), strict=True):
            found.setdefault(item, []).append(value)
    means = {item: float(np.mean(values)) for item, values in found.items()}
    hardest = sorted(means, key=lambda item: (means[item], item))
    agents = [_outcomes(source, names[source], run, best) for source, run in runs.items()]
    return TaskTable(task, split, agents, best, hardest, [means[item] for item in hardest])


def _outcomes(source: Path, name: str, run: ScoredRun, best: np.ndarray) -> AgentOutcomes:
    numbers = np.array([locate(puzzle)[2] for puzzle in run.puzzles], dtype=np.int64)
    solved = run.returns[:, -1] >= best[numbers] - 1e-9
    return AgentOutcomes(source, name, run, numbers, solved, in_danger=run.terminated & ~solved)
