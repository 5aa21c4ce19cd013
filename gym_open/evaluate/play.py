"""Score a policy, or a uniformly random one, on the fixed test puzzles of a task."""

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
from gym_open.envs.puzzle_sets import puzzle_id, test_puzzles
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.metrics import a_success, mean_return_within
from gym_open.evaluate.proof import task_free_proof
from gym_open.seeding import generator

Actor = Callable[[np.ndarray], np.ndarray]
"""From images (B, 84, 84, 3) uint8 to action probabilities (B, 9)."""


class Episodes(msgspec.Struct, frozen=True):
    """What was played: row i of every array is test puzzle i.

    `actions` and `rewards` have shape (puzzles, N); behind an episode's end actions are −1 and rewards 0.
    """

    actions: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    terminated: np.ndarray


def evaluate(config: EvaluateConfig, policy: Path | None, out: Path) -> artefacts.Outcome:
    """Play the task's fixed test puzzles and write the scores.

    Payload: `scores.json` (A-Success, mean returns, proof) and `episodes.parquet` (a row a puzzle, with every action,
    so that each can be replayed).

    Args:
        config: task, way of choosing actions, seed.
        policy: a policy artefact, or None for uniformly random actions.
        out: folder of the scores.

    Raises:
        ArtefactError: if the policy is damaged or was trained for another task.
    """
    if policy is not None:
        artefacts.verify(policy, "policy")
        trained_for = artefacts.lineage(policy).facts.get("task")
        if trained_for != config.task:
            raise ArtefactError(f"{policy}: trained for task {trained_for!r}, not {config.task!r}; set `task` to match")

    def work(partial: Path) -> Mapping[str, Any]:
        actor = _uniform if policy is None else _load_actor(policy, config)
        puzzles = test_puzzles(config.task)
        episodes = play(actor, config.task, puzzles, config)
        scores = summarise(episodes)
        proof = task_free_proof(None if policy is None else artefacts.lineage(policy))
        agent = _agent(policy)
        record = {"agent": agent, "task": config.task, "actions": config.actions, **scores, "proof": proof}
        (partial / "scores.json").write_bytes(artefacts.canonical_json(record))
        ids = [puzzle_id(config.task, "test", i) for i in range(len(puzzles))]
        write_episodes(partial / "episodes.parquet", ids, puzzles, episodes)
        return {"task": config.task, "agent": agent, "puzzles": len(puzzles)}

    parents = [] if policy is None else [policy]
    return artefacts.build(out, kind="scores", config=config, parents=parents, work=work)


def play(actor: Actor, task: Task, puzzles: tuple[Puzzle, ...], config: EvaluateConfig) -> Episodes:
    """Play every puzzle once, all side by side; each has its own named generator, so that order does not matter."""
    N = step_budget(task)
    envs = [OpenEnv(task) for _ in puzzles]
    rngs = [generator(config.seed, "evaluate", task, i) for i in range(len(puzzles))]
    images = np.stack([env.reset(seed=0, options={"puzzle": p})[0] for env, p in zip(envs, puzzles, strict=True)])
    actions = np.full((len(puzzles), N), -1, dtype=np.int8)
    rewards = np.zeros((len(puzzles), N))
    steps = np.zeros(len(puzzles), dtype=np.int64)
    terminated = np.zeros(len(puzzles), dtype=bool)
    running = np.arange(len(puzzles))
    with progress.bar(f"evaluate {task}", len(puzzles)) as bar:
        for t in range(N):
            probabilities = actor(images[running])
            for i, p in zip(running, probabilities, strict=True):
                action = int(p.argmax()) if config.actions == "greedy" else _sample(p, rngs[i])
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
