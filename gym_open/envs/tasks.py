"""The rewards of each task, and the end of an episode, after the paper's text."""

import msgspec

from gym_open.envs.physics.model import kind_of
from gym_open.envs.puzzles import GOALS, Puzzle, PuzzleError, Task
from gym_open.envs.world import StepOutcome

_BUDGET: dict[Task, int] = {"goal-seeking": 100, "preferences": 100, "avoidance": 100, "tool-use": 200}
REWARDS: dict[Task, dict[str, float]] = {
    "sandbox": {},
    "goal-seeking": {"yellow": 1.0},
    "preferences": {"yellow": 0.2, "green": 0.8},
    "avoidance": {"yellow": 1.0},
    "tool-use": {"yellow": 1.0},
}
"""Reward for the first touch of a goal of each kind."""


class TaskOutcome(msgspec.Struct, frozen=True):
    """The reward of a step, and whether it terminated the episode."""

    reward: float
    terminated: bool


def step_budget(task: Task) -> int:
    """Number of steps after which an episode is truncated: N in the paper's score.

    Raises:
        PuzzleError: if the task is the sandbox, which never ends.
    """
    if task not in _BUDGET:
        raise PuzzleError(f"{task!r} has no step budget; the tasks with a step budget are {', '.join(_BUDGET)}")
    return _BUDGET[task]


def rewarded(task: Task) -> bool:
    """Whether the task has rewards. If so, goals change colour when they are hit."""
    return task != "sandbox"


def judge(task: Task, puzzle: Puzzle, already_hit: int, outcome: StepOutcome) -> TaskOutcome:
    """Compute the reward of a step, and whether it terminates the episode.

    Args:
        task: the task whose rewards count.
        puzzle: the puzzle of the episode.
        already_hit: number of goals hit before this step.
        outcome: the events during the step.
    """
    if task == "sandbox":
        return TaskOutcome(0.0, terminated=False)
    if task == "avoidance" and outcome.in_danger:
        return TaskOutcome(0.0, terminated=True)
    goals = sum(item.kind in GOALS for item in puzzle.objects)
    reward = sum((REWARDS[task].get(kind_of(name), 0.0) for name in outcome.hits), 0.0)
    return TaskOutcome(reward, terminated=already_hit + len(outcome.hits) == goals)
