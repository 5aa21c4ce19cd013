"""Scores of three puzzles (solved, not solved, ended in the danger patch), and a policy."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.policy import ActorCritic
from gym_open.config import Config
from gym_open.envs.constants import MOVES, cell_centre
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import puzzle_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witnesses_of
from gym_open.envs.tasks import step_budget
from gym_open.evaluate.proof import oracle_proof
from gym_open.evaluate.scores import Episodes, summarise, write_episodes, write_scores
from gym_open.files import sha256_file
from gym_open.formats.models import save_policy
from gym_open.formats.scores import Scores

TASK = "avoidance"
BUDGET = 100
SOLVED, GIVEN_UP, FAILED = (puzzle_id(TASK, "test", i) for i in range(3))


class Made(Config, frozen=True):
    """Stands for any stage's configuration."""

    name: str


class Source(NamedTuple):
    """Scores and their episodes."""

    path: Path
    actions: list[list[int]]
    rewards: list[list[float]]


def into_the_patch(puzzle: Puzzle) -> list[int]:
    """Return actions straight towards the danger patch, cell by cell."""
    assert puzzle.patch
    env, goal, found = OpenEnv(TASK), np.array(cell_centre(puzzle.patch.row, puzzle.patch.column)), []
    env.reset(options={"puzzle": puzzle})
    while not env.ended:
        there = env.world.object_state()[env.world.inventory.index("agent"), :2]
        found.append(MOVES.index(tuple(np.rint((goal - there) / 0.141).clip(-1, 1).astype(int).tolist())))
        env.step(found[-1])
    return found


def make_scores(
    out: Path,
    agent: str,
    sequences: Sequence[Sequence[int]],
    policy: str | None = None,
    task: Literal["avoidance", "preferences"] = TASK,
) -> Source:
    """Scores of the first puzzles of a task, played with these actions."""
    puzzles = puzzles_of(task, "test")[: len(sequences)]
    n, budget = len(sequences), step_budget(task)
    actions, rewards = np.full((n, budget), -1, np.int8), np.zeros((n, budget))
    steps, terminated = np.zeros(n, np.int64), np.zeros(n, bool)
    env = OpenEnv(task)
    for i, (puzzle, sequence) in enumerate(zip(puzzles, sequences, strict=True)):
        env.reset(options={"puzzle": puzzle})
        for t, action in enumerate(sequence):
            _, rewards[i, t], terminated[i], _, _ = env.step(action)
            actions[i, t], steps[i] = action, t + 1
        assert env.ended
    played = Episodes(actions, rewards, steps, terminated)
    record = Scores(
        task=task, split="test", agent=agent, seed=3, evaluation_seed=0, trained=20_480, actions="sampled",
        policy=policy, proof=oracle_proof(), code="test", hardware={"cores": 1}, **summarise(played),
    )  # fmt: skip

    def work(folder: Path) -> Mapping[str, Any]:
        write_scores(folder, record)
        write_episodes(folder, [puzzle_id(task, "test", i) for i in range(n)], puzzles, played)
        return {"task": task, "split": "test", "agent": agent}

    path = artefacts.build(out, kind="scores", config=Made(name=agent), parents=[], work=work).path
    return Source(path, [list(each) for each in sequences], [rewards[i, : steps[i]].tolist() for i in range(n)])


@pytest.fixture(scope="session")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    network = ActorCritic(Encoder(EncoderConfig(features=8), torch.Generator().manual_seed(1)), 9, torch.Generator())
    with torch.no_grad():
        network.actor.weight.mul_(20)  # so that some actions are likelier than others

    def work(folder: Path) -> Mapping[str, Any]:
        save_policy(folder, network)
        return {"task": TASK, "agent": "small", "seed": 3, "steps": 20_480}

    out = tmp_path_factory.mktemp("policy") / "policy"
    return artefacts.build(out, kind="policy", config=Made(name="policy"), parents=[], work=work).path


@pytest.fixture(scope="session")
def scores(policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Source:
    """One puzzle solved, one not solved, one ended in the danger patch; the record names the policy."""
    puzzles = puzzles_of(TASK, "test")
    sequences = [list(witnesses_of(TASK, "test")[0].actions), [0] * BUDGET, into_the_patch(puzzles[2])]
    return make_scores(tmp_path_factory.mktemp("scores") / "scores", "small", sequences, artefacts.digest(policy))


@pytest.fixture(scope="session")
def others(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Another agent, which solves only the second puzzle."""
    sequences = [[0] * BUDGET, list(witnesses_of(TASK, "test")[1].actions)]
    return make_scores(tmp_path_factory.mktemp("others") / "scores", "other", sequences)


@pytest.fixture(scope="session")
def half_way(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Two puzzles with a yellow and a green goal: one solved, one with only the first goal touched."""
    first, second = (list(witness.actions) for witness in witnesses_of("preferences", "test")[:2])
    env, taken, budget = OpenEnv("preferences"), 1, step_budget("preferences")
    env.reset(options={"puzzle": puzzles_of("preferences", "test")[1]})
    while not env.step(second[taken - 1])[1]:
        taken += 1
    sequences = [first, second[:taken] + [0] * (budget - taken)]
    return make_scores(tmp_path_factory.mktemp("half") / "scores", "half", sequences, task="preferences")


@pytest.fixture(scope="session")
def seal() -> Callable[[Path], None]:
    """Write a new manifest for the files of a folder."""

    def sealed(folder: Path) -> None:
        entries = {
            path.name: artefacts.Entry(sha256=sha256_file(path), bytes=path.stat().st_size)
            for path in folder.iterdir()
            if path.name != artefacts.MANIFEST
        }
        (folder / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(entries))

    return sealed
