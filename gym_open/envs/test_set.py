"""The fixed test puzzles: 100 a task, data of the package, never drawn for training."""

import functools
from importlib import resources

from gym_open.envs.puzzles import TASKS, Puzzle, PuzzleError, Task

PER_TASK = 100


@functools.cache
def test_puzzles(task: Task) -> tuple[Puzzle, ...]:
    """The fixed test puzzles of a task, in order; the id of the i-th is `f"{task}/{i:03d}"`.

    Raises:
        PuzzleError: if the task has no test set or its file is damaged.
    """
    if task not in TASKS:
        raise PuzzleError(f"no test set for {task!r}; there is one for each of {', '.join(TASKS)}")
    file = resources.files("gym_open.envs") / "test_puzzles" / f"{task}.jsonl"
    lines = file.read_bytes().splitlines()
    if len(lines) != PER_TASK:
        raise PuzzleError(f"test_puzzles/{task}.jsonl: expected {PER_TASK} lines, got {len(lines)}; reinstall gym-open")
    return tuple(Puzzle.from_json(line) for line in lines)


test_puzzles.__test__ = False  # pyright: ignore[reportAttributeAccessIssue]  # not a test, whatever pytest thinks


@functools.cache
def reserved_digests() -> frozenset[str]:
    """Digests of all test layouts of all tasks."""
    return frozenset(puzzle.digest for task in TASKS for puzzle in test_puzzles(task))
