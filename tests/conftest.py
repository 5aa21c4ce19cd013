"""A small hand-made log artefact, for whatever reads logs: pictures and figures are drawn at random, not simulated."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from gym_open import artefacts
from gym_open.config import Config
from tests.children import HANG_S

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")  # no test fails because a machine is slow


def pytest_configure(config: pytest.Config) -> None:
    """Let Hugging Face's client wait, and let processes share the bytecode of what they import.

    Where Python is told to keep none, each of the many would compile PyTorch anew.
    """
    os.environ["HF_HUB_ETAG_TIMEOUT"] = os.environ["HF_HUB_DOWNLOAD_TIMEOUT"] = str(round(HANG_S))
    cache = getattr(config, "cache", None)  # none with -p no:cacheprovider
    if sys.dont_write_bytecode and cache is not None:
        sys.dont_write_bytecode, sys.pycache_prefix = False, str(cache.mkdir("bytecode"))
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix  # of xdist's processes and of tests' children


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest file, so that the other process has something to do until it ends."""
    items.sort(key=lambda item: item.path.name != "test_pipeline.py")


PARKED = ("green_2", "heavy_11", "light_0")
"""Objects that no puzzle of the log uses."""
Lengths = tuple[tuple[int, ...], ...]
MakeLog = Callable[..., Path]


class LogRecipe(Config, frozen=True):
    """Stands for the configuration of the play that would have made the log."""

    lengths: Lengths
    seed: int
    threshold: float = 0.25
    world_model: bool = True
    """Without one, its losses are NaN."""
    explorer: dict[str, str] | None = None
    """What the log's configuration says under `explorer`."""
    reward_parts: tuple[str, ...] = ()
    keyframe_every: int = 256


def write_log(folder: Path, recipe: LogRecipe) -> dict[str, Any]:
    """One stream for each tuple of `recipe.lengths`: the steps of its segments, in worlds 0, 1, 2, 0, 1, …"""
    from gym_open.envs.physics.contacts import Contact
    from gym_open.envs.physics.model import INVENTORY
    from gym_open.envs.puzzles.generators import sample_puzzle
    from gym_open.formats.logs import LogHead, LogWriter, SegmentStart, StepMetrics, StepRecord, Switch

    rng = np.random.default_rng(recipe.seed)
    puzzles = tuple(sample_puzzle("sandbox", rng) for _ in range(3))
    config: dict[str, Any] = {"curriculum": {"rule": "loss", "threshold": recipe.threshold}, "seed": recipe.seed}
    config |= {"explorer": recipe.explorer} if recipe.explorer else {}

    def picture() -> np.ndarray:
        return rng.integers(0, 256, (84, 84, 3), dtype=np.uint8)

    def state() -> np.ndarray:
        drawn = rng.normal(size=(len(INVENTORY), 13))
        drawn[[name in PARKED for name in INVENTORY], 1] = -30.0
        return drawn

    for stream, lengths in enumerate(recipe.lengths):
        head = LogHead(
            stream, config, puzzles, {"code": "test"}, "<mujoco/>", recipe.reward_parts, recipe.keyframe_every
        )
        with LogWriter(folder, head) as log:
            log.switch(Switch(0, -1, 0, "start", [np.inf] * 3))
            step = 0
            for index, length in enumerate(lengths):
                world, last = index % 3, index + 1 == len(lengths)
                start = SegmentStart(
                    index, step, world, puzzles[world], index >= 3, INVENTORY, state(), rng.normal(size=5), picture()
                )
                log.segment(start)
                seen = (start.object_state, start.image)
                for i in range(length):
                    if i and i % recipe.keyframe_every == 0:
                        moment = {"segment_step": i, "object_state": seen[0], "image": seen[1]}
                        log.segment(msgspec.structs.replace(start, integration_state=rng.normal(size=5), **moment))
                    touch = Contact("agent", "heavy_0", (0.1, 0.2, 0.3), (1.0, 0.0, 0.0), 2.5)
                    contacts = (touch, Contact("light_0", "heavy_0", (0, 0, 0), (0, 0, 1), 1.0))[: step % 3]
                    r, loss, entropy, value = rng.uniform(0.1, 1, size=4).tolist()
                    loss = loss if recipe.world_model else np.nan
                    action = int(rng.integers(9))
                    seen = (state(), picture())
                    parts = tuple(float(step + number) for number in range(len(recipe.reward_parts)))
                    metrics = StepMetrics(r, loss, entropy, value, parts)
                    log.step(StepRecord(step, index, i, action, seen[0], contacts, seen[1], metrics))
                    step += 1
                target = -1 if last else (index + 1) % 3
                losses = [0.5, np.inf, 0.25] if recipe.world_model else [np.nan] * 3
                log.switch(Switch(step, world, target, "budget" if last else "learned", losses))
    return {"task": "sandbox", "steps": sum(map(sum, recipe.lengths)), "puzzles": sorted(p.digest for p in puzzles)}


@pytest.fixture(scope="session")
def make_log(tmp_path_factory: pytest.TempPathFactory) -> MakeLog:
    """`make_log(lengths=((5, 7), (4,)), seed=0)` gives the folder of a fresh log artefact."""

    def make(lengths: Lengths = ((5, 12, 3, 4), (6,)), seed: int = 0, **more: Any) -> Path:
        recipe = LogRecipe(lengths=lengths, seed=seed, **more)

        def work(folder: Path) -> Mapping[str, Any]:
            return write_log(folder, recipe)

        out = tmp_path_factory.mktemp("log") / "log"
        return artefacts.build(out, kind="log", config=recipe, parents=[], work=work).path

    return make


@pytest.fixture(scope="module")
def no_figures() -> Iterator[None]:
    """Releases are built without the figures of their cards, which take most of the time of a small one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gym_open.datasets.documents.draw", lambda _: {})
        yield
