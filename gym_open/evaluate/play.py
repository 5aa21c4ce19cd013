"""Score a policy, a uniformly random one, or the oracle, on the fixed puzzles of a task."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gym_open import artefacts, progress
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.puzzles.sets import published_digests, puzzle_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witness_name, witnesses_of
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.config import EvaluateConfig, OracleConfig
from gym_open.evaluate.metrics import a_success, mean_return_within
from gym_open.evaluate.proof import oracle_proof, task_free_proof
from gym_open.seeding import generator

Actor = Callable[[np.ndarray], np.ndarray]
"""From images (B, 84, 84, 3) uint8 to action probabilities (B, 9)."""
Choice = Callable[[int, np.ndarray, np.ndarray], Sequence[int]]
"""From the time step, the indices of the puzzles still played and their images to an action each."""


class Episodes(msgspec.Struct, frozen=True):
    """What was played: row i of every array is puzzle i.

    `actions` and `rewards` have shape (puzzles, N); behind an episode's end actions are −1 and rewards 0.
    """

    actions: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    terminated: np.ndarray


def evaluate(config: EvaluateConfig, policy: Path | None, out: Path, *, oracle: bool = False) -> artefacts.Outcome:
    """Play the fixed puzzles of a task and split and write the scores.

    Payload: `scores.json` (A-Success, mean returns, proof) and `episodes.parquet` (a row a puzzle, with every action,
    so that each can be replayed).

    Args:
        config: task, split, way of choosing actions, seed; of these the oracle takes task and split.
        policy: a policy artefact, or None for uniformly random actions.
        out: folder of the scores.
        oracle: replay the puzzles' witnesses instead of asking a policy.

    Raises:
        ArtefactError: if the policy is damaged or was trained for another task.
        UsageError: if both a policy and the oracle are asked for.
    """
    if oracle:
        if policy is not None:
            raise UsageError(f"evaluate: the oracle needs no policy, got {policy}; leave one of the two out")
        return _evaluate_oracle(config, out)
    if policy is not None:
        artefacts.verify(policy, "policy")
        trained_for = artefacts.lineage(policy).facts.get("task")
        if trained_for != config.task:
            raise ArtefactError(f"{policy}: trained for task {trained_for!r}, not {config.task!r}; set `task` to match")

    def work(partial: Path) -> Mapping[str, Any]:
        actor = _uniform if policy is None else _load_actor(policy, config)
        episodes = play(actor, config.task, puzzles_of(config.task, config.split), config)
        proof = task_free_proof(None if policy is None else artefacts.lineage(policy))
        who = {"agent": _agent(policy), "actions": config.actions, "proof": proof}
        return _write(partial, config, episodes, who)

    parents = [] if policy is None else [policy]
    return artefacts.build(out, kind="scores", config=config, parents=parents, work=work)


def _evaluate_oracle(config: EvaluateConfig, out: Path) -> artefacts.Outcome:
    digest = published_digests()[witness_name(config.task, config.split)]
    key = OracleConfig(task=config.task, split=config.split, witnesses=digest)

    def work(partial: Path) -> Mapping[str, Any]:
        witnesses = witnesses_of(config.task, config.split)
        episodes = replay(config.task, puzzles_of(config.task, config.split), [w.actions for w in witnesses])
        who = {"agent": "oracle", "actions": "witnesses", "proof": oracle_proof()}
        return _write(partial, config, episodes, who)

    return artefacts.build(out, kind="scores", config=key, parents=[], work=work)


def _write(folder: Path, config: EvaluateConfig, episodes: Episodes, who: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write the payload and return the facts; `who` is what the record says of the agent."""
    puzzles = puzzles_of(config.task, config.split)
    record = {"task": config.task, "split": config.split, **who, **summarise(episodes)}
    (folder / "scores.json").write_bytes(artefacts.canonical_json(record))
    ids = [puzzle_id(config.task, config.split, i) for i in range(len(puzzles))]
    write_episodes(folder / "episodes.parquet", ids, puzzles, episodes)
    return {"task": config.task, "split": config.split, "agent": who["agent"], "puzzles": len(puzzles)}


def play(actor: Actor, task: Task, puzzles: tuple[Puzzle, ...], config: EvaluateConfig) -> Episodes:
    """Play every puzzle once, all side by side; each has its own named generator, so that order does not matter."""
    rngs = [generator(config.seed, "evaluate", task, i) for i in range(len(puzzles))]

    def choose(_: int, running: np.ndarray, images: np.ndarray) -> list[int]:
        rows = zip(running, actor(images), strict=True)
        return [int(p.argmax()) if config.actions == "greedy" else _sample(p, rngs[i]) for i, p in rows]

    return _episodes(choose, task, puzzles)


def replay(task: Task, puzzles: tuple[Puzzle, ...], sequences: Sequence[Sequence[int]]) -> Episodes:
    """Play a given sequence of actions in every puzzle, and nothing (action 0) behind its end."""

    def choose(t: int, running: np.ndarray, _: np.ndarray) -> list[int]:
        return [sequences[i][t] if t < len(sequences[i]) else 0 for i in running]

    return _episodes(choose, task, puzzles)


def _episodes(choose: Choice, task: Task, puzzles: tuple[Puzzle, ...]) -> Episodes:
    N = step_budget(task)
    envs = [OpenEnv(task) for _ in puzzles]
    images = np.stack([env.reset(seed=0, options={"puzzle": p})[0] for env, p in zip(envs, puzzles, strict=True)])
    actions = np.full((len(puzzles), N), -1, dtype=np.int8)
    rewards = np.zeros((len(puzzles), N))
    steps = np.zeros(len(puzzles), dtype=np.int64)
    terminated = np.zeros(len(puzzles), dtype=bool)
    running = np.arange(len(puzzles))
    with progress.bar(f"evaluate {task}", len(puzzles)) as bar:
        for t in range(N):
            for i, action in zip(running, choose(t, running, images[running]), strict=True):
                images[i], rewards[i, t], terminated[i], truncated, _ = envs[i].step(action)
                actions[i, t], steps[i] = action, t + 1
                if terminated[i] or truncated:
                    bar.advance()
            running = running[~terminated[running]]
            if not running.size:
                break
    return Episodes(actions=actions, rewards=rewards, steps=steps, terminated=terminated)


def summarise(episodes: Episodes) -> dict[str, Any]:
    """Scores of played episodes, with the half-width of a 95% normal interval over puzzles.

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


def _agent(policy: Path | None) -> str:
    if policy is None:
        return "random"
    return "PPO from encoder" if artefacts.lineage(policy).parents else "PPO from scratch"


def _uniform(images: np.ndarray) -> np.ndarray:
    return np.full((len(images), N_ACTIONS), 1 / N_ACTIONS)


def _load_actor(policy: Path, config: EvaluateConfig) -> Actor:
    import torch

    from gym_open.formats.models import load_policy

    torch.set_num_threads(config.threads)
    network = load_policy(policy).eval()

    @torch.inference_mode()
    def probabilities(images: np.ndarray) -> np.ndarray:
        logits, _ = network(network.encoder.prepare(torch.from_numpy(images)))
        return torch.softmax(logits.double(), dim=1).numpy()

    return probabilities


def _sample(probabilities: np.ndarray, rng: np.random.Generator) -> int:
    edges = np.cumsum(probabilities)
    return min(int(np.searchsorted(edges, rng.random() * edges[-1], side="right")), len(edges) - 1)


def write_episodes(path: Path, ids: Sequence[str], puzzles: Sequence[Puzzle], episodes: Episodes) -> None:
    """Write a row a puzzle, with every action and reward."""
    lengths = episodes.steps.tolist()
    table = pa.table(
        {
            "puzzle": list(ids),
            "digest": [puzzle.digest for puzzle in puzzles],
            "a_success": [a_success(np.cumsum(row)) for row in episodes.rewards],
            "return": episodes.rewards.sum(axis=1),
            "steps": episodes.steps,
            "terminated": episodes.terminated,
            "actions": [row[:n].tolist() for row, n in zip(episodes.actions, lengths, strict=True)],
            "rewards": [row[:n].tolist() for row, n in zip(episodes.rewards, lengths, strict=True)],
        }
    )
    pq.write_table(table, path)
