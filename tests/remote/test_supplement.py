"""The paper's interface: its listings run as printed, and each method has its documented effect."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_type_hints

import gymnasium
import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import TASKS
from gym_open.errors import GymOpenError, UsageError
from gym_open.remote.protocol import ObjectInformation
from gym_open.remote.supplement import OpenPuzzleEnv

LISTINGS = Path(__file__).parent / "listings"
"""Both `verbatim` blocks of the paper's supplement, byte for byte."""
SANDBOX = {"main_sphere": 1, "main_sphere_i_j": [(8, 4)], "touch_sphere": 2, "cube": 2, "high_value_target": 1}


def made(**changes: Any) -> Any:
    given = {"env_ip": "localhost", "self_ip": "localhost", "port": None, "debug": False}
    env = gymnasium.make("gym_open:open_puzzle_proc-v0", **{**given, **changes})
    assert isinstance(env, OpenPuzzleEnv)  # no wrapper hides its methods
    return env


def laid_out(task: int = 1, seed: int = 0, **changes: Any) -> Any:
    env = made(**changes)
    env.add_change_puzzle(mode=1, task=task)
    env.reset(seed=seed)
    return env


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The return values of `step` while a listing runs."""
    results: list[Any] = []
    step = OpenPuzzleEnv.step

    def watched(env: OpenPuzzleEnv, action: int) -> Any:
        results.append(step(env, action))
        return results[-1]

    monkeypatch.setattr(OpenPuzzleEnv, "step", watched)
    return results


def listing(name: str, actions: Iterator[int], steps: int) -> Callable[..., None]:
    """Run a listing with `gymnasium` for `gym`, an action in its loop, and an end: done, or a number of steps."""
    text = (LISTINGS / f"{name}.txt").read_text()
    line = "obs, rewards, dones, debug = env.step(action)"
    assert text.count("gym.make(") == text.count(line) == 1
    text = text.replace("gym.make(", "gymnasium.make(")
    text = text.replace(line, f"action = next(actions); {line}; done = dones or len(seen) == {steps}")
    return lambda seen, *arguments: _run(text, {"gymnasium": gymnasium, "actions": actions, "seen": seen}, *arguments)


def _run(text: str, scope: dict[str, Any], *arguments: Any) -> None:
    exec(compile(text, "listing", "exec"), scope)
    function = next(value for name, value in scope.items() if name.startswith("create_"))
    function(*arguments)


def test_the_sandbox_listing_runs_as_printed(seen: list[Any]) -> None:
    rng = np.random.default_rng(0)
    listing("sandbox", iter(lambda: int(rng.integers(9)), None), 60)(seen)
    assert len(seen) == 60
    for observation, reward, done, _ in seen:
        assert observation["image"].shape == (84, 84, 3)
        assert (reward, done) == (0.0, False)
        colours = sorted(item["color_id"] for item in observation["object_information"].values())
        assert colours[2:] == [3, 6, 6, 8]  # agent, two touch spheres, one high-value target; before them two cubes
        assert set(colours[:2]) <= {1, 2}


@pytest.mark.parametrize("task", [1, 2, 3, 4])
def test_the_task_listing_runs_as_printed(task: int, seen: list[Any]) -> None:
    rng = np.random.default_rng(0)
    listing("task", iter(lambda: int(rng.integers(9)), None), 40)(seen, task)
    assert 0 < len(seen) <= 40
    assert all(reward in {0.0, 0.2, 0.8, 1.0} for _, reward, _, _ in seen)
    assert len(seen) == 40 or seen[-1][2]
    assert not any(done for _, _, done, _ in seen[:-1])


def test_an_object_is_described_by_the_papers_seven_facts() -> None:
    env = made()
    env.add_change_puzzle(0, puzzle_config={**SANDBOX, "push_sphere": 1, "rectangle": 1, "cone": 1, "stack": 1})
    env.set_observation(True)
    observation = env.reset(seed=3)
    objects = observation["object_information"]
    keys = {"position", "rotation", "velocity", "angular_velocity", "mass", "model_name", "color_id"}
    assert keys == set(get_type_hints(ObjectInformation))
    assert all(set(item) == keys for item in objects.values())
    agent = objects[0]
    assert agent["position"] == pytest.approx((*c.cell_centre(8, 4), c.RADIUS), abs=1e-3)
    assert (agent["mass"], agent["model_name"], agent["color_id"]) == (7.0, "prim_sphere", 3)
    assert agent["velocity"] == agent["angular_velocity"] == (0.0, 0.0, 0.0)
    names = sorted(item["model_name"] for item in objects.values())
    assert names == ["prim_cone", *["prim_cube"] * 4, "prim_rectangle", *["prim_sphere"] * 5]
    masses = {item["color_id"]: item["mass"] for item in objects.values()}
    assert masses[6] == masses[8] == 10.0
    assert masses[2] == 5.0


def test_observations_hold_the_image_on_request() -> None:
    env = laid_out()
    assert set(env.reset()) == {"object_information"}
    env.set_observation(True)
    assert set(env.step(0)[0]) == {"image", "object_information"}
    env.set_observation(False)
    assert set(env.step(0)[0]) == {"object_information"}


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_a_task_is_the_one_that_gymnasiums_id_plays(number: int) -> None:
    """The same seed gives the same puzzle, images, rewards and end."""
    old, new = laid_out(number, seed=5), OpenEnv(TASKS[number - 1])
    old.set_observation(True)
    picture, _ = new.reset(seed=5)
    assert np.array_equal(old.reset()["image"], picture)
    rng = np.random.default_rng(1)
    for _ in range(250):
        action = int(rng.integers(9))
        observation, reward, done, debug = old.step(action)
        picture, expected, terminated, truncated, info = new.step(action)
        assert np.array_equal(observation["image"], picture)
        assert (reward, done, debug["truncated"]) == (expected, terminated or truncated, truncated)
        assert debug["puzzle_digest"] == info["puzzle_digest"]
        if done:
            return
    pytest.fail("the budget did not end the episode")


def to_goal(env: Any) -> Iterator[int]:
    """Actions straight to the yellow sphere."""
    while True:
        objects = env.step(0)[0]["object_information"].values()
        agent, goal = (next(o["position"] for o in objects if o["color_id"] in ids) for ids in ((3,), (6, 7)))
        x, y = (round(float(b - a) / c.PITCH) for a, b in zip(agent[:2], goal[:2], strict=True))
        yield c.MOVES.index((int(np.sign(x)), int(np.sign(y))))


def solved(env: Any) -> tuple[Any, float, bool, Any]:
    for action in to_goal(env):
        result = env.step(action)
        if result[3]["hits"]:
            return result
    raise AssertionError


def test_a_goal_is_rewarded_once_changes_its_colour_and_ends_the_episode() -> None:
    env = laid_out()
    observation, reward, done, _ = solved(env)
    assert (reward, done) == (1.0, True)
    assert 7 in {item["color_id"] for item in observation["object_information"].values()}
    assert env.step(0)[1:3] == (0.0, True)  # done stays True, which the listings' loop needs
    env.reset()
    assert env.step(0)[1:3] == (0.0, False)


def test_with_rewards_off_no_episode_ends_and_goals_keep_their_colour() -> None:
    env = laid_out()
    env.set_observation(True)
    env.turn_off_reward(True)
    before = env.reset()
    observation, reward, done, _ = solved(env)
    assert (reward, done) == (0.0, False)
    assert 7 not in {item["color_id"] for item in observation["object_information"].values()}
    teal = np.array([0, 189, 170])
    assert not (np.abs(observation["image"].astype(int) - teal).sum(axis=2) < 60).any()
    env.turn_off_reward(False)
    assert np.array_equal(env.reset()["image"], before["image"])
    observation, reward, done, _ = solved(env)
    assert (reward, done) == (1.0, True)
    assert (np.abs(observation["image"].astype(int) - teal).sum(axis=2) < 60).any()


def test_reset_repeats_the_puzzle_and_a_seed_draws_another() -> None:
    env = laid_out(seed=1)
    first = env.step(0)[3]["puzzle_digest"]
    env.step(3)
    assert env.reset() == env.reset()
    assert env.step(0)[3]["puzzle_digest"] == first
    env.reset(seed=2)
    assert env.step(0)[3]["puzzle_digest"] != first
    env.reset(seed=1)
    assert env.step(0)[3]["puzzle_digest"] == first


def test_without_skip_frame_ten_steps_are_one_move() -> None:
    whole, parts = laid_out(2, seed=4), laid_out(2, seed=4)
    parts.configure_env(False, action_space="full", skip_frame=False)
    agent: list[float] = []
    for action in (3, 2, 8, 5, 6):
        expected = whole.step(action)
        results = [parts.step(action if i == 0 else 0) for i in range(c.SUBSTEPS)]
        agent += [result[0]["object_information"][0]["position"][1] for result in results]
        assert results[-1][0] == expected[0]
        assert sum(result[1] for result in results) == expected[1]
    assert agent[:10] == sorted(agent[:10])
    assert agent[9] - agent[0] == pytest.approx(0.9 * c.PITCH, rel=0.1)


def test_without_skip_frame_a_world_goes_on_by_substeps() -> None:
    env = laid_out(seed=4)
    env.configure_env(False, action_space="full", skip_frame=False)
    for _ in range(4):
        env.step(1)
    with pytest.raises(UsageError, match=r"skip_frame: a move is unfinished, 6 substeps"):
        env.configure_env(False, action_space="full", skip_frame=True)
    moved = [env.step(0)[0]["object_information"][0]["position"][0] for _ in range(10)]
    assert moved[5] > moved[0]
    assert moved[6] == pytest.approx(moved[9], abs=1e-6)  # the move ends after six more


def test_debug_adds_contacts() -> None:
    plain, debug = laid_out(seed=4), laid_out(seed=4, debug=True)
    assert set(plain.step(1)[3]) == {"puzzle_digest", "hits", "in_danger", "truncated"}
    result = solved(debug)[3]
    assert result["puzzle"].digest == result["puzzle_digest"]
    assert any({one.a, one.b} == {"agent", result["hits"][0]} and one.impulse > 0 for one in result["contacts"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda env: env.add_change_puzzle(2), r"mode: expected 0 \(sandbox\) or 1 .* got 2"),
        (lambda env: env.add_change_puzzle(1), r"task: expected a whole number from 1 to 4, got None"),
        (lambda env: env.add_change_puzzle(1, 5), r"task: expected a whole number from 1 to 4, got 5"),
        (lambda env: env.add_change_puzzle(0, 3, SANDBOX), r"task: expected none or 0 for a sandbox .* got 3"),
        (lambda env: env.add_change_puzzle(0), r"puzzle_config: mode 0 .* got None"),
        (lambda env: env.add_change_puzzle(1, 1, SANDBOX), r"puzzle_config: only for mode 0"),
        (lambda env: env.add_change_puzzle(0, 0, {"cubes": 2}), r"unknown key `cubes`; did you mean `cube`"),
        (lambda env: env.add_change_puzzle(0, 0, {"cube": "two"}), r"`cube`.*got 'two'"),
        (lambda env: env.add_change_puzzle(0, 0, {"cube": 30}), r"`cube`: .* got 30"),
        (lambda env: env.add_change_puzzle(0, 0, {"cube": object()}), r"numbers, text, .* got object"),
        (lambda env: env.set_observation("yes"), r"set_observation: output: expected True or False, got 'yes'"),
        (lambda env: env.configure_env(True), r"first argument: expected False.* got True"),
        (lambda env: env.configure_env(False, action_space="half"), r"action_space: expected 'full'.* got 'half'"),
        (lambda env: env.configure_env(False, skip_frame=2), r"skip_frame: expected True or False, got 2"),
        (lambda env: env.turn_off_reward(None), r"turn_off_reward: value: expected True or False, got None"),
        (lambda env: env.step(9), r"action: expected a whole number from 0 to 8, got 9"),
        (lambda env: env.step(1.5), r"action: expected a whole number from 0 to 8, got 1\.5"),
        (lambda env: env.reset(seed=-1), r"seed: expected a whole number from 0 to .* got -1"),
        (lambda env: env.reset(options={"puzzle": 1}), r"options: expected none, got \['puzzle'\]"),
    ],
)
def test_a_wrong_argument_is_named_and_changes_nothing(call: Callable[[Any], None], message: str) -> None:
    env = laid_out(seed=6)
    before = env.step(0)
    with pytest.raises(GymOpenError, match=message):
        call(env)
    assert env.step(0) == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"port": "80"}, "port: expected None or a whole number, got '80'"),
        ({"port": 70000}, "port: expected 1 to 65535, got 70000"),
        ({"env_ip": "unix:/tmp/x"}, "env_ip: expected an IP address or a host name, got 'unix:/tmp/x'"),
        ({"self_ip": 3}, "self_ip: expected None or text, got 3"),
        ({"debug": "no"}, "debug: expected True or False, got 'no'"),
    ],
)
def test_a_wrong_argument_of_make_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        made(**changes)


def test_a_step_before_any_puzzle_says_what_to_call() -> None:
    for call in (lambda env: env.step(1), lambda env: env.reset()):
        with pytest.raises(UsageError, match="call add_change_puzzle first"):
            call(made())
