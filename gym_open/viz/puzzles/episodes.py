"""Episodes on one puzzle: as scores recorded them, as a policy plays now, and as the witness solves the puzzle."""

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
"""Root seed of the actions that a policy draws here, as in an evaluation with default settings."""
THREADS = 2
"""Threads of torch, as in an evaluation with default settings."""


class PolicyOutput(msgspec.Struct, frozen=True, eq=False):
    """What a policy computed at every step of an episode of T actions."""

    probabilities: np.ndarray
    """Action probabilities, shape (T, 9), float64."""
    values: np.ndarray
    """Expected return, shape (T,), float32."""

    @property
    def entropy(self) -> np.ndarray:
        """Entropy of the action probabilities in nats, shape (T,)."""
        p = self.probabilities
        return -np.sum(p * np.log(np.maximum(p, np.finfo(float).tiny)), axis=1)


class PuzzleEpisode(msgspec.Struct, frozen=True, eq=False):
    """An agent's episode on one puzzle: T actions and T + 1 observations."""

    name: str
    """Name of the player, printable."""
    actions: list[int]
    rewards: list[float]
    terminated: bool
    """Whether the task ended the episode; otherwise the step budget did."""
    objects: tuple[str, ...]
    """All objects of the world, including those that this puzzle does not use."""
    present: tuple[str, ...]
    """Objects on the table."""
    states: np.ndarray
    """Object states, shape (T + 1, objects, 13), float64."""
    images: np.ndarray
    """Observations, shape (T + 1, 84, 84, 3), uint8."""
    contacts: list[tuple[Contact, ...]]
    """Contacts, per action."""
    touched: list[tuple[str, ...]]
    """Goals that were touched for the first time, per action."""
    in_danger: bool
    """Whether the last action led into the danger patch."""
    policy: PolicyOutput | None = None
    """Only if the weights of the policy were given."""

    @property
    def steps(self) -> int:
        """T."""
        return len(self.actions)

    @property
    def returns(self) -> np.ndarray:
        """Return within 0…T actions, shape (T + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.rewards)])

    @property
    def outcome(self) -> str:
        """How the episode ended, in words."""
        earned = f", return {self.returns[-1]:g}" if self.returns[-1] else ""
        if self.in_danger:
            return f"in the danger patch at action {self.steps}{earned}"
        if self.terminated:
            return f"solved in {self.steps} action{'s' * (self.steps != 1)}"
        return f"not solved in {self.steps} actions{earned}"


class PlayedPuzzle(msgspec.Struct, frozen=True, eq=False):
    """A fixed puzzle and the episodes on it; the last is the witness's solution."""

    id: str
    puzzle: Puzzle
    episodes: list[PuzzleEpisode]


class _EpisodeRecorder:
    """Collects an episode step by step."""

    def __init__(self, judge: PolicyFunction | None = None, *, states: bool = False) -> None:
        self._judge, self._of_states = judge, states
        self.images: list[np.ndarray] = []
        self.infos: list[dict[str, Any]] = []
        self.outputs: list[tuple[np.ndarray, np.ndarray]] = []
        self.objects: tuple[str, ...] = ()
        self.present: tuple[str, ...] = ()

    def see(self, env: OpenEnv, image: np.ndarray, info: dict[str, Any]) -> None:
        """Keep the present state; an `Observer` of a replay."""
        self.objects = env.world.inventory
        self.present = tuple(np.array(self.objects)[env.world.present].tolist())
        self.images.append(image)
        self.infos.append(info)
        if self._judge:
            self.outputs.append(self._judge((state_vector(env.world) if self._of_states else image)[None]))

    def episode(self, name: str, actions: list[int], rewards: list[float], *, terminated: bool) -> PuzzleEpisode:
        """Return what was kept as an episode."""
        policy = None
        if self.outputs:
            probabilities, values = (np.concatenate(each[:-1]) for each in zip(*self.outputs, strict=True))
            policy = PolicyOutput(probabilities, values)
        steps = self.infos[1:]
        return PuzzleEpisode(
            name=name, actions=actions, rewards=rewards, terminated=terminated, objects=self.objects,
            present=self.present, images=np.stack(self.images),
            states=np.stack([info["object_state"] for info in self.infos]),
            contacts=[info["contacts"] for info in steps], touched=[info["hits"] for info in steps],
            in_danger=terminated and steps[-1]["in_danger"], policy=policy,
        )  # fmt: skip


def play_all(puzzle: str, sources: Sequence[Path]) -> PlayedPuzzle:
    """Return the episodes of all sources on one puzzle, and the witness's solution.

    Scores are replayed, and the rewards are compared with the recorded ones. A policy plays with actions drawn as in an
    evaluation with default settings. If scores of the same policy are among the sources, the policy does not play;
    instead, its output during the replayed episode is shown.

    Args:
        puzzle: its id, such as `tool-use/017`.
        sources: scores and policy artefacts.

    Raises:
        PuzzleError: if no fixed puzzle has this id.
        ArtefactError: if a source is damaged, of another kind or task, or its replay differs.
        UsageError: if there is no source.
    """
    layout = puzzle_by_id(puzzle)
    if not sources:
        raise UsageError(f"{puzzle}: no source plays it; give scores or policies")
    kinds = {source: _kind(source) for source in sources}
    policies = {artefacts.verify(each, "policy"): each for each, kind in kinds.items() if kind == "policy"}
    scored = {each: read_scores(each) for each, kind in kinds.items() if kind == "scores"}
    with_scores = {record.policy for record in scored.values()}
    players = {each: scored.get(each) for each in kinds if each in scored or artefacts.digest(each) not in with_scores}
    episodes = list[PuzzleEpisode]()
    for source, name in distinct_names(players).items():
        if record := scored.get(source):
            policy = policies.get(record.policy or "")
            folder = policy and _scored_folder(policy, source, record.trained)
            episodes.append(_replayed(name, source, puzzle, folder))
        else:
            episodes.append(_by_policy(name, source, puzzle, layout))
    if all(record.agent != "oracle" for record in scored.values()):
        episodes.append(_by_witness(puzzle, layout))
    return PlayedPuzzle(puzzle, layout, episodes)


def _kind(source: Path) -> str:
    kind = artefacts.lineage(source).kind
    if kind not in {"scores", "policy"}:
        raise ArtefactError(f"{source}: a {kind}, which plays no puzzle of the evaluation; give scores or a policy")
    return kind


def _scored_folder(policy: Path, scores: Path, trained: int) -> Path:
    """Return the folder of the policy as it was scored: the end of the training, or a checkpoint."""
    from gym_open.formats.models import policy_folder

    return policy_folder(policy, trained) if "at" in artefacts.config_of(scores) else policy


def _replayed(name: str, scores: Path, puzzle: str, policy: Path | None) -> PuzzleEpisode:
    judge, states = load_policy_function(policy, THREADS) if policy else (None, False)
    seen = _EpisodeRecorder(judge, states=states)
    replay = replay_puzzle(scores, puzzle, seen.see)
    return seen.episode(name, replay.actions, replay.rewards, terminated=replay.terminated)


def _by_policy(name: str, policy: Path, puzzle: str, layout: Puzzle) -> PuzzleEpisode:
    trained_for = artefacts.lineage(policy).facts.get("task")
    if trained_for != layout.task:
        raise ArtefactError(f"{policy}: trained for task {trained_for!r}, but {puzzle} is one of {layout.task}")
    judge, states = load_policy_function(policy, THREADS)
    seen, rng = _EpisodeRecorder(judge, states=states), action_generator(SEED, layout.task, locate(puzzle)[2])
    return _play(name, layout, seen, lambda _: draw_action(seen.outputs[-1][0][0], rng))


def _by_witness(puzzle: str, layout: Puzzle) -> PuzzleEpisode:
    actions = witness_of(puzzle).actions
    return _play(WITNESS, layout, _EpisodeRecorder(), lambda step: actions[step])


def _play(name: str, puzzle: Puzzle, seen: _EpisodeRecorder, choose: Callable[[int], int]) -> PuzzleEpisode:
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
