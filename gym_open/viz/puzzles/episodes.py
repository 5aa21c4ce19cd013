"""One puzzle, played: as scores recorded it, by a policy itself, and as its witness solves it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.envs.env import OpenEnv
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import locate, puzzle_by_id
from gym_open.envs.puzzles.witnesses import witness_of
from gym_open.envs.state import state_vector
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.scores import read_scores
from gym_open.replay.episodes import replay_puzzle
from gym_open.replay.policy import PolicyFunction, action_generator, draw_action, load_policy_function
from gym_open.results.names import distinct_names

WITNESS = "witness"
SEED = 0
"""Root seed of the actions that a policy draws here: that of an evaluation with default settings."""
THREADS = 2
"""Torch's, as in an evaluation with default settings."""


class Opinion(msgspec.Struct, frozen=True, eq=False):
    """What a policy made of every moment of an episode."""

    probabilities: np.ndarray
    """(T, 9) float64."""
    values: np.ndarray
    """(T,) float32: the return that it expected."""

    @property
    def entropy(self) -> np.ndarray:
        """(T,) nats."""
        p = self.probabilities
        return -np.sum(p * np.log(np.maximum(p, np.finfo(float).tiny)), axis=1)


class Episode(msgspec.Struct, frozen=True, eq=False):
    """T actions, and T + 1 moments."""

    name: str
    """Of who played, printable."""
    actions: list[int]
    rewards: list[float]
    terminated: bool
    """Whether the task ended it, or its budget did."""
    objects: tuple[str, ...]
    """Of the world, those included that this puzzle does not use."""
    present: tuple[str, ...]
    """Those that are on the table."""
    states: np.ndarray
    """(T + 1, objects, 13) float64."""
    images: np.ndarray
    """(T + 1, 84, 84, 3) uint8."""
    contacts: list[tuple[Contact, ...]]
    """Of each action."""
    touched: list[tuple[str, ...]]
    """Goals that each action touched for the first time."""
    in_danger: bool
    """Whether the last action led into the danger patch."""
    opinion: Opinion | None = None
    """Of a policy whose weights were given."""

    @property
    def steps(self) -> int:
        """T."""
        return len(self.actions)

    @property
    def returns(self) -> np.ndarray:
        """(T + 1,): rewards within 0…T actions."""
        return np.concatenate([[0.0], np.cumsum(self.rewards)])

    @property
    def outcome(self) -> str:
        """How it ended, in words."""
        earned = f", return {self.returns[-1]:g}" if self.returns[-1] else ""
        if self.in_danger:
            return f"in the danger patch at action {self.steps}{earned}"
        if self.terminated:
            return f"solved in {self.steps} action{'s' * (self.steps != 1)}"
        return f"not solved in {self.steps} actions{earned}"


class Puzzled(msgspec.Struct, frozen=True, eq=False):
    """A fixed puzzle and what was done with it; the witness's solution is the last."""

    id: str
    puzzle: Puzzle
    episodes: list[Episode]


class _Witnessed:
    """Keeps what there is to see of an episode, moment by moment."""

    def __init__(self, judge: PolicyFunction | None = None, *, states: bool = False) -> None:
        self._judge, self._of_states = judge, states
        self.images: list[np.ndarray] = []
        self.infos: list[dict[str, Any]] = []
        self.opinions: list[tuple[np.ndarray, np.ndarray]] = []
        self.objects: tuple[str, ...] = ()
        self.present: tuple[str, ...] = ()

    def see(self, env: OpenEnv, image: np.ndarray, info: dict[str, Any]) -> None:
        """Keep this moment."""
        self.objects = env.world.inventory
        self.present = tuple(np.array(self.objects)[env.world.present].tolist())
        self.images.append(image)
        self.infos.append(info)
        if self._judge:
            self.opinions.append(self._judge((state_vector(env.world) if self._of_states else image)[None]))

    def episode(self, name: str, actions: list[int], rewards: list[float], *, terminated: bool) -> Episode:
        """All that was kept."""
        opinion = None
        if self.opinions:
            probabilities, values = (np.concatenate(each[:-1]) for each in zip(*self.opinions, strict=True))
            opinion = Opinion(probabilities, values)
        steps = self.infos[1:]
        return Episode(
            name=name, actions=actions, rewards=rewards, terminated=terminated, objects=self.objects,
            present=self.present, images=np.stack(self.images),
            states=np.stack([info["object_state"] for info in self.infos]),
            contacts=[info["contacts"] for info in steps], touched=[info["hits"] for info in steps],
            in_danger=terminated and steps[-1]["in_danger"], opinion=opinion,
        )  # fmt: skip


def play_all(puzzle: str, sources: Sequence[Path]) -> Puzzled:
    """What all sources do with one puzzle, and its witness.

    Scores are replayed, each action held against what was recorded. A policy plays, its actions drawn as an evaluation
    with default settings draws them; where the scores of the same policy are among the sources, it tells what it made
    of their episode instead.

    Args:
        puzzle: its id, such as `tool-use/017`.
        sources: scores and policy artefacts.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if a source is damaged, of another kind or task, or its episode does not come out again.
        UsageError: if there is no source.
    """
    layout = puzzle_by_id(puzzle)
    if not sources:
        raise UsageError(f"{puzzle}: nobody to play it; give scores or policies")
    kinds = {source: _kind(source) for source in sources}
    policies = {artefacts.verify(each, "policy"): each for each, kind in kinds.items() if kind == "policy"}
    scored = {each: read_scores(each) for each, kind in kinds.items() if kind == "scores"}
    told = {record.policy for record in scored.values()}
    players = {each: scored.get(each) for each in kinds if each in scored or artefacts.digest(each) not in told}
    episodes = list[Episode]()
    for source, name in distinct_names(players).items():
        if record := scored.get(source):
            policy = policies.get(record.policy or "")
            folder = policy and _scored_folder(policy, source, record.trained)
            episodes.append(_replayed(name, source, puzzle, folder))
        else:
            episodes.append(_by_policy(name, source, puzzle, layout))
    if all(record.agent != "oracle" for record in scored.values()):
        episodes.append(_by_witness(puzzle, layout))
    return Puzzled(puzzle, layout, episodes)


def _kind(source: Path) -> str:
    kind = artefacts.lineage(source).kind
    if kind not in {"scores", "policy"}:
        raise ArtefactError(f"{source}: a {kind}, which plays no puzzle of the evaluation; give scores or a policy")
    return kind


def _scored_folder(policy: Path, scores: Path, trained: int) -> Path:
    """Where the policy is as it was scored: its end, or a checkpoint."""
    from gym_open.formats.models import policy_folder

    return policy_folder(policy, trained) if "at" in artefacts.config_of(scores) else policy


def _replayed(name: str, scores: Path, puzzle: str, policy: Path | None) -> Episode:
    judge, states = load_policy_function(policy, THREADS) if policy else (None, False)
    seen = _Witnessed(judge, states=states)
    replay = replay_puzzle(scores, puzzle, seen.see)
    return seen.episode(name, replay.actions, replay.rewards, terminated=replay.terminated)


def _by_policy(name: str, policy: Path, puzzle: str, layout: Puzzle) -> Episode:
    trained_for = artefacts.lineage(policy).facts.get("task")
    if trained_for != layout.task:
        raise ArtefactError(f"{policy}: trained for task {trained_for!r}, but {puzzle} is one of {layout.task}")
    judge, states = load_policy_function(policy, THREADS)
    seen, rng = _Witnessed(judge, states=states), action_generator(SEED, layout.task, locate(puzzle)[2])
    return _play(name, layout, seen, lambda _: draw_action(seen.opinions[-1][0][0], rng))


def _by_witness(puzzle: str, layout: Puzzle) -> Episode:
    actions = witness_of(puzzle).actions
    return _play(WITNESS, layout, _Witnessed(), lambda step: actions[step])


def _play(name: str, puzzle: Puzzle, seen: _Witnessed, choose: Callable[[int], int]) -> Episode:
    env = OpenEnv(puzzle.task)
    seen.see(env, *env.reset(seed=0, options={"puzzle": puzzle}))
    actions, rewards = list[int](), list[float]()
    for step in range(step_budget(puzzle.task)):
        actions.append(choose(step))
        image, reward, terminated, truncated, info = env.step(actions[-1])
        seen.see(env, image, info)
        rewards.append(reward)
        if terminated or truncated:
            return seen.episode(name, actions, rewards, terminated=terminated)
    raise AssertionError("an episode ends with its budget")
