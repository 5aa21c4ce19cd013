"""A tiny release of random pictures."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def release(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """36 frames in three worlds, one of them in split `val`."""
    config = ReleaseConfig(val_fraction=0.34)
    return build_release(config, [make_log(lengths=((9, 12, 6, 4),), seed=1)], tmp_path_factory.mktemp("r") / "r").path
