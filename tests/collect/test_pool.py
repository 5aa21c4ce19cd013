"""The pool of worlds, and the transitions on which their losses are measured."""

import math

import numpy as np
import torch

from gym_open import seeding
from gym_open.agents.explorer import Explorer
from gym_open.agents.world_model import TransitionBatch
from gym_open.collect.config import CollectConfig
from gym_open.collect.pool import Pool, sample_pool
from gym_open.envs.puzzles.generators import SandboxConfig
from gym_open.envs.puzzles.sets import reserved_digests


def pool(size: int, probe: int) -> Pool:
    return Pool(sample_pool(size, SandboxConfig(), seed=1), probe, seed=0)


def images(*values: int) -> np.ndarray:
    return np.stack([np.full((84, 84, 3), value, np.uint8) for value in values])


def test_the_worlds_are_different_and_none_is_a_test_puzzle() -> None:
    puzzles = sample_pool(30, SandboxConfig(), seed=1)
    digests = {puzzle.digest for puzzle in puzzles}
    assert len(digests) == 30
    assert digests.isdisjoint(reserved_digests())
    assert sample_pool(30, SandboxConfig(), seed=1) == puzzles


def test_the_loss_of_a_world_is_the_world_models_loss_on_its_transitions(tiny: CollectConfig) -> None:
    own, explorer = pool(2, probe=8), Explorer(tiny.explorer, n_actions=9, n_streams=1, seed=0)
    rng = np.random.default_rng(0)
    seen = rng.integers(0, 256, (9, 84, 84, 3), dtype=np.uint8)
    actions = rng.integers(0, 9, 8)
    own.see(0, seen[:-1], actions, seen[1:])
    kept = TransitionBatch(torch.from_numpy(seen[:-1]), torch.from_numpy(actions), torch.from_numpy(seen[1:]))
    shifts = torch.Generator().manual_seed(seeding.integer(0, "collect", "probe", 0, 1))
    draws = [own.loss(0, explorer, rollout) for rollout in (1, 1, 2)]
    assert draws[0] == draws[1] == explorer.world_loss(kept, shifts) != draws[2]
    assert own.loss(1, explorer, 1) == math.inf


def test_the_latest_transitions_of_distinct_observations_are_kept_and_restored() -> None:
    own = pool(2, probe=3)
    own.see(1, images(1, 2, 3, 4), np.array([1, 2, 3, 4]), images(2, 3, 4, 2))
    own.see(1, images(2), np.array([5]), images(9))
    own.left[0] = np.arange(4.0)
    back = pool(2, probe=3)
    back.load_tensors(own.tensors())
    for one in (own, back):
        kept = one.transitions(1)
        assert kept is not None
        assert kept.obs[:, 0, 0, 0].tolist() == [3, 4, 2]
        assert kept.actions.tolist() == [3, 4, 5]
        assert kept.next_obs[:, 0, 0, 0].tolist() == [4, 2, 9]
        assert one.transitions(0) is None
        assert one.left[0].tolist() == [0, 1, 2, 3]
