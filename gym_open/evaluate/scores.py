"""Scores of played episodes, computed and written in the format of `formats.scores`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.scores import EPISODES, RECORD, Scores, episodes_schema
from gym_open.results.metrics import a_success, mean_return_within


class Episodes(msgspec.Struct, frozen=True):
    """Played episodes: row i of every array is puzzle i.

    `actions` and `rewards` have shape (puzzles, N); after the end of an episode, actions are −1 and rewards 0.
    """

    actions: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    terminated: np.ndarray


def summarise(episodes: Episodes) -> dict[str, Any]:
    """Compute the numbers of `Scores`, from `a_success` to `puzzles`, for two or more played episodes.

    A-Success is linear in the rewards, so it is the mean of the values of single puzzles, and the interval follows from
    their spread. The interval covers another draw of puzzles, not another training seed.
    """
    s = mean_return_within(episodes.rewards)
    per_puzzle = np.array([a_success(np.cumsum(row)) for row in episodes.rewards])
    return {
        "a_success": a_success(s),
        "a_success_half_width_95": float(1.96 * per_puzzle.std(ddof=1) / np.sqrt(len(per_puzzle))),
        "mean_return": float(s[-1]),
        "mean_return_within": [float(value) for value in s],
        "mean_steps": float(episodes.steps.mean()),
        "puzzles": len(per_puzzle),
    }


def write_scores(folder: Path, record: Scores, also: Mapping[str, Any] | None = None) -> None:
    """Write `scores.json`, with the further fields in `also`."""
    fields = {**msgspec.to_builtins(record), **(also or {})}
    (folder / RECORD).write_bytes(artefacts.canonical_json(fields))


def write_episodes(folder: Path, ids: Sequence[str], puzzles: Sequence[Puzzle], episodes: Episodes) -> None:
    """Write `episodes.parquet`: a row per puzzle, with every action and reward up to the end of the episode."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    lengths = episodes.steps.tolist()
    columns = {
        "puzzle": list(ids),
        "digest": [puzzle.digest for puzzle in puzzles],
        "a_success": [a_success(np.cumsum(row)) for row in episodes.rewards],
        "return": episodes.rewards.sum(axis=1),
        "steps": episodes.steps,
        "terminated": episodes.terminated,
        "actions": [row[:n].tolist() for row, n in zip(episodes.actions, lengths, strict=True)],
        "rewards": [row[:n].tolist() for row, n in zip(episodes.rewards, lengths, strict=True)],
    }
    pq.write_table(pa.table(columns, schema=episodes_schema()), folder / EPISODES)
