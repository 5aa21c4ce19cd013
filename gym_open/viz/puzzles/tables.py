"""Scores of many agents as tables: what each earned in each puzzle, and which puzzles are hard."""

import shlex
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.sets import Split, locate, puzzles_of
from gym_open.envs.tasks import REWARDS, step_budget
from gym_open.formats.scores import EPISODES, Scores, read_episodes, read_scores
from gym_open.replay.episodes import puzzle_of
from gym_open.terminal import printable
from gym_open.viz.puzzles.names import agent_names

HARDEST = 10
"""Puzzles that are named as the hardest."""
_COMPARED = 3
"""Agents in a command that opens a puzzle: more are hard to look at."""


class Scored(msgspec.Struct, frozen=True, eq=False):
    """One agent's scores of P puzzles."""

    path: Path
    name: str
    """Printable, unlike that of every other agent."""
    record: Scores
    puzzles: list[str]
    """Ids (P)."""
    numbers: np.ndarray
    """(P,) their places in their set."""
    earned: np.ndarray
    """(P, N): return within 1…N actions."""
    a_success: np.ndarray
    """(P,)."""
    steps: np.ndarray
    """(P,) actions taken."""
    solved: np.ndarray
    """(P,) bool: whether all of the return was earned."""
    in_danger: np.ndarray
    """(P,) bool: whether the danger patch ended it."""

    def outcomes(self) -> list[str]:
        """How each puzzle ended, in words."""
        how = np.where(self.solved, "solved", np.where(self.in_danger, "in the danger patch", "not solved"))
        return [f"{one} in {n}, return {r:g}" for one, n, r in zip(how, self.steps, self.earned[:, -1], strict=True)]


class Table(msgspec.Struct, frozen=True, eq=False):
    """All agents that were scored on one set of one task."""

    task: Task
    split: Split
    agents: list[Scored]
    best: np.ndarray
    """(puzzles of the set,): the whole return of each."""
    hardest: list[str]
    """Ids of the puzzles that were played, those of the least mean A-Success first."""
    difficulty: list[float]
    """Their mean A-Success over the agents that played them."""

    @property
    def name(self) -> str:
        """Of the task, and of the set if that is not the test set."""
        return self.task if self.split == "test" else f"{self.task} {self.split}"

    @property
    def budget(self) -> int:
        """N actions."""
        return step_budget(self.task)


def read_tables(sources: Sequence[Path]) -> list[Table]:
    """Scores by the task and set that they are of, in the order of the sources.

    Raises:
        ArtefactError: if a source is damaged or no scores.
    """
    records = {source: read_scores(source) for source in sources}
    groups: dict[tuple[Task, Split], list[Path]] = {}
    for source, record in records.items():
        groups.setdefault((record.task, record.split), []).append(source)
    return [_table(*key, {source: records[source] for source in group}) for key, group in groups.items()]


def commands(group: Table) -> list[str]:
    """Command lines that open the hardest puzzles, played by the best agents."""
    best = sorted(group.agents, key=lambda agent: -agent.record.a_success)[:_COMPARED]
    paths = " ".join(shlex.quote(printable(str(agent.path))) for agent in best)
    return [f"gym-open viz {paths} --puzzle {item}" for item in group.hardest[:HARDEST]]


def _table(task: Task, split: Split, records: dict[Path, Scores]) -> Table:
    best = np.array([
        sum(REWARDS[task].get(item.kind, 0.0) for item in puzzle.objects) for puzzle in puzzles_of(task, split)
    ])  # fmt: skip
    names = agent_names(dict(records))
    agents = [_scored(source, names[source], record, best) for source, record in records.items()]
    found: dict[str, list[float]] = {}
    for agent in agents:
        for item, value in zip(agent.puzzles, agent.a_success.tolist(), strict=True):
            found.setdefault(item, []).append(value)
    means = {item: float(np.mean(values)) for item, values in found.items()}
    hardest = sorted(means, key=lambda item: (means[item], item))
    return Table(task, split, agents, best, hardest, [means[item] for item in hardest])


def _scored(source: Path, name: str, record: Scores, best: np.ndarray) -> Scored:
    rows = read_episodes(source)
    for row in rows:
        puzzle_of(source / EPISODES, record, row)
    rewards = np.zeros((len(rows), step_budget(record.task)))
    for own, row in zip(rewards, rows, strict=True):
        own[: row["steps"]] = row["rewards"]
    numbers = np.array([locate(row["puzzle"])[2] for row in rows], dtype=np.int64)
    earned = np.cumsum(rewards, axis=1)
    solved = earned[:, -1] >= best[numbers] - 1e-9
    terminated = np.array([row["terminated"] for row in rows], dtype=bool)
    return Scored(
        path=source, name=name, record=record, puzzles=[row["puzzle"] for row in rows], numbers=numbers, earned=earned,
        a_success=np.array([row["a_success"] for row in rows]), steps=np.array([row["steps"] for row in rows]),
        solved=solved, in_danger=terminated & ~solved,
    )  # fmt: skip
