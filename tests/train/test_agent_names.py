"""What an agent may be called: it stands in tables, lists and folders' names, beside rows that are no agents."""

import pytest

from gym_open.config import check
from gym_open.errors import ConfigError
from gym_open.train.config import PolicyTrainConfig


@pytest.mark.parametrize("name", ["", "curl+ride", "icm_2-b", "randomly", "0", "x" * 48])
def test_a_plain_name_is_taken(name: str) -> None:
    assert check(PolicyTrainConfig(agent=name), source="test").agent == name


@pytest.mark.parametrize(
    "name", ["random", "oracle", "human", "random, mine", "_x", "-x", "Curl", "a b", "a\n", "\n", "../up", "x" * 49]
)
def test_a_name_that_would_be_mistaken_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"`agent`: expected nothing, or a name of small letters.*none of random"):
        check(PolicyTrainConfig(agent=name), source="test")
