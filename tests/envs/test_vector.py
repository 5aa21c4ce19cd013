"""N worlds give the same as N environments in Gymnasium's own vector environment, with any timing of threads."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import gym_open
from gym_open.envs.env import OpenEnv
from gym_open.envs.options import ObjectOptions, WorldOptions
from gym_open.envs.puzzles import TASKS, PuzzleError, Task
from gym_open.envs.puzzles.generators import SandboxConfig
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.vector import OpenVectorEnv
from gym_open.errors import UsageError

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
N = 5


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal to the last bit, and of the same types."""
    assert data_equivalence(ours, theirs, exact=True)


def towards_a_goal(env: OpenEnv) -> int:
    """The move straight towards the first goal that was not hit."""
    world = env.world
    goals = [i for i, name in enumerate(world.inventory) if name.startswith(("yellow", "green")) and world.present[i]]
    aim = next((i for i in goals if not world.stepper.hit[i]), 0)
    x, y = world.data.qpos[7 * aim : 7 * aim + 2] - world.data.qpos[:2]
    return int(np.rint(np.arctan2(y, x) / (np.pi / 4))) % 8 + 1


@pytest.mark.parametrize(
    ("task", "mode"),
    [
        *((task, AutoresetMode.NEXT_STEP) for task in ALL_TASKS),
        ("goal-seeking", AutoresetMode.SAME_STEP),
        ("preferences", AutoresetMode.SAME_STEP),
        ("avoidance", AutoresetMode.DISABLED),
    ],
)
def test_worlds_are_as_in_gymnasiums_vector_environment(task: Task, mode: AutoresetMode) -> None:
    rng = np.random.default_rng(4)
    form = "dict" if task == "preferences" else "image"
    ours = OpenVectorEnv(N, task, observation=form, autoreset_mode=mode, threads=2)
    theirs = SyncVectorEnv([lambda: OpenEnv(task, observation=form)] * N, autoreset_mode=mode)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert_same(ours.reset(seed=7), theirs.reset(seed=7))
    ended, hits, paid = np.zeros(2, int), 0, 0.0
    for step in range(230 if task == "tool-use" else 130):
        # Half of the worlds move to their goals, the others use up the budget.
        actions = np.array([towards_a_goal(env) if i % 2 else 0 for i, env in enumerate(ours.envs)])
        actions = np.where(rng.random(N) < 0.2, rng.integers(0, 9, N), actions)
        played = ours.step(actions)
        assert_same(played, theirs.step(actions))
        ended += played[2].sum(), played[3].sum()
        paid += played[1].sum()
        hits += sum(map(len, played[4]["hits"]))
        if step % 20 == 0:
            for one, other in zip(ours.envs, theirs.envs, strict=True):
                assert isinstance(other, OpenEnv)
                np.testing.assert_array_equal(one.world.save_state(), other.world.save_state())
        if mode == AutoresetMode.DISABLED and (mask := played[2] | played[3]).any():
            _, infos = ours.reset(options={"reset_mask": mask})
            _, expected = theirs.reset(options={"reset_mask": mask})
            for name, values in infos.items():
                assert_same(values[mask], expected[name][mask])
    # Otherwise there was little to compare.
    assert hits if task == "sandbox" else paid or task == "tool-use"
    assert ended[0] or task in ("sandbox", "tool-use")
    assert ended[1] or task == "sandbox"
    ours.close()


def test_other_worlds_and_other_sandboxes_too() -> None:
    rng = np.random.default_rng(3)
    options: dict[str, Any] = {
        "sandbox": SandboxConfig(cone=(2, 2), rectangle=(1, 2), push=(1, 1), stack=(1, 1), light=(0, 1)),
        "world": WorldOptions(image_size=40, substeps=4, objects={"cone": ObjectOptions(mass=1)}),
    }
    ours = OpenVectorEnv(3, **options, threads=3)
    theirs = SyncVectorEnv([lambda: OpenEnv(**options)] * 3)
    assert_same(ours.reset(seed=1), theirs.reset(seed=1))
    for _ in range(25):
        actions = rng.integers(0, 9, 3)
        assert_same(ours.step(actions), theirs.step(actions))
    assert ours.step(np.zeros(3, int))[0].shape == (3, 40, 40, 3)


def test_threads_and_copies_change_nothing() -> None:
    rng = np.random.default_rng(1)
    runs = [
        OpenVectorEnv(9, "avoidance", threads=threads, copy=copy)
        for threads, copy in ((1, True), (2, False), (9, True), (3, False))
    ]
    first = [run.reset(seed=[3, 1, 4, 1, 5, 9, 2, 6, 5]) for run in runs]
    for other in first[1:]:
        assert_same(other, first[0])
    for _ in range(40):
        actions = rng.integers(0, 9, 9)
        played = [run.step(actions) for run in runs]
        for other in played[1:]:
            assert_same(other, played[0])
    for run in runs:
        run.close()


def test_its_environments_can_be_restored_elsewhere() -> None:
    rng = np.random.default_rng(2)
    vector, alone = OpenVectorEnv(3, "preferences", observation="dict"), OpenEnv("preferences", observation="dict")
    vector.reset(seed=0)
    alone.reset(seed=9)
    vector.step(np.array([1, 2, 3]))
    vector.envs[1].restore(alone.snapshot())
    for action in rng.integers(0, 9, 10).tolist():
        theirs = alone.step(action)
        ours = vector.step(np.full(3, action))
        assert_same({name: value[1] for name, value in ours[0].items()}, theirs[0])
        assert [ours[1][1], ours[2][1], ours[3][1]] == list(theirs[1:4])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_restored_world_goes_on_after_its_end(mode: AutoresetMode) -> None:
    vector = OpenVectorEnv(2, "goal-seeking", max_episode_steps=2, autoreset_mode=mode)
    vector.reset(seed=0)
    begun = [env.snapshot() for env in vector.envs]
    assert [vector.step(np.array([0, 0]))[3].all() for _ in range(2)] == [False, True]
    for env, snapshot in zip(vector.envs, begun, strict=True):
        env.restore(snapshot)
    assert not vector.step(np.array([0, 0]))[3].any()
    assert [env.puzzle for env in vector.envs] == [snapshot.puzzle for snapshot in begun]


def test_a_step_limit_is_taken_as_gymnasium_gives_it() -> None:
    vector = gymnasium.make_vec("gym_open/Sandbox-v1", num_envs=2, max_episode_steps=3)
    vector.reset(seed=0)
    assert [vector.step(np.array([0, 0]))[3].all() for _ in range(3)] == [False, False, True]


def test_after_close_no_episode_starts() -> None:
    vector = OpenVectorEnv(2, "goal-seeking")
    vector.close()
    with pytest.raises(ClosedEnvironmentError, match="make a new vector environment"):
        vector.reset()


def test_returned_arrays_are_overwritten_only_without_copies() -> None:
    kept, reused = OpenVectorEnv(2, "goal-seeking"), OpenVectorEnv(2, "goal-seeking", copy=False)
    for vector in (kept, reused):
        before = vector.reset(seed=0)[0]
        first, again = before.copy(), vector.step(np.array([1, 3]))[0]
        assert (vector is reused) == np.shares_memory(before, again)
        np.testing.assert_array_equal(before, again if vector is reused else first)


def test_made_by_gymnasium() -> None:
    vector = gymnasium.make_vec(gym_open.ENV_IDS["preferences"], num_envs=3, observation="dict", threads=2)
    assert isinstance(vector, OpenVectorEnv)
    assert vector.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert vector.spec is not None
    assert vector.spec.id == gym_open.ENV_IDS["preferences"]
    observations, infos = vector.reset(seed=0)
    assert observations in vector.observation_space
    assert observations["image"].shape == (3, 84, 84, 3)
    assert len(set(infos["puzzle_digest"])) == 3
    vector.action_space.seed(0)
    assert vector.step(vector.action_space.sample())[0] in vector.observation_space
    vector.close()


def test_each_world_can_be_given_its_puzzle() -> None:
    puzzles = fixed_puzzles("tool-use")[:3]
    vector = OpenVectorEnv(3, "tool-use", render_mode="rgb_array")
    observations, infos = vector.reset(options={"puzzles": puzzles})
    assert infos["puzzle_digest"].tolist() == [puzzle.digest for puzzle in puzzles]
    assert_same(vector.render(), tuple(observations))
    with pytest.raises(PuzzleError, match="expected a puzzle of task 'tool-use', got task 'avoidance'"):
        vector.reset(options={"puzzles": fixed_puzzles("avoidance")[:3]})
    with pytest.raises(ValueError, match=r"puzzles'\]: expected 3, one for each world, got 2"):
        vector.reset(options={"puzzles": puzzles[:2]})
    with pytest.raises(ValueError, match="seed: expected 3"):
        vector.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="expected bool, got int64"):
        vector.reset(options={"reset_mask": np.ones(3, int)})


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([1, 2], r"expected 3 whole numbers, .* got shape \(2,\) of int64"),
        ([[1, 2, 3]], r"got shape \(1, 3\)"),
        ([1.0, 2.0, 3.0], "of float64"),
        ([1, 9, 2], "expected 0 to 8, got 9 for world 1"),
        ([1, 2, -1], "got -1 for world 2"),
    ],
)
def test_wrong_actions_are_refused(actions: list[Any], message: str) -> None:
    vector = OpenVectorEnv(3)
    with pytest.raises(ResetNeeded, match="call reset before step"):
        vector.step(np.array([0, 0, 0]))
    vector.reset(seed=0)
    before = vector.envs[0].world.save_state()
    with pytest.raises(ValueError, match=message):
        vector.step(np.array(actions))
    np.testing.assert_array_equal(vector.envs[0].world.save_state(), before)


def test_without_autoreset_an_ended_world_must_be_reset() -> None:
    vector = OpenVectorEnv(2, "goal-seeking", autoreset_mode="Disabled")
    vector.reset(seed=0)
    steps = [vector.step(np.array([0, 0])) for _ in range(100)]
    assert steps[-1][3].all()
    with pytest.raises(ResetNeeded, match=r"worlds \[0, 1\] have ended"):
        vector.step(np.array([0, 0]))
    vector.reset(options={"reset_mask": np.array([False, True])})
    with pytest.raises(ResetNeeded, match=r"worlds \[0\] have ended"):
        vector.step(np.array([0, 0]))


def test_before_the_first_reset_and_after_closing_there_is_no_step() -> None:
    vector = OpenVectorEnv(2, "goal-seeking")
    with pytest.raises(ResetNeeded, match="the first reset must reset all worlds"):
        vector.reset(options={"reset_mask": np.array([True, False])})
    vector.reset(seed=0)
    vector.close()
    vector.close()
    with pytest.raises(ClosedEnvironmentError, match="make a new vector environment"):
        vector.step(np.array([0, 0]))


def test_bounds_are_named() -> None:
    with pytest.raises(UsageError, match="num_envs: expected 1 or more, got 0"):
        OpenVectorEnv(0)
    with pytest.raises(UsageError, match="threads: expected 1 or more, got -1"):
        OpenVectorEnv(2, threads=-1)
