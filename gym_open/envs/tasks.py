"""What each task pays for and when it ends (the paper's text)."""

import msgspec

from gym_open.envs.physics.model import kind_of
from gym_open.envs.puzzles import GOALS, Puzzle, PuzzleError, Task
from gym_open.envs.world import StepOutcome

_BUDGET: dict[Task, int] = {"goal-seeking": 100, "preferences": 100, "avoidance": 100, "tool-use": 200}
PAY: dict[Task, dict[str, float]] = {
    "sandbox": {},
    "goal-seeking": {"yellow": 1.0},
    "preferences": {"yellow": 0.2, "green": 0.8},
    "avoidance": {"yellow": 1.0},
    "tool-use": {"yellow": 1.0},
}
"""What the first touch of a goal of each kind is worth."""


class Verdict(msgspec.Struct, frozen=True):
    """What a step was worth and whether it ended the episode."""

    reward: float
    terminated: bool


def step_budget(task: Task) -> int:
    """Steps after which an episode is truncated: N of the paper's score.

    Raises:
        PuzzleError: for the sandbox, which never ends.
    """
    if task not in _BUDGET:
        raise PuzzleError(f"{task!r} has no step budget; the tasks that have one are {', '.join(_BUDGET)}")
    return _BUDGET[task]


def rewarded(task: Task) -> bool:
    """Whether the task pays rewards, and so whether a goal shows that it was hit."""
    return task != "sandbox"


def judge(task: Task, puzzle: Puzzle, already_hit: int, outcome: StepOutcome) -> Verdict:
    """Judge a step.

    Args:
        task: what is asked for.
        puzzle: where.
        already_hit: goals hit before this step.
        outcome: what happened in it.
    """
    if task == "sandbox":
        return Verdict(0.0, terminated=False)
    if task == "avoidance" and outcome.in_danger:
        return Verdict(0.0, terminated=True)
    goals = sum(item.kind in GOALS for item in puzzle.objects)
    reward = sum((PAY[task].get(kind_of(name), 0.0) for name in outcome.hits), 0.0)
    return Verdict(reward, terminated=already_hit + len(outcome.hits) == goals)
