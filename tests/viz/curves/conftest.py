"""An unfinished grid: some policies and scores, an encoder and a probe."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.envs.puzzles.sets import puzzle_id, puzzles_of
from gym_open.evaluate.proof import oracle_proof, task_free_proof
from gym_open.evaluate.scores import Episodes, summarise, write_episodes, write_scores
from gym_open.formats.scores import Scores

TASK = "goal-seeking"
HOSTILE = "<b>x</b>|`\x1b[2J"
CHECKPOINTS = (400, 800)
CURVE = {"columns": ["update", "loss", "held_out_loss"], "rows": [[100, 0.5, None], [200, 0.25, 0.75]]}


class Made(Config, frozen=True):
    """Stands for any stage's configuration."""

    name: str = ""
    seed: int = 0
    task: str = TASK
    agent: str = ""


class MadeAt(Made, frozen=True, kw_only=True):
    """Configuration of scores at a checkpoint."""

    at: int


def artefact(
    out: Path, kind: str, facts: Mapping[str, Any], files: Mapping[str, Any], *, config: Config | None = None,
    parents: tuple[Path, ...] = (),
) -> Path:  # fmt: skip
    def work(partial: Path) -> Mapping[str, Any]:
        for name, content in files.items():
            (partial / name).write_text(json.dumps(content))
        return facts

    return artefacts.build(out, kind=kind, config=config or Made(), parents=parents, work=work).path


def training(agent: str, seed: int, last: int) -> dict[str, Any]:
    """Make a training curve: the first return is missing, and seeds have returns at different steps."""
    rng = np.random.default_rng([seed, len(agent)])
    rows = [[step, None if step == 100 else float(rng.uniform())] for step in range(100, last + 1, 100 if seed else 50)]
    return {"columns": ["step", "mean_return"], "rows": rows}


def make_policy(root: Path, agent: str, seed: int) -> Path:
    facts = {
        "task": TASK, "agent": agent, "seed": seed, "steps": CHECKPOINTS[-1], "encoder": "none", "frozen": False,
        "from_encoder": False, "checkpoints": [{"asked": at, "step": at} for at in CHECKPOINTS],
    }  # fmt: skip
    name = "hostile" if agent == HOSTILE else agent
    config = Made(name="ppo", seed=seed, agent=agent)
    files = {"curve.json": training(agent, seed, CHECKPOINTS[-1])}
    return artefact(root / f"train/policies/{name}-{TASK}-seed{seed}", "policy", facts, files, config=config)


def make_scores(out: Path, agent: str, seed: int, trained: int, policy: Path | None) -> Path:
    """Write scores of puzzles that are solved at random, at random steps."""
    rng = np.random.default_rng([trained, seed, len(agent)])
    puzzles, ids = puzzles_of(TASK, "test"), [puzzle_id(TASK, "test", i) for i in range(100)]
    solved, steps = rng.uniform(size=100) < 0.6, rng.integers(1, 100, 100)
    rewards = np.zeros((100, 100))
    rewards[solved, steps[solved] - 1] = 1.0
    steps = np.where(solved, steps, 100)
    episodes = Episodes(actions=np.ones((100, 100), np.int8), rewards=rewards, steps=steps, terminated=solved)
    proof = oracle_proof() if policy is None else task_free_proof(parent(policy))
    record = Scores(
        task=TASK, split="test", agent=agent, seed=seed, evaluation_seed=0, trained=trained,
        actions="sampled", policy=artefacts.digest(policy) if policy else None, proof=proof, code="0.1.0+test",
        hardware={"cores": 2}, **summarise(episodes),
    )  # fmt: skip

    def work(partial: Path) -> Mapping[str, Any]:
        write_scores(partial, record)
        write_episodes(partial, ids, puzzles, episodes)
        return {"task": TASK, "split": "test", "agent": agent}

    at = policy is not None and trained != CHECKPOINTS[-1]
    config = MadeAt(name=f"{agent}{trained}", seed=seed, at=trained) if at else Made(name=agent, seed=seed)
    parents = [] if policy is None else [policy]
    return artefacts.build(out, kind="scores", config=config, parents=parents, work=work).path


def parent(folder: Path) -> artefacts.Parent:
    return artefacts.Parent(artefacts.digest(folder), artefacts.manifest(folder), artefacts.lineage(folder))


def score(value: float) -> dict[str, float]:
    return {"value": value, "low": value - 0.1, "high": value + 0.05}


PROBE = {
    "targets": {
        "agent": {"measure": "r2", "guess": 0.0, "gain": score(0.3),
                  "scores": {"trained": score(0.8), "untrained": score(0.5), "pixels": score(0.7)}},
        "contact": {"measure": "auc", "guess": 0.59, "gain": score(0.1),
                    "scores": {"trained": score(0.9), "untrained": score(0.8)}},
    }
}  # fmt: skip


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An agent with two seeds, an agent with one seed that lacks its final score, and the random agent."""
    root = tmp_path_factory.mktemp("bench") / "half"
    scores = root / "evaluate/scores"
    for agent, seed in (("scratch", 0), ("scratch", 1), (HOSTILE, 0)):
        policy = make_policy(root, agent, seed)
        for at in CHECKPOINTS[: 1 if agent == HOSTILE else 2]:
            make_scores(scores / f"{policy.name}-at{at}", agent, seed, at, policy)
    make_scores(scores / "random-goal-seeking", "random", 0, 0, None)
    artefact(root / "train/encoders/encoder-curl-of-play", "encoder", {"world_model": "curl"}, {"curve.json": CURVE})
    artefact(root / "train/probes/encoder-curl-of-play", "probe", {}, {"probe.json": PROBE})
    return root


Write = Callable[[str, str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """`write(name, text)` makes a file below a new folder `bench`."""

    def make(name: str, text: str) -> Path:
        path = tmp_path / "bench" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return make
