"""A tiny run with scripted losses: streams switch often, and return to worlds that they left."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

from gym_open import seeding
from gym_open.agents.config import EncoderConfig, ExplorerConfig, IcmConfig, PPOConfig, RndConfig
from gym_open.collect import explore
from gym_open.collect.config import CollectConfig, CurriculumConfig, LogConfig
from gym_open.collect.explore import Exploration, collect
from gym_open.collect.pool import Pool


def scripted_loss(pool: Pool, world: int, explorer: Any, rollout: int) -> float:
    """Replacement for `Pool.loss`."""
    return 2.0 + seeding.integer(1, world, rollout) % 1000 / 1000 if pool.transitions(world) else math.inf


@pytest.fixture(scope="session")
def tiny() -> CollectConfig:
    return CollectConfig(
        steps=400, streams=2, rollout=8, pool=4, probe=16, checkpoint_every=4, threads=1, seed=3,
        explorer=ExplorerConfig(
            encoder=EncoderConfig(features=32), icm=IcmConfig(hidden=16), rnd=RndConfig(hidden=16, outputs=16),
            ppo=PPOConfig(learning_rate=1e-3, minibatch_size=16, update_epochs=1, shift_pad=4),
        ),
        curriculum=CurriculumConfig(threshold=2.25, window=1),
        log=LogConfig(keyframe_every=16),
    )  # fmt: skip


@pytest.fixture(scope="module")
def scripted() -> Iterator[None]:
    """Losses are scripted in the tests of this module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pool, "loss", scripted_loss)
        yield


@pytest.fixture
def no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not draw the figure: it depends on the summary alone, and takes longer than a tiny run."""
    monkeypatch.setattr(explore, "draw_summary", lambda *_: b"")


class StopBefore(Protocol):
    """Runs `collect` until `rollout` rollouts are done, then stops as with Ctrl-C."""

    def __call__(self, config: CollectConfig, out: Path, rollout: int) -> None: ...


@pytest.fixture(scope="session")
def stop_before() -> StopBefore:
    def stop(config: CollectConfig, out: Path, rollout: int) -> None:
        real = Exploration.rollout

        def rollouts(self: Exploration, length: int) -> None:
            if self.record.rollouts == rollout:
                raise KeyboardInterrupt
            real(self, length)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Exploration, "rollout", rollouts)
            with pytest.raises(KeyboardInterrupt):
                collect(config, out)

    return stop


@pytest.fixture(scope="module")
def made(tiny: CollectConfig, scripted: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of the tiny run."""
    return collect(tiny, tmp_path_factory.mktemp("collect") / "log").path
