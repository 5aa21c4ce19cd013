"""Episodes of scores, played again by the id of their puzzle.

The recorded actions are taken in a fresh world, and each must be paid what was recorded. A machine of another type may
round otherwise, and contacts let that grow: there, a difference is no proof of a forgery.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError
from gym_open.formats.scores import EPISODES, Scores, read_episodes, read_scores

_ELSE = "the scores are forged, or were made on another type of machine or with other packages; evaluate again"
See = Callable[[OpenEnv, np.ndarray, dict[str, Any]], None]
"""Takes the environment as it is now, its observation (84, 84, 3) uint8, and its info."""


class Replay(msgspec.Struct, frozen=True):
    """An episode that came out again as it was recorded."""

    id: str
    """Of the puzzle, such as `tool-use/017`."""
    puzzle: Puzzle
    actions: list[int]
    rewards: list[float]
    """Of each action."""
    terminated: bool
    """Whether the task ended it, or its budget did."""


def replay_puzzle(scores: Path, puzzle: str, see: See | None = None) -> Replay:
    """Play again what was played on one puzzle.

    Args:
        scores: a scores artefact, of a policy, the random agent, the oracle or a person.
        puzzle: its id, such as `tool-use/017` or `tool-use/validation/017`.
        see: is shown the beginning and every step.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if the scores are damaged, do not hold the puzzle, or part from what happens: names the step.
    """
    row = scored_row(scores, puzzle)
    return play_again(scores / EPISODES, puzzle_of(scores / EPISODES, read_scores(scores), row), row, see)


def scored_row(scores: Path, puzzle: str) -> dict[str, Any]:
    """What was recorded of one puzzle: a row of `read_episodes`.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if the scores are damaged, or do not hold the puzzle.
    """
    puzzle_by_id(puzzle)
    artefacts.verify(scores, "scores")
    rows = read_episodes(scores)
    for row in rows:
        if row["puzzle"] == puzzle:
            return row
    held = f"{rows[0]['puzzle']} to {rows[-1]['puzzle']}" if rows else "none"
    raise ArtefactError(f"{scores}: no episode of puzzle {puzzle}; it holds {held}")


def refused(file: Path, row: dict[str, Any], what: str) -> ArtefactError:
    """The error that says what is wrong with a row."""
    return ArtefactError(f"{file}: puzzle {row['puzzle']}: {what}; {_ELSE}")


def puzzle_of(file: Path, record: Scores, row: dict[str, Any]) -> Puzzle:
    """The puzzle of a row that could have been played."""
    puzzle, actions, rewards = puzzle_by_id(row["puzzle"]), row["actions"], row["rewards"]
    if puzzle.task != record.task:
        raise refused(file, row, f"a puzzle of task {puzzle.task}, but the scores are of {record.task}")
    if row["digest"] != puzzle.digest:
        raise refused(file, row, f"layout {row['digest']}, but that of the fixed puzzle is {puzzle.digest}")
    if not 0 < len(actions) == len(rewards) == row["steps"] <= step_budget(record.task):
        raise refused(file, row, f"{row['steps']} steps with {len(actions)} actions and {len(rewards)} rewards")
    if not all(0 <= action < N_ACTIONS for action in actions):
        raise refused(file, row, f"an action that is none of 0 to {N_ACTIONS - 1}")
    if not np.isfinite(rewards).all():
        raise refused(file, row, "a reward that is not finite")
    return puzzle


def play_again(file: Path, puzzle: Puzzle, row: dict[str, Any], see: See | None = None) -> Replay:
    """Play the actions of a row, and hold what comes of them against it.

    Args:
        file: named in errors.
        puzzle: of the row, from `puzzle_of`.
        row: of `read_episodes`.
        see: is shown the beginning and every step.

    Raises:
        ArtefactError: naming the first step at which something else happens.
    """
    actions, rewards = row["actions"], row["rewards"]
    env = OpenEnv(puzzle.task)
    image, info = env.reset(seed=0, options={"puzzle": puzzle})
    if see:
        see(env, image, info)
    terminated = False
    for step, (action, reward) in enumerate(zip(actions, rewards, strict=True), 1):
        image, paid, terminated, truncated, info = env.step(action)
        if see:
            see(env, image, info)
        if paid != reward:
            raise refused(file, row, f"step {step}: reward {reward} was recorded, {paid} is paid")
        if (terminated or truncated) is not (step == len(actions)):
            ends = "ends" if step < len(actions) else "does not end"
            raise refused(file, row, f"step {step}: the episode {ends} here")
    if terminated != row["terminated"]:
        raise refused(file, row, f"`terminated` is {row['terminated']}, but the episode's end says {terminated}")
    return Replay(row["puzzle"], puzzle, actions, rewards, terminated)
