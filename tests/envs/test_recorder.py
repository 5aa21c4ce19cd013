"""`record` is `World.step`, many times."""

import numpy as np
import pytest

from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.recorder import record
from gym_open.envs.world import World
from gym_open.errors import UsageError


def _loaded(puzzle: Puzzle) -> World:
    world = World()
    world.load(puzzle, recolour_hits=True)
    return world


@pytest.mark.parametrize("seed", range(3))
def test_what_is_recorded_is_what_steps_give(seed: int) -> None:
    rng = np.random.default_rng(seed)
    puzzle = sample_puzzle("sandbox", rng)
    actions = rng.integers(0, 9, 300)
    stepped, played = _loaded(puzzle), _loaded(puzzle)
    made = record(played, actions)
    for t, action in enumerate(actions.tolist()):
        outcome = stepped.step(action)
        assert np.array_equal(made.states[t], stepped.object_state())
        assert np.array_equal(made.images[t], stepped.observe())
        touching = [pair for pair in outcome.contacts if "agent" in (pair.a, pair.b)]
        assert made.contacts[t].tolist() == [len(outcome.contacts), len(touching)]
        total = 0.0
        for pair in outcome.contacts:
            total += pair.impulse
        assert made.impulses[t] == total
    assert made.contacts[:, 1].any()
    assert np.array_equal(played.save_state(), stepped.save_state())


def test_the_world_does_not_depend_on_drawing() -> None:
    rng = np.random.default_rng(1)
    puzzle, actions = sample_puzzle("sandbox", rng), rng.integers(0, 9, 50)
    drawn, undrawn = _loaded(puzzle), _loaded(puzzle)
    assert np.array_equal(record(drawn, actions).states, record(undrawn, actions, images=False).states)
    assert np.array_equal(drawn.save_state(), undrawn.save_state())
    assert len(record(undrawn, actions[:0]).states) == 0


@pytest.mark.parametrize("action", [-1, 9])
def test_other_actions_are_refused(action: int) -> None:
    world = _loaded(sample_puzzle("sandbox", np.random.default_rng(0)))
    with pytest.raises(UsageError, match="expected 0 to 8"):
        record(world, np.array([0, action]))
