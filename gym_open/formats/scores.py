"""Files of a scores artefact: `scores.json`, and `episodes.parquet` with a row per puzzle; `evaluate` writes them."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from gym_open import artefacts
from gym_open.envs.puzzles.sets import PER_SET, Split
from gym_open.errors import ArtefactError
from gym_open.precision import Precision

if TYPE_CHECKING:
    import pyarrow as pa

RECORD, EPISODES = "scores.json", "episodes.parquet"


class Proof(msgspec.Struct, frozen=True):
    """The task-free proof of a policy.

    `proven`: the whole chain was found and is task-free. `no encoder`: nothing was learned before the task.
    `missing`: the chain breaks for the `reasons`, and nothing is proven. `not applicable`: the player is no policy.
    """

    verdict: Literal["proven", "no encoder", "missing", "not applicable"]
    reasons: list[str]
    chain: list[str]
    """A line per link, from the policy down to the logs."""
    rests_on: str = ""
    """What records cannot show and must be believed, and how to check it."""


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """Content of `scores.json`: player, task, results, and the origin of the player."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"]
    split: Split
    agent: str
    """Name of the agent in tables; `random`, `oracle` and `human` have no policy."""
    seed: int | None
    """Root seed of the policy's training; for `random`, of its actions; None if there is none."""
    evaluation_seed: int | None
    """Root seed of sampled actions; None if nothing was drawn."""
    trained: int
    """Agent steps on the task behind the weights that were scored; 0 without a policy."""
    actions: Literal["sampled", "greedy", "witnesses", "keyboard"]
    """How actions were chosen."""
    policy: str | None
    """Digest of the policy artefact."""
    proof: Proof
    code: str
    """Version of gym-open that evaluated."""
    hardware: dict[str, str | int]
    """Hardware of the evaluation."""
    precision: Precision | None = None
    """Arithmetic of the policy's training (scoring computes in fp32); None without a policy, and in scores of gym-open
    0.1."""
    a_success: float
    a_success_half_width_95: float
    """Half of the width of the 95% normal interval over puzzles; it does not cover another training seed."""
    mean_return: float
    """Return within all N actions of the task's budget."""
    mean_return_within: list[float]
    """Return within 1…N actions."""
    mean_steps: float
    """Actions until the end of an episode."""
    puzzles: int
    """Number of puzzles that were played."""


def read_scores(scores: Path) -> Scores:
    """Check every byte of the scores artefact at `scores`, and read its record.

    Raises:
        ArtefactError: if it is damaged, is no scores artefact, or its record is not as gym-open writes it.
    """
    artefacts.verify(scores, "scores")
    path = scores / RECORD
    try:
        return msgspec.json.decode(path.read_bytes(), type=Scores)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: missing, so there are no scores; evaluate again") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not scores as this version writes them: {error}; evaluate again") from None


def episodes_schema() -> "pa.Schema":
    """Return the columns of `episodes.parquet`."""
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


def read_episodes(scores: Path) -> list[dict[str, Any]]:
    """Read the rows of `episodes.parquet` as plain data.

    Raises:
        ArtefactError: if it is missing, damaged, has other columns, or more rows than a set has puzzles.
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
    if table.num_rows > PER_SET:
        raise ArtefactError(f"{path}: {table.num_rows:,} episodes, but a set has {PER_SET} puzzles; evaluate again")
    if not table.schema.equals(episodes_schema()) or any(_has_nulls(column) for column in table.columns):
        raise ArtefactError(f"{path}: its columns are not those that gym-open writes; evaluate again")
    return table.to_pylist()


def _has_nulls(column: "pa.ChunkedArray") -> bool:
    import pyarrow as pa

    lists = [chunk.flatten() for chunk in column.chunks if isinstance(chunk, pa.ListArray)]
    return bool(column.null_count or any(inner.null_count for inner in lists))
