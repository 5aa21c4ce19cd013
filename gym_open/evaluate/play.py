"""Score a policy, the random agent or the oracle on the fixed puzzles of a task."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from gym_open import artefacts, progress
from gym_open.artefacts import Parent
from gym_open.config import to_dict
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.fleet import Fleet
from gym_open.envs.options import WorldOptions
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.puzzles.sets import published_digests, puzzle_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witness_name, witnesses_of
from gym_open.envs.state import state_vector
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.config import CheckpointConfig, EvaluateConfig, OracleConfig
from gym_open.evaluate.proof import oracle_proof, task_free_proof
from gym_open.evaluate.scores import Episodes, summarise, write_episodes, write_scores
from gym_open.formats.scores import Proof, Scores
from gym_open.hardware import hardware
from gym_open.precision import Precision
from gym_open.replay.policy import action_generator, draw_action, load_policy_function
from gym_open.results.runs import PolicyFacts, policy_facts

Actor = Callable[[np.ndarray], np.ndarray]
"""From images (B, 84, 84, 3) uint8, or states (B, `STATE_SIZE`) float32, to action probabilities (B, 9)."""
ChooseActions = Callable[[int, np.ndarray, np.ndarray], Sequence[int]]
"""From the time step, the indices of the running puzzles and their observations to an action for each."""

_TURNS = 4
"""Parts per thread into which the worlds of a step are divided, so that all threads finish at the same time."""


class _PlayerRecord(NamedTuple):
    """The player, as `scores.json` records it."""

    agent: str
    seed: int | None
    evaluation_seed: int | None
    trained: int
    actions: Literal["sampled", "greedy", "witnesses"]
    policy: str | None
    proof: Proof
    precision: Precision | None = None


def evaluate(
    config: EvaluateConfig, policy: Path | None, out: Path, *, oracle: bool = False, at: int | None = None
) -> artefacts.Outcome:
    """Play the fixed puzzles of a task and split and write the scores.

    Payload: `scores.json` (who played, A-Success, mean returns, proof) and `episodes.parquet` (a row per
    puzzle, with every action, so that each episode can be replayed).

    Args:
        config: task, split, way of choosing actions, seed; the oracle uses only task and split.
        policy: a policy artefact, or None for uniformly random actions.
        out: folder of the scores.
        oracle: replay the puzzles' witnesses instead of using a policy.
        at: score this checkpoint of the policy, in agent steps as in its configuration; None scores the end of the
            training.

    Raises:
        ArtefactError: if the policy is damaged or was trained for another task.
        UsageError: if both a policy and the oracle are given, the policy has no such checkpoint, or greedy actions are
            asked for without a policy.
    """
    if at is not None and policy is None:
        raise UsageError(f"evaluate: --at {at} is a checkpoint of a policy, and there is no policy; give --policy")
    if oracle:
        if policy is not None:
            raise UsageError(f"evaluate: the oracle needs no policy, got {policy}; omit one of the two")
        return _evaluate_oracle(config, out)
    if policy is None:
        if config.actions == "greedy":
            raise UsageError(
                "evaluate: `actions` greedy takes a policy's most likely actions, and there is no policy; give "
                "--policy, or --actions sampled for uniformly random actions"
            )
        return _evaluate_random(config, out)
    return _evaluate_policy(config, policy, out, at)


def _evaluate_policy(config: EvaluateConfig, policy: Path, out: Path, at: int | None) -> artefacts.Outcome:
    from gym_open.formats.models import policy_folder

    link = Parent(
        digest=artefacts.verify(policy, "policy"),
        manifest=artefacts.manifest(policy),
        lineage=artefacts.lineage(policy),
    )
    facts = policy_facts(link, policy)
    if facts.task != config.task:
        raise ArtefactError(f"{policy}: trained for task {facts.task!r}, not {config.task!r}; give --task {facts.task}")
    folder, trained = policy, facts.steps
    if at is not None:
        trained = _step(policy, facts, at)
        folder = policy_folder(policy, trained)

    def work(partial: Path) -> Mapping[str, Any]:
        actor, states = load_actor(folder, config)
        episodes = play(actor, config.task, puzzles_of(config.task, config.split), config, states=states)
        player = _PlayerRecord(
            facts.agent, facts.seed, config.seed, trained, config.actions, link.digest, task_free_proof(link),
            facts.precision,
        )  # fmt: skip
        return _write(partial, config, episodes, player, threads=config.threads)

    key = config if at is None else CheckpointConfig(**to_dict(config), at=at)
    return artefacts.build(out, kind="scores", config=key, parents=[policy], work=work)


def _step(policy: Path, facts: PolicyFacts, at: int) -> int:
    """Return the agent steps of the checkpoint that was asked for."""
    step = facts.steps_at(at)
    if step is None:
        there = ", ".join(f"{checkpoint.asked}" for checkpoint in facts.checkpoints) or "none"
        raise UsageError(
            f"{policy}: no checkpoint at {at} steps; there are: {there}; the end of the training, after "
            f"{facts.steps} steps, is scored without --at"
        )
    return step


def _evaluate_random(config: EvaluateConfig, out: Path) -> artefacts.Outcome:
    def work(partial: Path) -> Mapping[str, Any]:
        episodes = play(uniform, config.task, puzzles_of(config.task, config.split), config)
        player = _PlayerRecord("random", config.seed, config.seed, 0, config.actions, None, task_free_proof(None))
        return _write(partial, config, episodes, player, threads=config.threads)

    return artefacts.build(out, kind="scores", config=config, parents=[], work=work)


def _evaluate_oracle(config: EvaluateConfig, out: Path) -> artefacts.Outcome:
    digest = published_digests()[witness_name(config.task, config.split)]
    key = OracleConfig(task=config.task, split=config.split, witnesses=digest)

    def work(partial: Path) -> Mapping[str, Any]:
        witnesses = witnesses_of(config.task, config.split)
        puzzles = puzzles_of(config.task, config.split)
        episodes = replay(config.task, puzzles, [w.actions for w in witnesses])
        player = _PlayerRecord("oracle", None, None, 0, "witnesses", None, oracle_proof())
        return _write(partial, config, episodes, player, threads=1)

    return artefacts.build(out, kind="scores", config=key, parents=[], work=work)


def _write(
    folder: Path, config: EvaluateConfig, episodes: Episodes, player: _PlayerRecord, *, threads: int
) -> Mapping[str, Any]:
    """Write the payload and return the facts of the lineage."""
    puzzles = puzzles_of(config.task, config.split)
    record = Scores(
        task=config.task,
        split=config.split,
        code=artefacts.code_version("scores"),
        hardware=hardware(threads),
        **player._asdict(),
        **summarise(episodes),
    )
    write_scores(folder, record)
    ids = [puzzle_id(config.task, config.split, i) for i in range(len(puzzles))]
    write_episodes(folder, ids, puzzles, episodes)
    return {"task": config.task, "split": config.split, "agent": player.agent, "puzzles": len(puzzles)}


def play(
    actor: Actor, task: Task, puzzles: tuple[Puzzle, ...], config: EvaluateConfig, *, states: bool = False,
    world: WorldOptions | None = None,
) -> Episodes:  # fmt: skip
    """Play every puzzle once, all at the same time; each has its own named generator, so order does not matter.

    Args:
        actor: gives the action probabilities.
        task: sets the rewards.
        puzzles: the puzzles.
        config: way of choosing actions, seed, threads.
        states: give the actor the simulator states instead of images.
        world: options of the worlds, for studies; scores are of the published world, None.
    """
    choose = chooser(actor, task, len(puzzles), config)
    return _episodes(choose, task, puzzles, threads=config.threads, states=states, world=world)


def chooser(actor: Actor, task: Task, n: int, config: EvaluateConfig) -> ChooseActions:
    """Return a function that turns the actor's probabilities into the actions in n puzzles."""
    rngs = [action_generator(config.seed, task, i) for i in range(n)]

    def choose(_: int, running: np.ndarray, seen: np.ndarray) -> list[int]:
        rows = zip(running, actor(seen), strict=True)
        return [int(p.argmax()) if config.actions == "greedy" else draw_action(p, rngs[i]) for i, p in rows]

    return choose


def replay(task: Task, puzzles: tuple[Puzzle, ...], sequences: Sequence[Sequence[int]]) -> Episodes:
    """Play a given sequence of actions in every puzzle, and action 0 (no move) after its end."""

    def choose(t: int, running: np.ndarray, _: np.ndarray) -> list[int]:
        return [sequences[i][t] if t < len(sequences[i]) else 0 for i in running]

    return _episodes(choose, task, puzzles, threads=1)


def _episodes(
    choose: ChooseActions, task: Task, puzzles: tuple[Puzzle, ...], *, threads: int, states: bool = False,
    world: WorldOptions | None = None,
) -> Episodes:  # fmt: skip
    """Play until all episodes have ended; the world of an ended episode is neither stepped nor drawn."""
    n, N = len(puzzles), step_budget(task)
    with progress.doing("preparing the puzzles", progress.COMPILES):
        envs = [OpenEnv(task, world=world) for _ in puzzles]
        images = np.stack([env.reset(seed=0, options={"puzzle": p})[0] for env, p in zip(envs, puzzles, strict=True)])
    actions = np.full((n, N), -1, dtype=np.int8)
    rewards = np.zeros((n, N))
    steps = np.zeros(n, dtype=np.int64)
    terminated, running = np.zeros(n, dtype=bool), np.arange(n)
    fleet = Fleet([env.world for env in envs])
    with ExitStack() as stack:
        bar = stack.enter_context(progress.bar(f"evaluate {task}", n * N))
        pool = stack.enter_context(ThreadPoolExecutor(threads))
        for t in range(N):
            seen = np.stack([state_vector(envs[i].world) for i in running]) if states else images[running]
            chosen = np.full(n, -1)
            chosen[running] = choose(t, running, seen)
            parts = [pool.submit(fleet.step, *ends, chosen, images) for ends in _shares(running, threads)]
            for part in parts:
                part.result()
            for i in running:
                rewards[i, t], terminated[i], _ = envs[i].score(envs[i].world.stepper.outcome())
                actions[i, t], steps[i] = chosen[i], t + 1
                bar.advance(N - t if terminated[i] else 1)
            running = running[~terminated[running]]
            if not running.size:
                break
    return Episodes(actions=actions, rewards=rewards, steps=steps, terminated=terminated)


def _shares(running: np.ndarray, threads: int) -> list[tuple[int, int]]:
    """Divide the running worlds into parts for threads; return the first world and the last + 1 of each part."""
    parts = np.array_split(running, threads * _TURNS) if threads > 1 else [running]
    return [(int(part[0]), int(part[-1]) + 1) for part in parts if part.size]


def uniform(images: np.ndarray) -> np.ndarray:
    """Return the random agent's probabilities: all actions are equally likely."""
    return np.full((len(images), N_ACTIONS), 1 / N_ACTIONS)


def load_actor(folder: Path, config: EvaluateConfig) -> tuple[Actor, bool]:
    """Return the policy in a folder, and whether it sees the simulator state instead of images."""
    judge, states = load_policy_function(folder, config.threads)
    return lambda seen: judge(seen)[0], states
