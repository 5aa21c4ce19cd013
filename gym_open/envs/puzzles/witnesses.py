"""Witnesses: for each fixed puzzle, a sequence of actions that solves it. They are files of the package."""

import functools
from collections.abc import Iterable

import msgspec

from gym_open.envs.puzzles.puzzle import PuzzleError, Task
from gym_open.envs.puzzles.sets import Split, data_file, locate, puzzle_id, puzzles_of


class Witness(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Proof that a puzzle can be solved."""

    puzzle: str
    """The puzzle's id."""
    digest: str
    """Digest of the puzzle's layout."""
    actions: tuple[int, ...]
    """Actions that earn the whole return; the last one terminates the episode."""


def witness_name(task: Task, split: Split) -> str:
    """File name of a set's witnesses."""
    return f"{task}-{split}.witnesses.jsonl"


def witness_bytes(task: Task, split: Split, sequences: Iterable[tuple[int, ...]]) -> bytes:
    """Contents of the file of a set's witnesses: one per line, in the order of the puzzles."""
    puzzles = puzzles_of(task, split)
    witnesses = [
        Witness(puzzle_id(task, split, i), puzzle.digest, actions)
        for i, (puzzle, actions) in enumerate(zip(puzzles, sequences, strict=True))
    ]
    return b"".join(msgspec.json.encode(witness) + b"\n" for witness in witnesses)


@functools.cache
def witnesses_of(task: Task, split: Split) -> tuple[Witness, ...]:
    """The witnesses of a task and split, in the order of `puzzles_of`.

    Raises:
        PuzzleError: if there is no such set, or its file is damaged or is for other puzzles.
    """
    puzzles, name = puzzles_of(task, split), witness_name(task, split)
    try:
        witnesses = [msgspec.json.decode(line, type=Witness) for line in data_file(name).read_bytes().splitlines()]
    except (FileNotFoundError, msgspec.DecodeError) as error:
        raise PuzzleError(f"puzzles/data/{name}: {error}; reinstall gym-open") from None
    expected = [(puzzle_id(task, split, i), puzzle.digest) for i, puzzle in enumerate(puzzles)]
    if [(witness.puzzle, witness.digest) for witness in witnesses] != expected:
        raise PuzzleError(f"puzzles/data/{name}: ids or digests differ from those of the puzzles; reinstall gym-open")
    return tuple(witnesses)


def witness_of(name: str) -> Witness:
    """The witness of the fixed puzzle with this id.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
    """
    task, split, index = locate(name)
    return witnesses_of(task, split)[index]
