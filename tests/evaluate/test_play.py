"""Playing the fixed puzzles: what is recorded is what happened, and it can be replayed."""

from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import TASKS, Task
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.puzzles.witnesses import witnesses_of
from gym_open.envs.tasks import step_budget
from gym_open.errors import UsageError
from gym_open.evaluate import a_success
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import evaluate, play, replay
from gym_open.evaluate.scores import Episodes, summarise


def _uniform(images: np.ndarray) -> np.ndarray:
    assert images.dtype == np.uint8
    assert images.shape[1:] == (84, 84, 3)
    return np.full((len(images), N_ACTIONS), 1 / N_ACTIONS)


def _always(action: int) -> np.ndarray:
    return np.eye(N_ACTIONS)[action]


@pytest.mark.parametrize("task", TASKS)
def test_the_recorded_actions_replay_to_the_recorded_rewards(task: Task) -> None:
    puzzles = fixed_puzzles(task)[:4]
    episodes = play(_uniform, task, puzzles, EvaluateConfig(task="goal-seeking", seed=5))
    assert episodes.actions.shape == episodes.rewards.shape == (4, step_budget(task))
    for i, puzzle in enumerate(puzzles):
        env = OpenEnv(task)
        env.reset(seed=99, options={"puzzle": puzzle})
        for t in range(episodes.steps[i]):
            _, reward, terminated, _, _ = env.step(int(episodes.actions[i, t]))
            assert reward == episodes.rewards[i, t]
            assert terminated == (episodes.terminated[i] and t == episodes.steps[i] - 1)
        assert (episodes.actions[i, episodes.steps[i] :] == -1).all()
        assert not episodes.rewards[i, episodes.steps[i] :].any()


def test_a_puzzles_episode_does_not_depend_on_its_neighbours() -> None:
    puzzles = fixed_puzzles("goal-seeking")
    together = play(_uniform, "goal-seeking", puzzles[:3], EvaluateConfig(seed=1))
    alone = play(_uniform, "goal-seeking", puzzles[:1], EvaluateConfig(seed=1))
    assert (together.actions[0] == alone.actions[0]).all()
    other = play(_uniform, "goal-seeking", puzzles[:1], EvaluateConfig(seed=2))
    assert (other.actions[0] != alone.actions[0]).any()


def test_greedy_takes_the_most_likely_action_and_sampling_draws_from_the_probabilities() -> None:
    puzzles = fixed_puzzles("goal-seeking")[:2]

    def leaning(images: np.ndarray) -> np.ndarray:
        return np.tile(0.75 * _always(3) + 0.25 * _always(7), (len(images), 1))

    greedy = play(leaning, "goal-seeking", puzzles, EvaluateConfig(actions="greedy"))
    assert set(greedy.actions[greedy.actions >= 0].tolist()) == {3}
    sampled = play(leaning, "goal-seeking", puzzles, EvaluateConfig())
    drawn = sampled.actions[sampled.actions >= 0]
    assert set(drawn.tolist()) == {3, 7}
    assert np.mean(drawn == 3) == pytest.approx(0.75, abs=4 * np.sqrt(0.75 * 0.25 / len(drawn)))


def test_the_interval_is_that_of_the_puzzles_own_values() -> None:
    rewards = np.zeros((3, 10))
    rewards[0, 0] = rewards[1, 4] = 1.0
    steps = np.array([1, 5, 10])
    scores = summarise(Episodes(np.zeros((3, 10), np.int8), rewards, steps, np.array([True, True, False])))
    own = [1.0, a_success(np.arange(1, 11) >= 5), 0.0]
    assert scores["a_success"] == pytest.approx(np.mean(own))
    assert scores["a_success_half_width_95"] == pytest.approx(1.96 * np.std(own, ddof=1) / np.sqrt(3))
    assert scores["mean_return"] == pytest.approx(2 / 3)
    assert scores["mean_steps"] == pytest.approx(16 / 3)


@pytest.mark.parametrize("task", TASKS)
def test_the_oracle_earns_everything_in_all_puzzles_of_a_split(task: Task, tmp_path: Path) -> None:
    config = EvaluateConfig(task=task, split="validation")  # pyright: ignore[reportArgumentType]
    made = evaluate(config, None, tmp_path / "scores", oracle=True)
    record = msgspec.json.decode((made.path / "scores.json").read_bytes())
    assert (record["agent"], record["task"], record["split"]) == ("oracle", task, "validation")
    assert record["proof"]["verdict"] == "not applicable"
    assert record["mean_return"] == pytest.approx(1.0)
    episodes = pq.read_table(made.path / "episodes.parquet").to_pylist()
    assert [row["puzzle"] for row in episodes] == [f"{task}/validation/{i:03d}" for i in range(100)]
    assert [tuple(row["actions"]) for row in episodes] == [w.actions for w in witnesses_of(task, "validation")]
    # A-Success by the closed form, from the actions at which the goals were touched.
    N = step_budget(task)
    own = [sum(r * (1 - np.log(k) / np.log(N + 1)) for k, r in enumerate(row["rewards"], 1)) for row in episodes]
    assert record["a_success"] == pytest.approx(np.mean(own))
    assert not evaluate(config, None, tmp_path / "scores", oracle=True).made


def test_the_oracles_scores_are_not_taken_for_the_random_agents(tmp_path: Path) -> None:
    config = EvaluateConfig(task="goal-seeking")
    out = tmp_path / "scores"
    random = artefacts.build(out, kind="scores", config=config, parents=[], work=lambda _: {"agent": "random"})
    oracle = evaluate(config, None, out, oracle=True)
    assert oracle.made
    assert oracle.earlier
    agents = [artefacts.lineage(path).facts["agent"] for path in (oracle.earlier, oracle.path)]
    assert agents == ["random", "oracle"]
    assert random.path == oracle.path


def test_a_replay_does_nothing_behind_the_sequence() -> None:
    puzzle = fixed_puzzles("goal-seeking")[:1]
    episodes = replay("goal-seeking", puzzle, [[]])
    assert not episodes.actions.any()
    assert not episodes.rewards.any()
    assert episodes.steps[0] == 100
    assert not episodes.terminated[0]


def test_the_oracle_takes_no_policy(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="leave one of the two out"):
        evaluate(EvaluateConfig(), tmp_path / "policy", tmp_path / "scores", oracle=True)
