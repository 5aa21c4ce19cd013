"""Releases to verify, and what it takes to damage or forge them."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.agents.config import ExplorerConfig
from gym_open.collect import explore
from gym_open.collect.config import CollectConfig, CurriculumConfig, LogConfig
from gym_open.collect.explore import collect
from gym_open.datasets import documents
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.verify import VerificationReport, run, verify_release
from gym_open.datasets.verify.replaying import replay_release
from gym_open.files import sha256_file

Reseal = Callable[[Path], None]
Quick = Callable[[Path], VerificationReport]
EVERY = 8
"""Steps between two keyframes."""


@pytest.fixture(scope="session")
def made_up(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of made-up play, which does not replay."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})  # the figures take longer than all else
        log = make_log(lengths=((9, 4, 5), (3, 6)), seed=5, reward_parts=("forward",), keyframe_every=4)
        out = tmp_path_factory.mktemp("made-up") / "open" / "explore" / "1.0.0"
        return build_release(ReleaseConfig(max_episode_steps=4), [log], out).path


@pytest.fixture
def release(made_up: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(made_up, tmp_path / "1.0.0"))


@pytest.fixture(scope="session")
def reseal() -> Reseal:
    """Makes the manifest anew, as one would who wants to pass for the author: all bytes are those of the manifest."""

    def seal(root: Path) -> None:
        manifest: dict[str, Any] = {}
        for path in sorted(root.rglob("*")):
            name = path.relative_to(root).as_posix()
            if path.is_file() and not path.is_symlink() and name != artefacts.MANIFEST:
                manifest[name] = artefacts.Entry(sha256_file(path), path.stat().st_size)
        (root / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(manifest))

    return seal


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> Quick:
    """Verifies without a replay, and without LeRobot: a process that takes seconds to start."""
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    return lambda root: verify_release(root, replay=False)


@pytest.fixture
def verify(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], VerificationReport]:
    """Verifies with the replay in this process, and without LeRobot: processes that take seconds to start."""
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    monkeypatch.setattr(run, "replay_apart", replay_release)
    return verify_release


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random play: two streams of 24 steps, a segment each."""
    config = CollectConfig(
        steps=48, streams=2, rollout=8, pool=2, probe=16, checkpoint_every=8, threads=1, seed=1,
        explorer=ExplorerConfig(world_model="none", reward="none"),
        curriculum=CurriculumConfig(rule="interval", interval=16), log=LogConfig(keyframe_every=EVERY),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explore, "draw_summary", lambda *_: b"")
        return collect(config, tmp_path_factory.mktemp("play") / "log").path


@pytest.fixture(scope="session")
def root(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of it: six episodes, each with a state of its beginning."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})
        out = tmp_path_factory.mktemp("release") / "1.0.0"
        return build_release(ReleaseConfig(max_episode_steps=EVERY, val_fraction=0.5), [log], out).path
