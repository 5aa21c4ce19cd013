"""Explorers that exist, and explorers that are refused."""

from typing import cast, get_args

import pytest

from gym_open.agents.config import INTRINSIC_REWARDS, ExplorerConfig, ExplorerModelName, RewardName, WorldModelName
from gym_open.agents.world_models import WORLD_MODELS
from gym_open.config import decode
from gym_open.errors import ConfigError


@pytest.mark.parametrize(
    ("world_model", "reward", "name"),
    [
        ("icm", "error", "icm"),
        ("rnd", "error", "rnd"),
        ("icm", "ride", "icm+ride"),
        ("rnd", "ride", "rnd+ride"),
        ("curl", "ride", "curl+ride"),
        ("curl", "none", "curl+random"),
        ("none", "none", "random"),
    ],
)
def test_explorers_have_the_papers_names(world_model: WorldModelName, reward: RewardName, name: str) -> None:
    assert ExplorerConfig(world_model=world_model, reward=reward).name == name


def test_a_new_reward_has_a_name_too() -> None:
    assert ExplorerConfig(world_model="icm", reward=cast("RewardName", "counts")).name == "icm+counts"


def test_names_in_configurations_are_those_of_the_tables() -> None:
    assert {*WORLD_MODELS, "none"} == set(get_args(ExplorerModelName))
    assert {*INTRINSIC_REWARDS, "none"} == set(get_args(RewardName))


@pytest.mark.parametrize("reward", INTRINSIC_REWARDS)
def test_a_reward_without_a_world_model_is_refused(reward: str) -> None:
    raw = {"world_model": "none", "reward": reward}
    with pytest.raises(ConfigError, match=rf"`reward` '{reward}' needs a world model, got `world_model` 'none'"):
        decode(raw, ExplorerConfig, source="collect.toml")


def test_a_learning_rate_that_falls_towards_the_end_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"`ppo\.anneal_lr` needs to know where a run ends.*give false"):
        decode({"ppo": {"anneal_lr": True}}, ExplorerConfig, source="collect.toml")
