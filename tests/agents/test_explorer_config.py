"""Which explorers there are, and which are refused."""

import pytest

from gym_open.agents.config import ExplorerConfig, RewardName, WorldModelName
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


@pytest.mark.parametrize("reward", ["error", "ride"])
def test_a_reward_without_a_world_model_is_refused(reward: str) -> None:
    raw = {"world_model": "none", "reward": reward}
    with pytest.raises(ConfigError, match=rf"`reward` '{reward}' needs a world model, got `world_model` 'none'"):
        decode(raw, ExplorerConfig, source="collect.toml")
