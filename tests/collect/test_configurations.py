"""Every configuration in collect/ is an explorer that fulfils the common contracts; new ones must fulfil them, too."""

import io
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rich.console import Console

from gym_open import artefacts
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.collect.report import summary_table
from gym_open.config import load
from gym_open.formats.logs import log_files, open_log
from gym_open.workspace import template

NAMES = sorted(path.stem for path in (template() / "collect").glob("*.toml"))
PAPER = {"icm", "rnd", "icm+ride", "rnd+ride", "curl+ride", "curl+random", "random"}


def configuration(name: str) -> CollectConfig:
    return load(template() / "collect" / f"{name}.toml", CollectConfig)


def shrunk(name: str, tiny: CollectConfig) -> CollectConfig:
    """The configuration's explorer and rule at the size of the tiny run: six rollouts, checkpoints after 2 and 4."""
    own = configuration(name)
    models = {part: getattr(tiny.explorer, part) for part in ("encoder", "icm", "rnd", "ppo")}
    return msgspec.structs.replace(
        tiny, steps=96, checkpoint_every=2, explorer=msgspec.structs.replace(own.explorer, **models),
        curriculum=msgspec.structs.replace(own.curriculum, threshold=2.25, window=1, interval=16),
    )  # fmt: skip


def test_all_of_the_papers_explorers_exist_and_share_their_settings() -> None:
    names = [name for name in NAMES if name != "random-wide"]  # as many worlds as possible, for encoders of objects
    configurations = [one for name in names if (one := configuration(name)).explorer.name in PAPER]
    assert {one.explorer.name for one in configurations} == PAPER
    for one in configurations:
        assert (one.steps, one.streams, one.rollout, one.pool, one.seed) == (20_480, 4, 64, 12, 0)
        assert one.explorer.ppo == configurations[0].explorer.ppo
        assert one.curriculum.threshold == 0.001
        assert one.explorer.share_encoder


@pytest.mark.learning
@pytest.mark.usefixtures("scripted", "no_figure")
@pytest.mark.parametrize("name", NAMES)
def test_an_explorer_logs_summarises_and_resumes(
    tiny: CollectConfig, tmp_path: Path, stop_before: Any, name: str
) -> None:
    config = shrunk(name, tiny)
    log = collect(config, tmp_path / "whole").path
    for rollout in (3, 4):
        stop_before(config, tmp_path / "log", rollout)
    assert artefacts.digest(collect(config, tmp_path / "log").path) == artefacts.digest(log)

    summary = json.loads((log / "summary.json").read_text())
    assert (summary["explorer"], summary["steps"], summary["ended"]) == (config.explorer.name, 96, "budget")
    assert summary["switches"] >= 1
    assert (log / "encoder").is_dir() == (config.explorer.world_model != "none")
    for parts in log_files(log):
        one = open_log(parts)
        assert one.n_steps == 48
        for segment in one.segments():
            parts_sum = np.sum([np.zeros(len(segment.actions)), *segment.reward_parts.values()], axis=0)
            np.testing.assert_allclose(segment.intrinsic_reward, parts_sum, rtol=1e-6)
            assert tuple(segment.reward_parts) == one.reward_parts
            assert np.isfinite(segment.intrinsic_reward).all()
            assert np.isfinite(segment.world_model_loss).all() == (config.explorer.world_model != "none")

    shown = io.StringIO()
    Console(width=100, file=shown).print(summary_table(log))
    for words in (config.explorer.name, "visits", "loss entered", "ended by", "table seen", "agent touched", "budget"):
        assert words in shown.getvalue()
