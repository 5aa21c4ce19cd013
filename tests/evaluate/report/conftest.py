"""Hand-made scores of agents with known skill: like a real grid, without a simulator."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open import artefacts
from gym_open.artefacts import Parent
from gym_open.config import Config
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.puzzles.sets import puzzle_id, puzzles_of
from gym_open.evaluate.proof import oracle_proof, task_free_proof
from gym_open.evaluate.scores import Episodes, summarise, write_episodes, write_scores
from gym_open.formats.scores import Proof, Scores

HARDWARE: dict[str, str | int] = {"processor": "An Abacus", "cores": 2, "threads": 1, "device": "cpu"}
N = {"goal-seeking": 100, "preferences": 100, "avoidance": 100, "tool-use": 200}


class Made(Config, frozen=True):
    """Stands for any stage's configuration."""

    name: str
    seed: int = 0
    task: str = ""
    agent: str = ""
    threads: int = 1
    checkpoints: tuple[int, ...] = ()
    ppo: dict[str, float] = msgspec.field(default_factory=lambda: {"lr": 0.01})


class MadeAt(Made, frozen=True, kw_only=True):
    """Configuration of scores at a checkpoint."""

    at: int


def artefact(
    out: Path, kind: str, parents: Sequence[Path], facts: Mapping[str, Any], config: Config, *files: str
) -> Path:
    def work(folder: Path) -> Mapping[str, Any]:
        for file in files:
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(kind)
        return facts

    return artefacts.build(out, kind=kind, config=config, parents=parents, work=work).path


def make_policy(
    root: Path,
    agent: str,
    task: str,
    seed: int,
    steps: int,
    *,
    log_task: str = "sandbox",
    name: str = "",
    changes: Mapping[str, Mapping[str, Any]] | None = None,
) -> Path:
    """Make a policy with records as `gym-open` writes them; with a `+` in the agent's name, the whole chain to a log.

    `changes` change the facts of the policy (`facts`), or the configuration of an artefact, by its kind.
    """

    def config(kind: str, **usual: Any) -> Made:
        return Made(**{**usual, **(changes or {}).get(kind, {})})

    parents = []
    if "+" in agent:
        facts = {"task": log_task, "extrinsic_reward": False, "puzzles": ["0" * 64]}
        log = artefact(
            root / agent / f"log-{seed}",
            "log",
            [],
            facts,
            config("log", name=agent, seed=seed),
            "stream-000-000.mcap",
            "summary.json",
        )
        release = artefact(
            root / agent / f"release-{seed}",
            "release",
            [log],
            {"logs": [artefacts.digest(log)]},
            config("release", name=agent),
            "meta/info.json",
        )
        model = ("model.safetensors", "model.json")
        taught = config("encoder", name=agent, seed=seed)
        parents = [artefact(root / agent / f"encoder-{seed}", "encoder", [release], {}, taught, *model)]
    facts = {
        "task": task, "agent": name or agent, "seed": seed, "steps": steps,
        "checkpoints": [{"asked": n, "step": n} for n in (400, 500, 200_704, 503_808)], "from_encoder": bool(parents),
        "encoder": "offline" if parents else "none", "frozen": False, "hardware": HARDWARE,
        **(changes or {}).get("facts", {}),
    }  # fmt: skip
    learner = config("policy", name="ppo", seed=seed, task=task, agent=agent)
    return artefact(
        root / agent / f"policy-{task}-{seed}", "policy", parents, facts, learner, "model.safetensors", "model.json"
    )


def episodes_of(task: str, skill: float, seed: int, puzzles: int) -> Episodes:
    """Solve every puzzle with probability `skill`, at a uniformly random step."""
    rng, budget = np.random.default_rng(seed), N[task]
    solved = rng.uniform(size=puzzles) < skill
    steps = np.where(solved, rng.integers(1, budget // 2 + 1, puzzles), budget)
    rewards = np.zeros((puzzles, budget))
    rewards[solved, steps[solved] - 1] = 1.0
    return Episodes(actions=np.ones((puzzles, budget), np.int8), rewards=rewards, steps=steps, terminated=solved)


def write_run(
    out: Path, *, agent: str, task: Task = "goal-seeking", seed: int | None = 0, trained: int = 0, skill: float = 0.5,
    policy: Path | None = None, actions: str = "sampled", split: Any = "test", puzzles: int = 100,
    draw: int | None = None,
    facts: Mapping[str, Any] | None = None, change: Mapping[str, Any] | None = None,
) -> Path:  # fmt: skip
    """Write scores, of a checkpoint if the policy was trained for longer; `change` changes fields of scores.json."""
    at = trained if policy and trained != artefacts.lineage(policy).facts["steps"] else None
    proof = oracle_proof() if agent == "oracle" else task_free_proof(policy and link(policy))
    if agent == "human":
        proof = Proof(verdict="no encoder", reasons=["a person played"], chain=[])
    drawn = episodes_of(task, skill, draw if draw is not None else hash_of(agent, task, seed, trained), puzzles)
    who = {
        "task": task, "split": split, "agent": agent, "seed": seed, "evaluation_seed": 0, "trained": trained,
        "actions": actions, "policy": artefacts.digest(policy) if policy else None, "proof": proof,
        "code": "0.1.0+test", "hardware": HARDWARE, **summarise(drawn),
    }  # fmt: skip

    def work(folder: Path) -> Mapping[str, Any]:
        write_scores(folder, Scores(**who), change)
        own: tuple[Puzzle, ...] = puzzles_of(task, split)[:puzzles]
        write_episodes(folder, [puzzle_id(task, split, i) for i in range(puzzles)], own, drawn)
        return {"task": task, "split": split, "agent": agent, **(facts or {})}

    values = {"name": f"{agent}-{actions}-{draw}-{sorted((change or {}).items())}", "seed": seed or 0, "task": task}
    config = Made(**values) if at is None else MadeAt(**values, at=at)
    return artefacts.build(out, kind="scores", config=config, parents=[policy] if policy else [], work=work).path


def link(folder: Path) -> Parent:
    return Parent(artefacts.digest(folder), artefacts.manifest(folder), artefacts.lineage(folder))


def hash_of(*names: Any) -> int:
    from gym_open import seeding

    return seeding.integer(0, *map(str, names))


def make_grid(
    root: Path, agents: Sequence[str], tasks: Sequence[Task], seeds: Sequence[int], *,
    lengths: Sequence[int] = (200_704, 1_003_520), skills: Mapping[str, float] | None = None,
) -> Path:  # fmt: skip
    """Scores of every agent, task, seed and length below `root/scores`, and their policies below `root/made`."""
    for task in tasks:
        for agent in agents:
            for seed in seeds:
                policy = make_policy(root / "made", agent, task, seed, lengths[-1])
                for i, trained in enumerate(lengths):
                    skill = (skills or {}).get(agent, 0.6) * (i + 1) / len(lengths)
                    write_run(
                        root / "scores" / agent / f"{task}-{seed}-{trained}", agent=agent, task=task, seed=seed,
                        trained=trained, skill=skill, policy=policy,
                    )  # fmt: skip
        write_run(root / "scores" / f"random-{task}", agent="random", task=task, skill=0.1)
        write_run(
            root / "scores" / f"oracle-{task}", agent="oracle", task=task, skill=1.0, seed=None, actions="witnesses"
        )
    return root


@pytest.fixture(scope="session")
def make_run() -> Callable[..., Path]:
    """`write_run`: a scores artefact."""
    return write_run


@pytest.fixture(scope="session")
def train() -> Callable[..., Path]:
    """`make_policy`: a policy artefact and everything that it was made from."""
    return make_policy


@pytest.fixture(scope="session")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two agents, two tasks, two seeds, two checkpoints; random, oracle; do not write into it."""
    root = tmp_path_factory.mktemp("grid")
    return make_grid(root, ("scratch", "curl+ride"), ("goal-seeking", "tool-use"), (0, 1), skills={"curl+ride": 0.95})


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are written without figures, which take most of their time."""
    monkeypatch.setattr("gym_open.evaluate.report.figures.draw", lambda _: [])
