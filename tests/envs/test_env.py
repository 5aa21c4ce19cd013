"""The contract of the five Gymnasium ids, the rewards of each task by scripted play, and snapshots."""

import subprocess
import sys
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.seeding import np_random

import gym_open
from gym_open.envs import constants as c
from gym_open.envs.env import EnvSnapshot, OpenEnv
from gym_open.envs.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzle_sets import reserved_digests
from gym_open.envs.puzzle_sets import test_puzzles as fixed_puzzles
from gym_open.envs.puzzles import TASKS, Patch, Pen, Placement, Puzzle, PuzzleError, Task, arranged
from gym_open.envs.tasks import step_budget

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
EAST, NORTH, WEST, SOUTH = 1, 3, 5, 7


def made(task: Task, **options: Any) -> OpenEnv:
    env = gymnasium.make(gym_open.ENV_IDS[task], **options).unwrapped
    assert isinstance(env, OpenEnv)
    return env


def puzzle(task: Task, *objects: tuple, pen: Pen | None = None, patch: Patch | None = None) -> Puzzle:
    return Puzzle(task=task, objects=arranged([Placement(*item) for item in objects]), pen=pen, patch=patch)


def play(env: OpenEnv, start: Puzzle, *actions: int) -> list[tuple[float, bool, bool]]:
    """Reward, terminated and truncated of each step."""
    env.reset(seed=0, options={"puzzle": start})
    return [env.step(action)[1:4] for action in actions]


def test_importing_registers_the_ids_and_loads_no_engine() -> None:
    code = (
        "import sys, gym_open, gymnasium\n"
        "assert all(name in gymnasium.registry for name in gym_open.ENV_IDS.values())\n"
        "print(sorted({'mujoco', 'numba', 'torch', 'lerobot', 'rerun'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("task", ALL_TASKS)
def test_gymnasiums_checker_finds_nothing(task: Task) -> None:
    check_env(made(task))
    check_env(made(task, render_mode="rgb_array"))


@pytest.mark.parametrize("task", ALL_TASKS)
def test_same_seed_same_episode(task: Task) -> None:
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 9, 60).tolist()
    runs = []
    for _ in range(2):
        env = made(task)
        image, info = env.reset(seed=11)
        steps = [(image, 0.0, False, False, info)]
        for action in actions:
            steps.append(env.step(action))
            if steps[-1][2] or steps[-1][3]:
                image, info = env.reset()
                steps.append((image, 0.0, False, False, info))
        runs.append(steps)
    for one, other in zip(*runs, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
        assert one[0].shape == (84, 84, 3)
        assert one[0].dtype == np.uint8
        assert np.isfinite(one[1])


@pytest.mark.parametrize("task", ALL_TASKS)
def test_resets_draw_new_training_puzzles(task: Task) -> None:
    env = made(task)
    digests = [env.reset(seed=1)[1]["puzzle_digest"], *(env.reset()[1]["puzzle_digest"] for _ in range(10))]
    assert len(set(digests)) == 11
    assert reserved_digests().isdisjoint(digests)
    assert env.reset(seed=1)[1]["puzzle_digest"] == digests[0]
    assert env.reset(seed=2)[1]["puzzle_digest"] not in digests
    assert env.puzzle.task == task


@pytest.mark.parametrize("task", TASKS)
def test_truncation_is_at_the_budget_and_is_no_termination(task: Task) -> None:
    env = made(task)
    start = fixed_puzzles(task)[0]
    steps = play(env, start, *[0] * step_budget(task))
    assert step_budget(task) == (200 if task == "tool-use" else 100)
    assert steps[-1] == (0.0, False, True)
    assert not any(terminated or truncated for _, terminated, truncated in steps[:-1])


def test_the_sandbox_pays_nothing_and_never_ends() -> None:
    env = made("sandbox")
    start = puzzle("sandbox", ("agent", 8, 3), ("yellow", 8, 4), patch=Patch(3, 4))
    steps = play(env, start, EAST, *[NORTH, SOUTH] * 150)
    assert set(steps) == {(0.0, False, False)}
    with pytest.raises(PuzzleError, match="no step budget"):
        step_budget("sandbox")


@pytest.mark.parametrize("task", ["goal-seeking", "tool-use", "avoidance"])
def test_hitting_yellow_pays_one_and_ends(task: Task) -> None:
    pieces: dict[str, Any] = {"tool-use": {"pen": Pen(8, 4, "north")}, "avoidance": {"patch": Patch(4, 4)}}.get(
        task, {}
    )
    cells = {"tool-use": [("agent", 9, 4), ("yellow", 2, 4)]}.get(task, [("agent", 12, 4), ("yellow", 10, 4)])
    env = made(task)
    start = puzzle(task, *cells, ("light", 1, 1), **pieces)
    steps = play(env, start, *[NORTH] * 12)
    paid = [i for i, (reward, _, _) in enumerate(steps) if reward]
    assert steps[paid[0]] == (1.0, True, False)
    assert not any(ended for _, ended, _ in steps[: paid[0]])


def test_preferences_pay_for_each_goal_and_end_after_both() -> None:
    env = made("preferences")
    start = puzzle("preferences", ("agent", 8, 4), ("yellow", 8, 2), ("green", 8, 6))
    green_first = play(env, start, EAST, EAST, *[WEST] * 12)
    rewards = [reward for reward, _, _ in green_first if reward]
    assert rewards[0] == 0.8
    steps = play(env, start, WEST, WEST, *[EAST] * 12)
    rewards = [reward for reward, _, _ in steps if reward]
    assert rewards == [0.2, 0.8]
    done = [i for i, (_, terminated, _) in enumerate(steps) if terminated]
    assert steps[done[0]][0] == 0.8
    assert sum(rewards) == pytest.approx(1)
    assert not any(truncated for _, _, truncated in steps)


def test_danger_ends_the_episode_unpaid_even_with_a_hit_in_the_same_step() -> None:
    env = made("avoidance")
    start = puzzle("avoidance", ("agent", 12, 4), ("yellow", 3, 4), patch=Patch(9, 4))
    assert play(env, start, NORTH, NORTH) == [(0.0, False, False), (0.0, True, False)]
    # A goal just inside the patch is hit by the very step that enters it.
    env.reset(options={"puzzle": start})
    env.step(NORTH)
    env.world.data.qpos[7:9] = c.cell_centre(9, 4)[0], c.cell_centre(9, 4)[1] - 0.065
    _, reward, terminated, truncated, info = env.step(NORTH)
    assert info["hits"] == ("yellow_0",)
    assert (reward, terminated, truncated) == (0.0, True, False)


def test_info_names_the_hits() -> None:
    env = made("goal-seeking")
    env.reset(seed=0, options={"puzzle": puzzle("goal-seeking", ("agent", 8, 3), ("yellow", 8, 4))})
    info = env.step(EAST)[4]
    assert info["hits"] == ("yellow_0",)
    assert info["puzzle_digest"] == env.puzzle.digest


@pytest.mark.parametrize("task", ALL_TASKS)
def test_a_snapshot_goes_on_bit_for_bit_through_json(task: Task) -> None:
    rng = np.random.default_rng(3)
    env, other = made(task), made(task)
    env.reset(seed=4)
    for action in rng.integers(0, 9, 7).tolist():
        env.step(action)
    snapshot = msgspec.json.decode(msgspec.json.encode(env.snapshot()), type=EnvSnapshot)
    image = env.world.observe()
    actions = rng.integers(0, 9, 30).tolist()
    first = [env.step(action) for action in actions]
    after = [env.reset()[1]["puzzle_digest"] for _ in range(3)]
    other.reset(seed=99)
    np.testing.assert_array_equal(other.restore(snapshot), image)
    for action, step in zip(actions, first, strict=True):
        again = other.step(action)
        np.testing.assert_array_equal(again[0], step[0])
        assert again[1:] == step[1:]
    assert [other.reset()[1]["puzzle_digest"] for _ in range(3)] == after


def test_a_snapshot_keeps_the_steps_left_and_the_return() -> None:
    env, other = made("preferences"), made("preferences")
    play(env, puzzle("preferences", ("agent", 8, 4), ("yellow", 8, 2), ("green", 8, 6)), WEST, WEST, *[0] * 90)
    snapshot = env.snapshot()
    assert (snapshot.steps, snapshot.episode_return, snapshot.hits) == (92, 0.2, 1)
    other.restore(snapshot)
    steps = [other.step(0)[1:4] for _ in range(8)]
    assert [truncated for _, _, truncated in steps] == [False] * 7 + [True]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"puzle": None}, "unknown"),
        ({"puzzle": "tool-use/017"}, "expected a Puzzle, got str"),
        ({"puzzle": fixed_puzzles("avoidance")[0]}, "'avoidance' given to a 'goal-seeking' environment"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(PuzzleError, match=message):
        made("goal-seeking").reset(options=options)


def test_sandbox_configuration_reaches_the_draws() -> None:
    config = SandboxConfig(heavy=(7, 7), light=(0, 0), pen_probability=0, patch_probability=1)
    env = made("sandbox", sandbox=config)
    env.reset(seed=0)
    assert sum(item.kind == "heavy" for item in env.puzzle.objects) == 7
    assert env.puzzle.patch
    assert env.puzzle == sample_puzzle("sandbox", made_generator(0), config)


def made_generator(seed: int) -> np.random.Generator:
    return np_random(seed)[0]


def test_vector_of_environments() -> None:
    vector = gymnasium.make_vec(gym_open.ENV_IDS["goal-seeking"], num_envs=3, vectorization_mode="sync")
    images, _ = vector.reset(seed=0)
    assert images.shape == (3, 84, 84, 3)
    assert len({image.tobytes() for image in images}) == 3
    vector.step(np.array([1, 2, 3]))
    vector.close()
