"""Verification of scores: compute every claim again, replay every episode and choose its actions again."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.artefacts import Parent
from gym_open.config import decode
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import PER_SET, published_digests, puzzle_id
from gym_open.envs.puzzles.witnesses import witness_name, witnesses_of
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, ConfigError
from gym_open.evaluate.config import CheckpointConfig, EvaluateConfig, OracleConfig
from gym_open.evaluate.human import HumanConfig
from gym_open.evaluate.play import chooser, load_actor, play, uniform
from gym_open.evaluate.proof import human_proof, oracle_proof, task_free_proof
from gym_open.evaluate.scores import Episodes, summarise
from gym_open.formats.scores import EPISODES, RECORD, Proof, Scores, read_episodes, read_scores
from gym_open.replay.episodes import puzzle_of, refused, replay_row
from gym_open.results.runs import policy_facts, rewards_of

EpisodeRow = dict[str, Any]

_TOLERANCE = 1e-9
"""Allowed difference of sums of the same numbers: another version of NumPy may add them in another order."""
AnyConfig = EvaluateConfig | OracleConfig | HumanConfig
_KINDS: dict[str, type[AnyConfig]] = {
    "at": CheckpointConfig, "witnesses": OracleConfig, "player": HumanConfig,
}  # fmt: skip
"""Type of the configuration of scores, by a key that no other type has."""


class VerifiedScores(NamedTuple):
    """Scores in which no error was found."""

    scores: Scores
    chosen: str
    """What the check showed about who chose the actions; to be printed with the scores."""


def verify_scores(scores: Path, policy: Path | None = None) -> VerifiedScores:
    """Check everything that scores claim: bytes, episodes, numbers, player, and the task-free proof.

    The actions of the random agent are drawn again; those of the oracle are compared with the witnesses. The actions of
    a policy are chosen again if its folder is given; a machine of another type may round its probabilities differently.

    Args:
        scores: a scores artefact.
        policy: the policy that was scored.

    Raises:
        ArtefactError: naming the first file, field and value that does not follow from the others, or the first step
            at which another action is chosen.
    """
    claim = _ClaimedScores(scores, read_scores(scores), _config(scores), read_episodes(scores))
    record, lineage = claim.record, artefacts.lineage(scores)
    parent = lineage.parents[0] if lineage.parents else None
    puzzles = _puzzles(claim)
    if parent is None and (
        record.agent not in {"random", "oracle", "human"} or isinstance(claim.config, CheckpointConfig)
    ):
        raise ArtefactError(
            f"{scores / artefacts.LINEAGE}: scores of {record.agent!r} that name no policy, so the chain is broken; "
            "evaluate again"
        )
    numbers, origin = _numbers(claim), {"task": claim.config.task, "split": claim.config.split, "code": lineage.code}
    _check(scores / RECORD, record, {**numbers, **origin, **_player(claim, parent)})
    proof = msgspec.structs.asdict(_proof(claim, parent))
    _check(scores / RECORD, record.proof, proof, prefix="proof.")
    chosen = _choose_again(claim, policy, puzzles)
    with progress.bar("replay", len(puzzles)) as bar:
        for puzzle, row in zip(puzzles, claim.rows, strict=True):
            replay_row(claim.file, puzzle, row)
            bar.advance()
    return VerifiedScores(record, chosen)


@dataclass(frozen=True)
class _ClaimedScores:
    """The content of scores as it was read."""

    scores: Path
    record: Scores
    config: AnyConfig
    rows: list[EpisodeRow]

    @property
    def file(self) -> Path:
        """File of the rows."""
        return self.scores / EPISODES


def _config(scores: Path) -> AnyConfig:
    """Read the configuration of scores; its type depends on the kind of player."""
    raw = artefacts.config_of(scores)
    kind = next((kind for key, kind in _KINDS.items() if key in raw), EvaluateConfig)
    try:
        return decode(raw, kind, source=str(scores / artefacts.CONFIG))
    except ConfigError as error:
        raise ArtefactError(f"{error}; evaluate again") from None


def _puzzles(claim: _ClaimedScores) -> tuple[Puzzle, ...]:
    """Return the puzzles that were played: the whole set, or the range that a person chose."""
    record, found = claim.record, [row["puzzle"] for row in claim.rows]
    first, last = claim.config.puzzles if isinstance(claim.config, HumanConfig) else (0, PER_SET)
    if not found or found != [puzzle_id(record.task, record.split, i) for i in range(PER_SET)][first:last]:
        raise ArtefactError(
            f"{claim.file}: expected the {record.split} puzzles of {record.task}, each once and in order, got "
            f"{len(found)} others; evaluate again"
        )
    return tuple(puzzle_of(claim.file, record, row) for row in claim.rows)


def _numbers(claim: _ClaimedScores) -> dict[str, Any]:
    """Return the numbers of the record that follow from the episodes, after checking each episode."""
    record, rows = claim.record, claim.rows
    N = step_budget(record.task)
    rewards = rewards_of(claim.file, rows, N)
    steps, terminated = (np.array([row[name] for row in rows]) for name in ("steps", "terminated"))
    return summarise(Episodes(np.zeros((len(rows), N), np.int8), rewards, steps, terminated))


def _player(claim: _ClaimedScores, parent: Parent | None) -> dict[str, Any]:
    """Return the fields of the record that follow from the artefact's configuration and lineage."""
    record, none = claim.record, {"policy": None, "trained": 0, "seed": None, "evaluation_seed": None}
    match claim.config:
        case OracleConfig() as config:
            witnesses = published_digests()[witness_name(record.task, record.split)]
            _check(claim.scores / artefacts.CONFIG, config, {"witnesses": witnesses})
            return {**none, "agent": "oracle", "actions": "witnesses"}
        case HumanConfig():
            return {**none, "agent": "human", "actions": "keyboard"}
        case config if parent is None:
            return {
                **none, "agent": "random", "actions": config.actions, "seed": config.seed,
                "evaluation_seed": config.seed,
            }  # fmt: skip
    facts = policy_facts(parent, claim.scores)
    return {
        "policy": parent.digest, "agent": facts.agent, "seed": facts.seed, "actions": config.actions,
        "evaluation_seed": config.seed,
        "trained": facts.steps_at(config.at) if isinstance(config, CheckpointConfig) else facts.steps,
    }  # fmt: skip


def _proof(claim: _ClaimedScores, parent: Parent | None) -> Proof:
    """Return the proof that the lineage gives now."""
    match claim.config:
        case OracleConfig():
            return oracle_proof()
        case HumanConfig():
            return human_proof()
        case _:
            return task_free_proof(parent, evaluator=claim.record.code)


def _choose_again(claim: _ClaimedScores, policy: Path | None, puzzles: tuple[Puzzle, ...]) -> str:
    """Compare the recorded actions with those of the named player; return what that shows."""
    record = claim.record
    if policy is not None and record.policy is None:
        raise ArtefactError(f"{claim.scores}: scores of {record.agent}, which is no policy; omit --policy")
    match claim.config:
        case HumanConfig():
            return "nothing proves that a person chose the actions"
        case OracleConfig():
            witnesses = witnesses_of(record.task, record.split)[: len(puzzles)]
            _check_actions(claim, "the witness", [witness.actions for witness in witnesses])
            return "every action is the witness's"
        case config if record.policy is None:
            _check_actions(claim, f"the random agent of seed {config.seed}", _drawn(config, claim.rows))
            return f"every action was drawn again from seed {config.seed}"
    if policy is None:
        return "not checked that the policy chose these actions; give --policy FOLDER to check it"
    _check_actions(claim, "the policy", _of_policy(record, config, policy, puzzles))
    return "the policy chose every action again"


def _drawn(config: EvaluateConfig, rows: list[EpisodeRow]) -> list[list[int]]:
    """Draw the random agent's actions, which do not depend on observations."""
    choose = chooser(uniform, config.task, len(rows), config)
    return [[choose(t, np.array([i]), np.empty((1, 0)))[0] for t in range(row["steps"])] for i, row in enumerate(rows)]


def _of_policy(record: Scores, config: EvaluateConfig, policy: Path, puzzles: tuple[Puzzle, ...]) -> list[list[int]]:
    """Return the policy's actions in the puzzles, after checking that it is the policy that was scored."""
    from gym_open.formats.models import policy_folder

    found = artefacts.verify(policy, "policy")
    if found != record.policy:
        raise ArtefactError(
            f"{policy}: its digest is {found}, but the scores are of the policy {record.policy}; give that policy"
        )
    folder = policy_folder(policy, record.trained) if isinstance(config, CheckpointConfig) else policy
    actor, states = load_actor(folder, config)
    played = play(actor, config.task, puzzles, config, states=states)
    return [row[:steps].tolist() for row, steps in zip(played.actions, played.steps, strict=True)]


def _check_actions(claim: _ClaimedScores, who: str, chosen: Sequence[Sequence[int]]) -> None:
    for row, expected in zip(claim.rows, chosen, strict=True):
        for step, (found, action) in enumerate(zip(row["actions"], expected, strict=False), 1):
            if found != action:
                raise refused(claim.file, row, f"step {step}: action {found} was recorded, {who} takes {action}")
        if row["steps"] != len(expected):
            raise refused(claim.file, row, f"{row['steps']} actions were recorded, {who} takes {len(expected)}")


def _check(file: Path, found: Any, expected: dict[str, Any], prefix: str = "") -> None:
    for field, value in expected.items():
        if not _same(getattr(found, field), value):
            raise ArtefactError(
                f"{file}: `{prefix}{field}` is {getattr(found, field)!r}, but {value!r} follows from the rest of the "
                "artefact; evaluate again"
            )


def _same(found: Any, expected: Any) -> bool:
    if isinstance(expected, float) or (isinstance(expected, list) and expected and isinstance(expected[0], float)):
        return np.shape(found) == np.shape(expected) and np.allclose(found, expected, rtol=0, atol=_TOLERANCE)
    return found == expected
