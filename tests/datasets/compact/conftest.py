"""Releases of real play, and their compact forms."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from gym_open.agents.config import ExplorerConfig
from gym_open.collect import explore
from gym_open.collect.config import CollectConfig, CurriculumConfig, LogConfig
from gym_open.collect.explore import collect
from gym_open.datasets import documents
from gym_open.datasets.build import build_release
from gym_open.datasets.compact.pack import pack_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.puzzles.generators import SandboxConfig


def play(out: Path, *, seed: int, explorer: ExplorerConfig, steps: int = 192, every: int = 8) -> Path:
    """Two streams that change their world every 16 steps, and come back to worlds."""
    config = CollectConfig(
        steps=steps, streams=2, rollout=8, pool=3, probe=16, checkpoint_every=8, threads=1, seed=seed,
        explorer=explorer, curriculum=CurriculumConfig(rule="interval", interval=16),
        log=LogConfig(keyframe_every=every), sandbox=SandboxConfig(),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explore, "draw_summary", lambda *_: b"")
        return collect(config, out).path


@pytest.fixture(scope="session")
def random_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random play."""
    return play(
        tmp_path_factory.mktemp("random") / "log", seed=1, explorer=ExplorerConfig(world_model="none", reward="none")
    )


@pytest.fixture(scope="session")
def learned_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Play of an explorer that learns, with parts of its reward and a loss."""
    explorer = ExplorerConfig(world_model="icm", reward="ride", share_encoder=True)
    return play(tmp_path_factory.mktemp("learned") / "log", seed=2, explorer=explorer, steps=96)


@pytest.fixture(scope="module", autouse=True)
def _without_figures() -> Iterator[None]:
    """Figures take most of the time of a small release."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})
        yield


@pytest.fixture(scope="session")
def release(random_log: Path, learned_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of both. Pieces of 12 steps do not end at keyframes."""
    config = ReleaseConfig(name="open/both", max_episode_steps=12, val_fraction=0.4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})
        return build_release(config, [random_log, learned_log], tmp_path_factory.mktemp("release") / "1.0.0").path


@pytest.fixture(scope="session")
def packed(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its compact form."""
    return pack_release(release, tmp_path_factory.mktemp("packed") / "compact").path


@pytest.fixture
def copy(packed: Path, tmp_path: Path) -> Path:
    """A copy of the compact form, to be damaged."""
    return Path(shutil.copytree(packed, tmp_path / "compact"))
