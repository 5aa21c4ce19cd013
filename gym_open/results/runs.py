"""Scores artefacts below folders, each checked byte by byte and against its own episodes before it is believed."""

import functools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from gym_open import artefacts
from gym_open.artefacts import CONFIG, LINEAGE, MANIFEST, Lineage, Parent
from gym_open.envs.puzzles.sets import PER_SET, puzzle_id
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError
from gym_open.files import sha256_file
from gym_open.formats.scores import EPISODES, RECORD, Scores, read_episodes, read_scores
from gym_open.precision import Precision
from gym_open.replay.episodes import puzzle_of, refused
from gym_open.results.metrics import a_success
from gym_open.results.names import UNTRAINED, one_line, row_name
from gym_open.results.records import check_steps, check_values

_SAME = 1e-9
"""Largest difference between a recorded number and the number that its episodes give: sums may be rounded."""


def artefact_folders(source: Path) -> Iterator[Path]:
    """Yield the folders with a manifest at or below `source`, by name; none inside another, none hidden."""
    for folder, below, files in os.walk(source.resolve()):
        below[:] = [] if MANIFEST in files else sorted(name for name in below if not name.startswith("."))
        if MANIFEST in files:
            yield Path(folder)


class _Checkpoint(msgspec.Struct, frozen=True):
    asked: int
    step: int


class PolicyFacts(msgspec.Struct, frozen=True):
    """The facts in a policy's lineage that scoring needs."""

    task: str
    steps: int
    agent: Annotated[str, Meta(pattern=r"^(?!(random|oracle|human)\Z)")]
    """Never the name of an agent that has no policy."""
    seed: int
    encoder: Literal["none", "offline", "online"]
    from_encoder: bool
    checkpoints: list[_Checkpoint]
    precision: Precision | None = None
    """Arithmetic of the training; None in policies of gym-open 0.1."""

    def steps_at(self, asked: int) -> int | None:
        """Return the agent steps of the checkpoint that was asked for, or None if it does not exist."""
        return {checkpoint.asked: checkpoint.step for checkpoint in self.checkpoints}.get(asked)


def policy_facts(policy: Parent, folder: Path) -> PolicyFacts:
    """Read the facts of a policy; errors name `folder`.

    Raises:
        ArtefactError: if the lineage is not a policy's.
    """
    try:
        return msgspec.convert(policy.lineage.facts, PolicyFacts)
    except msgspec.ValidationError as error:
        raise ArtefactError(
            f"{folder / LINEAGE}: not a policy's facts as this version writes them: {error}; train it again"
        ) from None


@dataclass(frozen=True)
class ScoredRun:
    """One scores artefact: P puzzles with a budget of N actions each."""

    folder: Path
    digest: str
    lineage: Lineage
    record: Scores
    config_sha256: str
    puzzles: tuple[str, ...]
    """Ids (P): a contiguous part of the fixed set, in order."""
    returns: np.ndarray
    """Return of each puzzle within 1…N actions, shape (P, N)."""
    values: np.ndarray
    """A-Success of each puzzle, shape (P,)."""
    steps: np.ndarray
    """Actions taken, shape (P,)."""
    terminated: np.ndarray
    """Whether the task ended the episode, shape (P,)."""

    @property
    def name(self) -> str:
        """The name of the row that this run belongs to."""
        return row_name(self.record, self.puzzles)

    @property
    def seed(self) -> int | str:
        """What separates this run from the others of its row: the training seed, or the player."""
        player = self.lineage.facts.get("player")
        return one_line(str(player)) if player else self.record.seed or 0

    @property
    def trained(self) -> int:
        """Steps of training behind the weights that were scored."""
        return self.record.trained

    @property
    def identity(self) -> tuple[str, str, str, str, int]:
        """Task, split, row, seed and steps: no two runs of a report or figure have the same."""
        return self.record.task, self.record.split, self.name, str(self.seed), self.trained


def read_run(folder: Path) -> ScoredRun:
    """Read a scores artefact and check it: bytes, player, every episode, and every number that follows from them.

    Raises:
        ArtefactError: naming the file and field that is damaged or contradicts the rest.
    """
    record, lineage = read_scores(folder), artefacts.lineage(folder)
    rows, budget = read_episodes(folder), step_budget(record.task)
    try:
        check_steps([record.trained])
        check_values(value for row in rows for value in row["rewards"])
        if len(record.mean_return_within) != budget:
            raise ValueError(f"`mean_return_within`: {budget} numbers expected, got {len(record.mean_return_within)}")
    except ValueError as error:
        raise ArtefactError(f"{folder}: not scores as gym-open writes them: {error}; evaluate again") from None
    _check_player(folder, record, lineage)
    puzzles = _check_puzzles(folder / EPISODES, record, rows)
    rewards = rewards_of(folder / EPISODES, rows, budget)
    returns = np.cumsum(rewards, axis=1)
    run = ScoredRun(
        folder=folder, digest=artefacts.digest(folder), lineage=lineage, record=record,
        config_sha256=sha256_file(folder / CONFIG), puzzles=puzzles, returns=returns,
        values=returns @ _weights(budget), steps=np.array([row["steps"] for row in rows]),
        terminated=np.array([row["terminated"] for row in rows], dtype=bool),
    )  # fmt: skip
    _check_numbers(run)
    return run


def _check_player(folder: Path, record: Scores, lineage: Lineage) -> None:
    """Check that the lineage names the recorded player; without a policy, the proof says what is missing."""
    if record.agent in UNTRAINED:
        claims = [("policy", record.policy, None), ("trained", record.trained, 0)]
        claims += [("agent", record.agent, "that of the policy in its lineage")] if lineage.parents else []
    elif lineage.parents:
        policy = lineage.parents[0]
        facts = policy_facts(policy, folder)
        asked = artefacts.config_of(folder).get("at")
        claims = [("policy", record.policy, policy.digest), ("agent", record.agent, facts.agent)]
        claims += [("task", record.task, facts.task), ("seed", record.seed, facts.seed)]
        claims += [("trained", record.trained, facts.steps if asked is None else facts.steps_at(asked))]
    else:
        claims = []
    for key, said, found in claims:
        if said != found:
            raise ArtefactError(
                f"{folder / RECORD}: `{key}` is {said!r}, but its lineage says {found!r}; evaluate again"
            )


def _check_puzzles(file: Path, record: Scores, rows: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """Return the ids of the rows, each of which must be possible, in the order of the set, without a gap."""
    fixed = [puzzle_id(record.task, record.split, i) for i in range(PER_SET)]
    ids = [row["puzzle"] for row in rows]
    first = fixed.index(ids[0]) if ids and ids[0] in fixed else 0
    if not ids or ids != fixed[first : first + len(ids)]:
        raise ArtefactError(
            f"{file}: not the {record.split} puzzles of {record.task}, at least one, each once and in order; "
            "evaluate again"
        )
    for row in rows:
        puzzle_of(file, record, row)
    return tuple(ids)


def rewards_of(file: Path, rows: Sequence[dict[str, Any]], budget: int) -> np.ndarray:
    """Return the rewards of episodes, shape (episodes, budget), with zeros after the end of an episode.

    Args:
        file: named in errors.
        rows: of `read_episodes`, each checked with `puzzle_of`.
        budget: N actions.

    Raises:
        ArtefactError: if a row's A-Success or return does not follow from its rewards.
    """
    rewards = np.zeros((len(rows), budget))
    for own, row in zip(rewards, rows, strict=True):
        own[: row["steps"]] = row["rewards"]
        for name, found in (("a_success", a_success(np.cumsum(own))), ("return", float(own.sum()))):
            if not abs(row[name] - found) <= _SAME:
                raise refused(file, row, f"`{name}` is {row[name]}, but {found} follows from its rewards")
    return rewards


def _check_numbers(run: ScoredRun) -> None:
    """Check the numbers of `scores.json` against the episodes."""
    record, within = run.record, run.returns.mean(axis=0)
    claims = [
        ("a_success", record.a_success, run.values.mean()), ("mean_return", record.mean_return, within[-1]),
        ("mean_steps", record.mean_steps, run.steps.mean()), ("puzzles", record.puzzles, len(run.puzzles)),
    ]  # fmt: skip
    pairs = zip(record.mean_return_within, within, strict=True)
    claims += [(f"mean_return_within[{i}]", said, found) for i, (said, found) in enumerate(pairs)]
    for key, said, found in claims:
        if not abs(said - found) <= _SAME:
            raise ArtefactError(
                f"{run.folder / RECORD}: `{key}` is {said}, but {EPISODES} gives {found}; evaluate again"
            )


@functools.cache
def _weights(budget: int) -> np.ndarray:
    """Return the weights of A-Success, which is linear in s_1…s_N: its values at the unit vectors."""
    return np.array([a_success(unit) for unit in np.eye(budget)])


class DistinctRuns(NamedTuple):
    """Runs of which no two have the same identity."""

    kept: list[ScoredRun]
    set_aside: list[ScoredRun]
    """Older runs whose folder `artefacts.build` renamed (NAME-1 next to NAME) when it made newer ones."""
    doubles: list[tuple[ScoredRun, ScoredRun]]
    """Runs that contradict a kept run of the same identity, and that run."""


def distinct(runs: Sequence[ScoredRun]) -> DistinctRuns:
    """Keep one run of each identity. Of runs with equal content, one is dropped without a word."""
    kept, aside, doubles = dict[tuple[str, str, str, str, int], ScoredRun](), [], []
    for run in sorted(runs, key=lambda run: (len(run.folder.name), str(run.folder))):
        if any(_is_set_aside(run, newer) for newer in kept.values()):
            aside.append(run)
            continue
        first = kept.setdefault(run.identity, run)
        if first is not run and not _is_same(run, first):
            doubles.append((run, first))
    return DistinctRuns(list(kept.values()), aside, doubles)


def _is_same(run: ScoredRun, first: ScoredRun) -> bool:
    """Whether both say the same: the last checkpoint of a policy may have been scored as checkpoint and as end."""
    return run.record.policy == first.record.policy and np.array_equal(run.returns, first.returns)


def _is_set_aside(run: ScoredRun, newer: ScoredRun) -> bool:
    """Whether `newer` replaced `run`, whose folder was renamed then; its policy may have been trained for longer."""
    alike = run.identity[:4] == newer.identity[:4] and not _is_same(run, newer)
    other = run.trained == newer.trained or run.record.policy != newer.record.policy
    name, siblings = run.folder.name, run.folder.parent == newer.folder.parent
    return alike and other and siblings and re.fullmatch(re.escape(newer.folder.name) + r"-\d+", name) is not None
