"""Rewards of each task by scripted actions, infos, observations and options. test_contract has what all tasks share."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

import gym_open
from gym_open.envs import constants as c
from gym_open.envs.env import OpenEnv
from gym_open.envs.look.backend import OpenGLError, find_backend
from gym_open.envs.options import ObjectOptions, WorldOptions
from gym_open.envs.puzzles import TASKS, Patch, Pen, Placement, Puzzle, PuzzleError, Task, arranged
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.tasks import step_budget
from gym_open.errors import ConfigError, UsageError
from tests.children import python

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
    done = python(code)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_budgets_are_the_papers() -> None:
    assert {task: step_budget(task) for task in TASKS} == {
        "goal-seeking": 100,
        "preferences": 100,
        "avoidance": 100,
        "tool-use": 200,
    }


def test_the_sandbox_has_no_rewards_and_never_ends() -> None:
    env = made("sandbox")
    start = puzzle("sandbox", ("agent", 8, 3), ("yellow", 8, 4), patch=Patch(3, 4))
    steps = play(env, start, EAST, *[NORTH, SOUTH] * 150)
    assert set(steps) == {(0.0, False, False)}
    with pytest.raises(PuzzleError, match="no step budget"):
        step_budget("sandbox")


@pytest.mark.parametrize("task", ["goal-seeking", "tool-use", "avoidance"])
def test_a_touch_of_yellow_has_reward_1_and_terminates(task: Task) -> None:
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


def test_preferences_reward_each_goal_and_terminate_after_both() -> None:
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


def test_danger_terminates_with_reward_0_even_with_a_hit_in_the_same_step() -> None:
    env = made("avoidance")
    start = puzzle("avoidance", ("agent", 12, 4), ("yellow", 3, 4), patch=Patch(9, 4))
    assert play(env, start, NORTH, NORTH) == [(0.0, False, False), (0.0, True, False)]
    # The step that enters the patch also hits a goal just inside it.
    env.reset(options={"puzzle": start})
    env.step(NORTH)
    env.world.data.qpos[7:9] = c.cell_centre(9, 4)[0], c.cell_centre(9, 4)[1] - 0.065
    _, reward, terminated, truncated, info = env.step(NORTH)
    assert info["hits"] == ("yellow_0",)
    assert (reward, terminated, truncated) == (0.0, True, False)


def test_info_holds_the_events_of_a_step() -> None:
    env = made("goal-seeking")
    start = puzzle("goal-seeking", ("agent", 8, 3), ("yellow", 8, 4), patch=Patch(8, 4))
    _, first = env.reset(seed=0, options={"puzzle": start})
    assert (first["hits"], first["contacts"], first["in_danger"]) == ((), (), True)
    info = env.step(EAST)[4]
    assert info["hits"] == ("yellow_0",)
    assert [{contact.a, contact.b} for contact in info["contacts"]] == [{"agent", "yellow_0"}]
    assert info["puzzle_digest"] == env.puzzle.digest == first["puzzle_digest"]
    rows = dict(zip(env.world.inventory, info["object_state"], strict=True))
    assert rows["yellow_0"][0] > rows["agent"][0] > first["object_state"][0, 0]
    assert rows["yellow_0"][7] > 0 == rows["agent"][7]


def test_a_dictionary_observation_has_zeros_for_absent_objects() -> None:
    env = made("goal-seeking", observation="dict")
    start = puzzle("goal-seeking", ("agent", 8, 3), ("yellow", 2, 4), ("light", 5, 5))
    seen, info = env.reset(seed=0, options={"puzzle": start})
    there = [name in {"agent", "yellow_0", "light_0"} for name in env.world.inventory]
    np.testing.assert_array_equal(seen["present"], there)
    assert not seen["object_state"][~np.array(there)].any()
    np.testing.assert_allclose(seen["object_state"][there], info["object_state"][there], rtol=1e-6)
    np.testing.assert_array_equal(seen["image"], env.world.observe())
    np.testing.assert_allclose(seen["object_state"][0, :2], c.cell_centre(8, 3), rtol=1e-6)
    env.world.data.qvel[:3] = 1e9, -1e9, 0  # beyond any state that occurs
    assert env.observe() in env.observation_space


def test_without_rewards_no_episode_ends_and_goals_keep_their_colour() -> None:
    env, rewarded = made("goal-seeking", rewards=False), made("goal-seeking")
    start = puzzle("goal-seeking", ("agent", 12, 4), ("yellow", 10, 4), ("light", 1, 1))
    steps = play(env, start, *[NORTH] * 3, *[0] * 120)
    assert set(steps) == {(0.0, False, False)}
    play(rewarded, start, *[NORTH] * 3)
    changed = (env.world.observe() != rewarded.world.observe()).any(axis=2)
    np.testing.assert_array_equal(env.world.data.qpos, rewarded.world.data.qpos)
    goal = env.world.model.geom("yellow_0").id
    np.testing.assert_array_equal(changed, env.world.segmentation() == goal)
    assert env.reset(seed=1)[1]["puzzle_digest"] == rewarded.reset(seed=1)[1]["puzzle_digest"]


def test_options_of_the_world_reach_it() -> None:
    options = WorldOptions(image_size=32, objects={"light": ObjectOptions(mass=50)}, substeps=5)
    env = made("goal-seeking", world=options)
    image, _ = env.reset(seed=0)
    assert image.shape == (32, 32, 3)
    assert image in env.observation_space
    assert env.world.model.body("light_0").mass[0] == 50
    env.step(EAST)
    assert env.world.data.time == pytest.approx(5 * c.TIMESTEP_S)


def test_render_gives_the_observation_or_a_handsome_image() -> None:
    env = made("preferences", render_mode="rgb_array")
    image, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), image)
    env = made("preferences")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


DRAW = """
from gym_open.envs.env import OpenEnv
env = OpenEnv(task="preferences", render_mode="rgb_array", render_look="handsome", render_size=(160, 120))
env.reset(seed=0)
assert env.render().any()
"""


def test_the_handsome_look_needs_opengl() -> None:
    env = made("preferences", render_mode="rgb_array", render_look="handsome", render_size=(160, 120))
    env.reset(seed=0)
    if find_backend() is None:
        with pytest.raises(OpenGLError, match="apt-get install"):
            env.render()
        return
    first = env.render()
    assert isinstance(first, np.ndarray)
    assert (first.shape, first.dtype) == ((120, 160, 3), np.uint8)
    env.step(EAST)
    assert (env.render() != first).any()
    env.close()
    env.close()


def test_a_process_that_has_drawn_with_opengl_can_still_learn() -> None:
    """PyTorch's first optimizer imports Triton, which must be loaded before Mesa."""
    if find_backend() is None:
        pytest.skip("no OpenGL here")
    pytest.importorskip("triton", exc_type=ImportError)
    done = python(f"{DRAW}import triton; print('learns')")
    assert (done.returncode, done.stdout) == (0, "learns\n"), done.stderr


def test_values_of_configurations_are_checked() -> None:
    with pytest.raises(ConfigError, match=r"sandbox: key `meshes`: expected `array`, got .*ring"):
        OpenEnv(sandbox=SandboxConfig(meshes={"ring": 2}))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"world: key `image_size`: expected `int`, got `float`, got 84.5"):
        OpenEnv(world=WorldOptions(image_size=84.5))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "maze"}, "task: expected one of 'sandbox', .*, got 'maze'"),
        ({"observation": "state"}, "observation: expected one of 'image', 'dict', got 'state'"),
        ({"render_mode": "human"}, "render_mode: expected one of None, 'rgb_array', got 'human'"),
        ({"render_size": (0, 480)}, r"render_size: .* from 1 to 4096, got \(0, 480\)"),
        ({"max_episode_steps": 0}, "max_episode_steps: expected 1 or more, got 0"),
        ({"world": {"image_size": 64}}, "world: expected WorldOptions or None, got dict"),
        ({"render_look": "pretty"}, "render_look: expected one of 'observation', 'handsome', got 'pretty'"),
    ],
)
def test_wrong_arguments_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        OpenEnv(**options)


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
        ({"puzzle": fixed_puzzles("avoidance")[0]}, "expected a puzzle of task 'goal-seeking', got task 'avoidance'"),
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
