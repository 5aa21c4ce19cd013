"""The contract of every environment: one suite over all ids and both forms of observation."""

import itertools
from collections.abc import Iterator
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.error import ResetNeeded
from gymnasium.utils import env_checker
from gymnasium.utils.env_checker import data_equivalence

import gym_open
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import EnvSnapshot, ObservationMode, OpenEnv
from gym_open.envs.puzzles import TASKS, PuzzleError, Task
from gym_open.envs.puzzles.sets import reserved_digests
from gym_open.envs.tasks import REWARDS, step_budget

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
FORMS: tuple[ObservationMode, ...] = ("image", "dict")
Step = tuple[Any, float, bool, bool, dict[str, Any]]


@pytest.fixture(params=ALL_TASKS)
def task(request: pytest.FixtureRequest) -> Task:
    return request.param


@pytest.fixture(params=FORMS)
def form(request: pytest.FixtureRequest) -> ObservationMode:
    return request.param


def made(task: Task, form: ObservationMode = "dict", **options: Any) -> OpenEnv:
    env = gymnasium.make(gym_open.ENV_IDS[task], observation=form, **options).unwrapped
    assert isinstance(env, OpenEnv)
    return env


def played(env: OpenEnv, seed: int, steps: int = 60) -> Iterator[Step]:
    """Random actions over several episodes, with their resets."""
    observation, info = env.reset(seed=seed)
    yield observation, 0.0, False, False, info
    for action in np.random.default_rng(seed).integers(0, N_ACTIONS, steps).tolist():
        step = env.step(action)
        yield step
        if step[2] or step[3]:
            observation, info = env.reset()
            yield observation, 0.0, False, False, info


def arrays(data: Any) -> Iterator[np.ndarray]:
    if isinstance(data, np.ndarray):
        yield data
    elif isinstance(data, dict):
        for value in data.values():
            yield from arrays(value)


@pytest.mark.parametrize("options", [{}, {"render_mode": "rgb_array"}, {"rewards": False}])
def test_gymnasiums_checker_finds_nothing(task: Task, form: ObservationMode, options: dict[str, Any]) -> None:
    env_checker.check_env(made(task, form, **options))


def test_stable_baselines_checker_finds_nothing(task: Task) -> None:
    sb3.check_env(made(task, "image"))
    # It recommends one row of numbers; its policies accept the array as it is.
    with pytest.warns(UserWarning, match="object_state has an unconventional shape") as warned:
        sb3.check_env(made(task, "dict"))
    assert len(warned) == 1


def test_gymnasiums_own_wrappers_find_nothing(task: Task, form: ObservationMode) -> None:
    env = gymnasium.make(gym_open.ENV_IDS[task], observation=form, render_mode="rgb_array")
    with pytest.raises(ResetNeeded):
        env.step(np.int64(0))
    env.reset(seed=0)
    observation = [env.step(np.int64(action))[0] for action in range(N_ACTIONS)][-1]
    image = observation["image"] if form == "dict" else observation
    np.testing.assert_array_equal(env.render(), image)
    env.close()


def test_equal_seeds_give_equal_episodes(task: Task, form: ObservationMode) -> None:
    for one, other in zip(played(made(task, form), 11), played(made(task, form), 11), strict=True):
        assert data_equivalence(one, other, exact=True)


def test_other_seeds_give_other_episodes(task: Task) -> None:
    images = [next(played(made(task), seed))[0]["image"].tobytes() for seed in range(8)]
    assert len(set(images)) == 8


def test_resets_draw_new_training_puzzles(task: Task) -> None:
    env = made(task)
    digests = [env.reset(seed=1)[1]["puzzle_digest"], *(env.reset()[1]["puzzle_digest"] for _ in range(10))]
    assert len(set(digests)) == 11
    assert reserved_digests().isdisjoint(digests)
    assert env.puzzle.task == task


def test_returned_values_fit_spaces_and_types(task: Task, form: ObservationMode) -> None:
    env = made(task, form)
    for observation, reward, terminated, truncated, info in played(env, 3):
        assert observation in env.observation_space
        assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
        assert info["object_state"].shape == (len(env.world.inventory), 13)
        assert info.keys() == {"puzzle_digest", "object_state", "contacts", "hits", "in_danger"}


def test_returned_arrays_share_no_memory(task: Task, form: ObservationMode) -> None:
    env = made(task, form)
    returned = [[*arrays(step[0]), *arrays(step[4])] for step in played(env, 5, steps=4)]
    assert all(len(found) == (4 if form == "dict" else 2) for found in returned)
    for one, other in itertools.combinations(itertools.chain(*returned), 2):
        assert not np.shares_memory(one, other)


def test_states_are_finite_and_contacts_make_sense(task: Task) -> None:
    env = made(task)
    for _, _, _, _, info in played(env, 8, steps=80):
        assert np.isfinite(info["object_state"]).all()
        np.testing.assert_allclose(np.linalg.norm(info["object_state"][:, 3:7], axis=1), 1)
        for contact in info["contacts"]:
            assert contact.impulse >= 0
            assert np.isfinite([*contact.position, *contact.normal]).all()
            assert np.linalg.norm(contact.normal) == pytest.approx(1)
            assert {contact.a, contact.b} & set(env.world.inventory)


def test_rewards_are_only_those_of_the_task(task: Task) -> None:
    pay = REWARDS[task].values()
    possible = {0.0, *pay, sum(pay)}
    env = made(task, "image")
    for seed in range(6):
        total = 0.0
        for _, reward, terminated, truncated, info in played(env, seed, steps=100):
            assert any(reward == pytest.approx(value) for value in possible)
            assert not reward or info["hits"]
            total += reward
            if terminated or truncated:
                assert total <= 1.0 + 1e-9
                break


def test_an_episode_ends_in_one_way_at_its_time(task: Task) -> None:
    env = made(task, "image")
    for seed in range(6):
        env.reset(seed=seed)
        budget = 250 if task == "sandbox" else step_budget(task)
        rng = np.random.default_rng(seed)
        for step in range(1, budget + 1):
            action = int(rng.integers(N_ACTIONS)) if seed % 2 else 0
            _, reward, terminated, truncated, info = env.step(action)
            assert truncated == (task != "sandbox" and step == budget and not terminated)
            assert not terminated or reward or info["in_danger"]
            assert not terminated or task != "sandbox"
            if terminated:
                break


def test_a_no_op_lets_no_time_pass(task: Task) -> None:
    env = made(task)
    *_, (before, *_, info) = played(env, 2, steps=10)
    state = env.world.save_state()
    after, _, _, _, info_after = env.step(0)
    assert data_equivalence(before, after, exact=True)
    np.testing.assert_array_equal(env.world.save_state(), state)
    np.testing.assert_array_equal(info["object_state"], info_after["object_state"])
    assert info_after["contacts"] == info_after["hits"] == ()


@pytest.mark.parametrize("task", TASKS)
def test_after_the_end_rewards_are_0_and_the_end_stays(task: Task) -> None:
    env = made(task, "image")
    env.reset(seed=0)
    for _ in range(step_budget(task)):
        env.step(0)
    for action in (0, 1, 3, 5, 7):
        assert env.step(action)[1:4] == (0.0, False, True)
    env.reset()
    assert env.step(0)[1:4] == (0.0, False, False)


def test_an_invalid_action_is_refused_and_changes_nothing(task: Task) -> None:
    env = made(task)
    with pytest.raises(PuzzleError, match="load a puzzle first"):
        env.step(0)
    env.reset(seed=0)
    before = env.snapshot()
    for action in (-1, N_ACTIONS):
        with pytest.raises(ValueError, match=f"expected 0 to 8, got {action}"):
            env.step(action)
    for action in (1.0, "1", np.array([1, 2])):
        with pytest.raises(TypeError):
            env.step(action)  # pyright: ignore[reportArgumentType]
    assert env.snapshot() == before


def test_a_snapshot_goes_on_bit_for_bit_through_json(task: Task, form: ObservationMode) -> None:
    rng = np.random.default_rng(3)
    env, other = made(task, form), made(task, form)
    env.reset(seed=4)
    for action in rng.integers(0, N_ACTIONS, 7).tolist():
        env.step(action)
    snapshot = msgspec.json.decode(msgspec.json.encode(env.snapshot()), type=EnvSnapshot)
    observation = env.observe()
    actions = rng.integers(0, N_ACTIONS, 30).tolist()
    first = [env.step(action) for action in actions]
    after = [env.reset()[1]["puzzle_digest"] for _ in range(3)]
    other.reset(seed=99)
    assert data_equivalence(other.restore(snapshot), observation, exact=True)
    for action, step in zip(actions, first, strict=True):
        assert data_equivalence(other.step(action), step, exact=True)
    assert [other.reset()[1]["puzzle_digest"] for _ in range(3)] == after
