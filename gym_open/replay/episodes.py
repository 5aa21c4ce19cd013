"""Replay of scored episodes, each found by the id of its puzzle.

The recorded actions are taken in a new world, and each must get the recorded reward. A machine of another type may
round differently, and contacts make such differences grow. On such a machine, a difference does not prove a forgery.
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
Observer = Callable[[OpenEnv, np.ndarray, dict[str, Any]], None]
"""Takes the environment in its present state, its observation (84, 84, 3) uint8, and its info."""


class ReplayedEpisode(msgspec.Struct, frozen=True):
    """An episode whose replay gave what was recorded."""

    id: str
    """Id of the puzzle, such as `tool-use/017`."""
    puzzle: Puzzle
    actions: list[int]
    rewards: list[float]
    """One per action."""
    terminated: bool
    """Whether the task ended the episode; otherwise its step budget did."""


def replay_puzzle(scores: Path, puzzle: str, observe: Observer | None = None) -> ReplayedEpisode:
    """Replay the episode on one puzzle.

    Args:
        scores: a scores artefact of a policy, the random agent, the oracle or a person.
        puzzle: its id, such as `tool-use/017` or `tool-use/validation/017`.
        observe: called at the beginning and after every step.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if the scores are damaged, lack the puzzle, or differ from the replay; then it names the step.
    """
    row = scored_row(scores, puzzle)
    return replay_row(scores / EPISODES, puzzle_of(scores / EPISODES, read_scores(scores), row), row, observe)


def scored_row(scores: Path, puzzle: str) -> dict[str, Any]:
    """Return the record of one puzzle's episode: a row of `read_episodes`.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if the scores are damaged, or lack the puzzle.
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
    """Return the error that says what is wrong with a row."""
    return ArtefactError(f"{file}: puzzle {row['puzzle']}: {what}; {_ELSE}")


def puzzle_of(file: Path, record: Scores, row: dict[str, Any]) -> Puzzle:
    """Return the puzzle of a row, after checking that an episode on it can look like this row."""
    puzzle, actions, rewards = puzzle_by_id(row["puzzle"]), row["actions"], row["rewards"]
    if puzzle.task != record.task:
        raise refused(file, row, f"a puzzle of task {puzzle.task}, but the scores are of {record.task}")
    if row["digest"] != puzzle.digest:
        raise refused(file, row, f"layout {row['digest']}, but that of the fixed puzzle is {puzzle.digest}")
    if not 0 < len(actions) == len(rewards) == row["steps"] <= step_budget(record.task):
        raise refused(file, row, f"{row['steps']} steps with {len(actions)} actions and {len(rewards)} rewards")
    if not all(0 <= action < N_ACTIONS for action in actions):
        raise refused(file, row, f"an action outside 0 to {N_ACTIONS - 1}")
    if not np.isfinite(rewards).all():
        raise refused(file, row, "a reward that is not finite")
    return puzzle


def replay_row(file: Path, puzzle: Puzzle, row: dict[str, Any], observe: Observer | None = None) -> ReplayedEpisode:
    """Replay the actions of a row and compare rewards and end with the record.

    Args:
        file: named in errors.
        puzzle: of the row, from `puzzle_of`.
        row: from `read_episodes`.
        observe: called at the beginning and after every step.

    Raises:
        ArtefactError: if the replay differs; names the first such step.
    """
    actions, rewards = row["actions"], row["rewards"]
    env = OpenEnv(puzzle.task)
    image, info = env.reset(seed=0, options={"puzzle": puzzle})
    if observe:
        observe(env, image, info)
    terminated = False
    for step, (action, reward) in enumerate(zip(actions, rewards, strict=True), 1):
        image, replayed, terminated, truncated, info = env.step(action)
        if observe:
            observe(env, image, info)
        if replayed != reward:
            raise refused(file, row, f"step {step}: reward {reward} was recorded, the replay gave {replayed}")
        if (terminated or truncated) is not (step == len(actions)):
            ends = "ends" if step < len(actions) else "does not end"
            raise refused(file, row, f"step {step}: the episode {ends} here")
    if terminated != row["terminated"]:
        raise refused(file, row, f"`terminated` is {row['terminated']}, but the episode's end says {terminated}")
    return ReplayedEpisode(row["puzzle"], puzzle, actions, rewards, terminated)
