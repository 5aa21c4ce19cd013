"""Play of the fixed puzzles: the record is what happened, and it can be replayed."""

import zlib
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import Architecture, EncoderConfig, PPOConfig
from gym_open.config import Config
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import TASKS, Task
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.puzzles.witnesses import witnesses_of
from gym_open.envs.state import state_vector
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate import a_success
from gym_open.evaluate import play as playing
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import evaluate, play, replay
from gym_open.evaluate.scores import Episodes, summarise
from gym_open.formats.models import load_policy
from gym_open.formats.scores import read_scores
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import train_policy


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
    with pytest.raises(UsageError, match="omit one of the two"):
        evaluate(EvaluateConfig(), tmp_path / "policy", tmp_path / "scores", oracle=True)


def test_no_policy_has_no_likeliest_action(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"`actions` greedy .*give --policy, or --actions sampled"):
        evaluate(EvaluateConfig(actions="greedy"), None, tmp_path / "scores")
    assert not list(tmp_path.iterdir())


def _sees(seen: np.ndarray) -> np.ndarray:
    """Return probabilities that depend on every pixel, or on every number of a state, without action 0."""
    moves = [np.random.default_rng(zlib.crc32(one.tobytes())).dirichlet(np.ones(N_ACTIONS - 1)) for one in seen]
    return np.insert(np.stack(moves), 0, 0.0, axis=1)


@pytest.mark.parametrize(("threads", "states"), [(3, False), (2, True)])
def test_puzzles_side_by_side_go_as_each_does_alone(threads: int, *, states: bool) -> None:
    """Compare images or states, rewards and ends to the bit with Gymnasium's plain loop."""
    puzzles = fixed_puzzles("avoidance")[1:6]
    config = EvaluateConfig(task="avoidance", actions="greedy", threads=threads)
    episodes = play(_sees, "avoidance", puzzles, config, states=states)
    for i, puzzle in enumerate(puzzles):
        env = OpenEnv("avoidance")
        image, _ = env.reset(options={"puzzle": puzzle})
        terminated = truncated = False
        for t in range(episodes.steps[i]):
            assert not terminated
            assert not truncated
            action = int(_sees((state_vector(env.world) if states else image)[None])[0].argmax())
            assert action == episodes.actions[i, t]
            image, reward, terminated, truncated, _ = env.step(action)
            assert reward == episodes.rewards[i, t]
        assert terminated == episodes.terminated[i]
        assert terminated or truncated
    assert len(set(episodes.steps.tolist())) > 1  # some were over before others


def _trained(out: Path, architecture: Architecture) -> Path:
    """Train for two updates of 32 steps, with a checkpoint after the first."""
    config = PolicyTrainConfig(
        steps=64, num_envs=4, num_steps=8, mean_images=4, checkpoints=(20, 10_000), seed=7, threads=1, agent="mine",
        encoder=EncoderConfig(architecture=architecture, features=16), ppo=PPOConfig(learning_rate=0.01),
        trunk=(16,) if architecture == "state" else (),
    )  # fmt: skip
    return train_policy(config, None, out).path


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _trained(tmp_path_factory.mktemp("cnn") / "policy", "cnn")


@pytest.fixture
def two_puzzles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playing, "puzzles_of", lambda task, _: fixed_puzzles(task)[:2])


@pytest.mark.usefixtures("two_puzzles")
@pytest.mark.parametrize(("at", "trained", "folder"), [(None, 64, ""), (20, 32, "checkpoints/000000032")])
def test_what_is_scored_are_the_weights_that_were_asked_for(
    policy: Path, tmp_path: Path, at: int | None, trained: int, folder: str
) -> None:
    _check_scored(policy, tmp_path / "scores", at, trained, policy / folder)


@pytest.mark.usefixtures("two_puzzles")
def test_a_policy_that_sees_states_is_scored_on_states(tmp_path: Path) -> None:
    policy = _trained(tmp_path / "policy", "state")
    _check_scored(policy, tmp_path / "scores", None, 64, policy)


def _check_scored(policy: Path, out: Path, at: int | None, trained: int, folder: Path) -> None:
    """Compare the scores of a policy with the actions of its network in `folder`."""
    config = EvaluateConfig(threads=1, seed=3)
    made = evaluate(config, policy, out, at=at)
    record = read_scores(made.path)
    assert (record.agent, record.seed, record.evaluation_seed) == ("mine", 7, 3)
    assert (record.trained, record.policy) == (trained, artefacts.digest(policy))
    assert record.proof.verdict == "no encoder"
    network = load_policy(folder)

    def actor(seen: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            features = network.encoder(network.encoder.prepare(torch.from_numpy(seen)))
            return torch.softmax(network.actor(network.trunk(features)).double(), dim=1).numpy()

    states = network.encoder.config.architecture == "state"
    expected = play(actor, "goal-seeking", fixed_puzzles("goal-seeking")[:2], config, states=states)
    rows = pq.read_table(made.path / "episodes.parquet").to_pylist()
    assert [row["actions"] for row in rows] == [
        actions[:n].tolist() for actions, n in zip(expected.actions, expected.steps, strict=True)
    ]
    assert not evaluate(config, policy, out, at=at).made


@pytest.mark.usefixtures("two_puzzles")
def test_scores_of_a_checkpoint_are_not_taken_for_those_of_the_end(policy: Path, tmp_path: Path) -> None:
    config = EvaluateConfig(threads=1)
    evaluate(config, policy, tmp_path / "scores")
    again = evaluate(config, policy, tmp_path / "scores", at=20)
    assert again.made
    assert again.earlier


def test_a_checkpoint_that_was_not_reached_is_named_with_those_that_are_there(policy: Path, tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match="no checkpoint at 10000 steps; there are: 20; the end of the training, after 64 steps"
    ):
        evaluate(EvaluateConfig(), policy, tmp_path / "scores", at=10_000)
    with pytest.raises(UsageError, match="--at 20 is a checkpoint of a policy, and there is no policy"):
        evaluate(EvaluateConfig(), None, tmp_path / "scores", at=20)


def test_a_policy_of_another_task_is_refused(policy: Path, tmp_path: Path) -> None:
    with pytest.raises(
        ArtefactError, match="trained for task 'goal-seeking', not 'tool-use'; give --task goal-seeking"
    ):
        evaluate(EvaluateConfig(task="tool-use"), policy, tmp_path / "scores")


def test_facts_that_are_not_a_policys_are_named(tmp_path: Path) -> None:
    made = artefacts.build(
        tmp_path / "policy", kind="policy", config=Config(), parents=[], work=lambda _: {"task": "goal-seeking"}
    )
    with pytest.raises(ArtefactError, match=r"lineage\.json: not a policy's facts .*missing required field `steps`"):
        evaluate(EvaluateConfig(), made.path, tmp_path / "scores")


@pytest.mark.usefixtures("two_puzzles")
def test_scores_have_the_same_bytes_again(policy: Path, tmp_path: Path) -> None:
    folders = [evaluate(EvaluateConfig(threads=1), policy, tmp_path / name).path for name in ("one", "two")]
    assert artefacts.digest(folders[0]) == artefacts.digest(folders[1])
