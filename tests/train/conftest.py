"""A tiny release of random pictures, and a way to kill a training run in the middle."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig

KillWhen = Callable[[str, Path], None]


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def release(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """36 frames in three worlds, one of them in split `val`."""
    config = ReleaseConfig(val_fraction=0.34)
    return build_release(config, [make_log(lengths=((9, 12, 6, 4),), seed=1)], tmp_path_factory.mktemp("r") / "r").path


@pytest.fixture
def kill_when() -> KillWhen:
    """`kill_when(code, file)` runs Python code and ends it with SIGKILL as soon as `file` exists."""

    def run(code: str, file: Path) -> None:
        child = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
        try:
            while not file.exists():
                assert child.poll() is None, "training ended before it could be killed"
                time.sleep(0.005)
            child.send_signal(signal.SIGKILL)
            assert child.wait() == -signal.SIGKILL
        finally:
            child.kill()
            child.wait()

    return run
