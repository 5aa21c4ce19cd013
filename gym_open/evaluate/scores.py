"""What a scores artefact records: `scores.json`, and `episodes.parquet` with a row a puzzle."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import Split
from gym_open.errors import ArtefactError
from gym_open.evaluate.metrics import a_success, mean_return_within
from gym_open.evaluate.proof import Proof

if TYPE_CHECKING:
    import pyarrow as pa

RECORD, EPISODES = "scores.json", "episodes.parquet"


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of `scores.json`: who played what, how well, and what is known of where the player comes from."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"]
    split: Split
    agent: str
    """Name of the agent in tables; `random`, `oracle` and `human` are no policies."""
    seed: int | None
    """Root seed of the policy's training; of `random`, that of its actions; None if there is none."""
    evaluation_seed: int | None
    """Root seed of sampled actions; None if nothing was drawn."""
    trained: int
    """Agent steps on the task behind the weights that were scored; 0 for what is no policy."""
    actions: Literal["sampled", "greedy", "witnesses", "keyboard"]
    """How actions were chosen."""
    policy: str | None
    """Digest of the policy artefact."""
    proof: Proof
    code: str
    """Version of gym-open that evaluated."""
    hardware: dict[str, str | int]
    """What it was evaluated on."""
    a_success: float
    a_success_half_width_95: float
    """Half of the width of the 95% normal interval over puzzles: another draw of puzzles, not another training seed."""
    mean_return: float
    """Within all N actions of the task's budget."""
    mean_return_within: list[float]
    """Within 1…N actions."""
    mean_steps: float
    """Actions until an episode was over."""
    puzzles: int
    """How many were played."""


class Episodes(msgspec.Struct, frozen=True):
    """What was played: row i of every array is puzzle i.

    `actions` and `rewards` have shape (puzzles, N); behind an episode's end actions are −1 and rewards 0.
    """

    actions: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    terminated: np.ndarray


def summarise(episodes: Episodes) -> dict[str, Any]:
    """The numbers of `Scores`, from `a_success` to `puzzles`, of two or more played episodes.

    A-Success is linear in the rewards, so it is the mean of the puzzles' own values, and the interval follows from
    their spread. It says how far another draw of puzzles might lead, not another training seed.
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


def read_scores(scores: Path) -> Scores:
    """The record of the scores artefact at `scores`, every byte of which is checked first.

    Raises:
        ArtefactError: if it is damaged, no `scores`, or its record is not as gym-open writes it.
    """
    artefacts.verify(scores, "scores")
    path = scores / RECORD
    try:
        return msgspec.json.decode(path.read_bytes(), type=Scores)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing, so there are no scores here; evaluate again") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not scores as this version writes them: {error}; evaluate again") from None


def write_scores(folder: Path, record: Scores, also: Mapping[str, Any] | None = None) -> None:
    """Write `scores.json`, with further fields `also` if there are any."""
    fields = {**msgspec.to_builtins(record), **(also or {})}
    (folder / RECORD).write_bytes(artefacts.canonical_json(fields))


def _schema() -> "pa.Schema":
    import pyarrow as pa

    return pa.schema(
        {
            "puzzle": pa.string(),
            "digest": pa.string(),
            "a_success": pa.float64(),
            "return": pa.float64(),
            "steps": pa.int64(),
            "terminated": pa.bool_(),
            "actions": pa.list_(pa.int64()),
            "rewards": pa.list_(pa.float64()),
        }
    )


def write_episodes(folder: Path, ids: Sequence[str], puzzles: Sequence[Puzzle], episodes: Episodes) -> None:
    """Write `episodes.parquet`: a row a puzzle, with every action and reward until its end."""
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
    pq.write_table(pa.table(columns, schema=_schema()), folder / EPISODES)


def read_episodes(scores: Path) -> list[dict[str, Any]]:
    """The rows of `episodes.parquet`, as plain data.

    Raises:
        ArtefactError: if it is missing, damaged, or has other columns.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = scores / EPISODES
    try:
        table = pq.read_table(path)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing, so nothing can be replayed; evaluate again") from None
    except (pa.ArrowException, OSError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; evaluate again") from None
    if not table.schema.equals(_schema()) or any(_has_nulls(column) for column in table.columns):
        raise ArtefactError(f"{path}: its columns are not those that gym-open writes; evaluate again")
    return table.to_pylist()


def _has_nulls(column: "pa.ChunkedArray") -> bool:
    import pyarrow as pa

    lists = [chunk.flatten() for chunk in column.chunks if isinstance(chunk, pa.ListArray)]
    return bool(column.null_count or any(inner.null_count for inner in lists))
