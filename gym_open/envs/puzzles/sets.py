"""The fixed puzzles, per task 100 for testing and 100 for choosing models: files of the package, never for training."""

import functools
import hashlib
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Literal, get_args

import msgspec

from gym_open.envs.puzzles.puzzle import TASKS, Puzzle, PuzzleError, Task

Split = Literal["test", "validation"]
SPLITS: tuple[Split, ...] = get_args(Split)
PER_SET = 100
DIGESTS = "digests.json"


def puzzle_id(task: Task, split: Split, index: int) -> str:
    """Id of a fixed puzzle: "tool-use/017" in the test set, "tool-use/validation/017" in the validation set."""
    return f"{task}/{index:03d}" if split == "test" else f"{task}/{split}/{index:03d}"


def data_file(name: str) -> Traversable:
    """A file in the package's folder of puzzle sets."""
    return resources.files("gym_open.envs.puzzles") / "data" / name


def set_name(task: Task, split: Split) -> str:
    """File name of a set."""
    return f"{task}-{split}.jsonl"


@functools.cache
def puzzles_of(task: Task, split: Split) -> tuple[Puzzle, ...]:
    """The fixed puzzles of a task and split, in order; the i-th has the id `puzzle_id(task, split, i)`.

    Raises:
        PuzzleError: if there is no such set or its file is damaged.
    """
    if task not in TASKS or split not in SPLITS:
        known = f"tasks {', '.join(TASKS)}, splits {', '.join(SPLITS)}"
        raise PuzzleError(f"no {split} set for {task!r}; there are: {known}")
    name = set_name(task, split)
    lines = data_file(name).read_bytes().splitlines()
    if len(lines) != PER_SET:
        raise PuzzleError(f"puzzles/data/{name}: expected {PER_SET} lines, got {len(lines)}; reinstall gym-open")
    return tuple(Puzzle.from_json(line) for line in lines)


def test_puzzles(task: Task) -> tuple[Puzzle, ...]:
    """The 100 test puzzles of a task: `puzzles_of(task, "test")`."""
    return puzzles_of(task, "test")


test_puzzles.__test__ = False  # pyright: ignore[reportFunctionMemberAccess]  # pytest must not take it for a test


def locate(name: str) -> tuple[Task, Split, int]:
    """Task, split and index of an id.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
    """
    task, *middle, number = name.split("/") if "/" in name else (name, "")
    split = "/".join(middle) or "test"
    found = number.isascii() and number.isdecimal() and len(number) == 3 and int(number) < PER_SET
    if task in TASKS and split in SPLITS and found and not (middle and split == "test"):
        return task, split, int(number)
    forms = f"TASK/000 to TASK/{PER_SET - 1:03d} (test) or TASK/validation/000; TASK is one of {', '.join(TASKS)}"
    raise PuzzleError(f"no puzzle {name!r}; ids are {forms}")


def puzzle_by_id(name: str) -> Puzzle:
    """The fixed puzzle with this id, such as "tool-use/017" (test) or "tool-use/validation/017".

    Raises:
        PuzzleError: if no fixed puzzle has this id.
    """
    task, split, index = locate(name)
    return puzzles_of(task, split)[index]


@functools.cache
def reserved_digests() -> frozenset[str]:
    """Digests of all fixed layouts, of all tasks, test and validation."""
    return frozenset(puzzle.digest for task in TASKS for split in SPLITS for puzzle in puzzles_of(task, split))


def published_digests() -> dict[str, str]:
    """Published SHA-256 of every file of the sets."""
    return msgspec.json.decode(data_file(DIGESTS).read_bytes(), type=dict[str, str])


def actual_digests() -> dict[str, str]:
    """SHA-256 of every file of the sets in this installation; missing files are left out."""
    files = [data_file(name) for name in published_digests()]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.is_file()}
