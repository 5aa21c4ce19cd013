"""One small release with all its papers: two explorers, two logs, parts of rewards, both splits."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig

CONFIG = ReleaseConfig(name="open/papers", max_episode_steps=5, val_fraction=0.34, published="2026-02-03", seed=7)
SECOND = {"lengths": ((6, 9),), "seed": 1, "world_model": False}


@pytest.fixture(scope="session")
def logs(make_log: Callable[..., Path]) -> list[Path]:
    icm = {"world_model": "icm", "reward": "error"}
    return [
        make_log(explorer=icm, reward_parts=("forward",)),
        make_log(**SECOND, explorer={"world_model": "none", "reward": "none"}),
    ]


@pytest.fixture(scope="session")
def release(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, logs, tmp_path_factory.mktemp("papers") / "1.0.0").path)
