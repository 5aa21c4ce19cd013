"""Scores played again: one puzzle by its id, or all of them, with everything that is claimed worked out anew.

The recorded actions are taken in a fresh world, and each must be paid what was recorded. A machine of another type may
round otherwise, and contacts let that grow: there, a difference is no proof of a forgery.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.config import decode
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import PER_SET, puzzle_by_id, puzzle_id
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError
from gym_open.evaluate.config import CheckpointConfig, EvaluateConfig
from gym_open.evaluate.proof import policy_facts, task_free_proof
from gym_open.evaluate.scores import EPISODES, RECORD, Episodes, Scores, read_episodes, read_scores, summarise

_ELSE = "the scores are forged, or were made on another type of machine or with other packages; evaluate again"
_TOLERANCE = 1e-9
"""Of what is a sum of the same numbers: another version of NumPy may add them in another order."""


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


def replay_puzzle(scores: Path, puzzle: str) -> Replay:
    """Play again what was played on one puzzle.

    Args:
        scores: a scores artefact, of a policy, the random agent, the oracle or a person.
        puzzle: its id, such as `tool-use/017` or `tool-use/validation/017`.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if the scores are damaged, do not hold the puzzle, or part from what happens: names the step.
    """
    puzzle_by_id(puzzle)
    record = read_scores(scores)
    rows = read_episodes(scores)
    for row in rows:
        if row["puzzle"] == puzzle:
            return _again(scores / EPISODES, _puzzle(scores / EPISODES, record, row), row)
    held = f"{rows[0]['puzzle']} to {rows[-1]['puzzle']}" if rows else "none"
    raise ArtefactError(f"{scores}: no episode of puzzle {puzzle}; it holds {held}")


def verify_scores(scores: Path) -> Scores:
    """Work out anew everything that scores claim: bytes, episodes, numbers, who played, and the task-free proof.

    Raises:
        ArtefactError: naming the first file, field and value that does not follow from the others.
    """
    record = read_scores(scores)
    rows = read_episodes(scores)
    ids = [puzzle_id(record.task, record.split, i) for i in range(PER_SET)]
    found = [row["puzzle"] for row in rows]
    first = ids.index(found[0]) if record.agent == "human" and found and found[0] in ids else 0
    last = first + len(found) if record.agent == "human" else PER_SET
    if not found or found != ids[first:last]:
        raise ArtefactError(
            f"{scores / EPISODES}: expected the {record.split} puzzles of {record.task}, each once and in order, got "
            f"{len(found)} others; evaluate again"
        )
    puzzles = [_puzzle(scores / EPISODES, record, row) for row in rows]
    for field, expected in (*_numbers(record, rows), *_origin(scores)):
        if not _same(getattr(record, field), expected):
            raise ArtefactError(
                f"{scores / RECORD}: `{field}` is {getattr(record, field)!r}, but {expected!r} follows from the rest "
                "of the artefact; evaluate again"
            )
    _check_proof(scores, record)
    with progress.bar("replay", len(rows)) as bar:
        for puzzle, row in zip(puzzles, rows, strict=True):
            _again(scores / EPISODES, puzzle, row)
            bar.advance()
    return record


def _refused(file: Path, row: dict[str, Any], what: str) -> ArtefactError:
    return ArtefactError(f"{file}: puzzle {row['puzzle']}: {what}; {_ELSE}")


def _puzzle(file: Path, record: Scores, row: dict[str, Any]) -> Puzzle:
    """The puzzle of a row that could have been played."""
    puzzle, actions, rewards = puzzle_by_id(row["puzzle"]), row["actions"], row["rewards"]
    if puzzle.task != record.task:
        raise _refused(file, row, f"a puzzle of task {puzzle.task}, but the scores are of {record.task}")
    if row["digest"] != puzzle.digest:
        raise _refused(file, row, f"layout {row['digest']}, but that of the fixed puzzle is {puzzle.digest}")
    if not 0 < len(actions) == len(rewards) == row["steps"] <= step_budget(record.task):
        raise _refused(file, row, f"{row['steps']} steps with {len(actions)} actions and {len(rewards)} rewards")
    if not all(0 <= action < N_ACTIONS for action in actions):
        raise _refused(file, row, f"an action that is none of 0 to {N_ACTIONS - 1}")
    if not np.isfinite(rewards).all():
        raise _refused(file, row, "a reward that is not finite")
    return puzzle


def _again(file: Path, puzzle: Puzzle, row: dict[str, Any]) -> Replay:
    """Play the actions of a row, and hold what comes of them against it."""
    actions, rewards = row["actions"], row["rewards"]
    env = OpenEnv(puzzle.task)
    env.reset(seed=0, options={"puzzle": puzzle})
    terminated = False
    for step, (action, reward) in enumerate(zip(actions, rewards, strict=True), 1):
        _, paid, terminated, truncated, _ = env.step(action)
        if paid != reward:
            raise _refused(file, row, f"step {step}: reward {reward} was recorded, {paid} is paid")
        if (terminated or truncated) is not (step == len(actions)):
            ends = "ends" if step < len(actions) else "does not end"
            raise _refused(file, row, f"step {step}: the episode {ends} here")
    if terminated != row["terminated"]:
        raise _refused(file, row, f"`terminated` is {row['terminated']}, but the episode's end says {terminated}")
    return Replay(row["puzzle"], puzzle, actions, rewards, terminated)


def _numbers(record: Scores, rows: list[dict[str, Any]]) -> Iterator[tuple[str, Any]]:
    """What the record must say of its episodes."""
    N = step_budget(record.task)
    rewards = np.zeros((len(rows), N))
    for out, row in zip(rewards, rows, strict=True):
        out[: row["steps"]] = row["rewards"]
    steps, terminated = (np.array([row[name] for row in rows]) for name in ("steps", "terminated"))
    yield from summarise(Episodes(np.zeros((len(rows), N), np.int8), rewards, steps, terminated)).items()


def _origin(scores: Path) -> Iterator[tuple[str, Any]]:
    """What the record must say of who played, by the artefact's lineage and configuration."""
    lineage, config = artefacts.lineage(scores), artefacts.config_of(scores)
    yield "code", lineage.code
    for name in ("task", "split"):
        yield name, config.get(name)
    if not lineage.parents:
        yield "policy", None
        yield "trained", 0
        return
    policy = lineage.parents[0]
    facts = policy_facts(policy, scores)
    kind = CheckpointConfig if "at" in config else EvaluateConfig
    asked = decode(config, kind, source=str(scores / artefacts.CONFIG))
    yield "policy", policy.digest
    yield "agent", facts.agent
    yield "seed", facts.seed
    yield "trained", facts.steps_at(asked.at) if isinstance(asked, CheckpointConfig) else facts.steps
    yield "actions", asked.actions
    yield "evaluation_seed", asked.seed


def _check_proof(scores: Path, record: Scores) -> None:
    """Nothing better may be said than what the lineage gives today."""
    parents = artefacts.lineage(scores).parents
    if not parents:
        if record.agent not in {"random", "oracle", "human"} or record.proof.verdict == "proven":
            raise ArtefactError(
                f"{scores / artefacts.LINEAGE}: scores of {record.agent!r} that name no policy: the chain is cut; "
                "evaluate again"
            )
        return
    proof = task_free_proof(parents[0])
    if record.proof.verdict not in {proof.verdict, "missing"}:
        raise ArtefactError(
            f"{scores / RECORD}: `proof.verdict` is {record.proof.verdict!r}, but the lineage gives {proof.verdict!r} "
            f"({'; '.join(proof.reasons)}); evaluate again"
        )


def _same(found: Any, expected: Any) -> bool:
    if isinstance(expected, float | list):
        return np.shape(found) == np.shape(expected) and np.allclose(found, expected, rtol=0, atol=_TOLERANCE)
    return found == expected
