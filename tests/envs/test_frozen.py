"""The worlds of version 1 move and look as they did when version 1 was frozen.

A change that fails here needs a new version of the environments (`gym_open/…-v2`) with its own golden files, because
released data and scores were made in this version. `python tests/envs/test_frozen.py` writes the golden files.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gym_open import ENV_IDS
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.physics.model import model_xml
from gym_open.envs.puzzles import TASKS, Task
from gym_open.envs.puzzles.sets import test_puzzles
from gym_open.envs.world import World

GOLDEN = Path(__file__).parent / "golden"
STEPS = 12
PUZZLE = 17


def _played(task: Task) -> tuple[list[list[list[float]]], np.ndarray]:
    """Positions (steps, objects, 3) of the objects on the table, and the images before and after, in one array."""
    world = World()
    world.load(test_puzzles(task)[PUZZLE], recolour_hits=True)
    before = world.observe()
    positions = []
    for action in np.random.default_rng(PUZZLE).integers(1, N_ACTIONS, STEPS).tolist():
        world.step(action)
        positions.append(world.object_state()[world.present, :3].round(9).tolist())
    return positions, np.hstack([before, world.observe()])


def _model_digest() -> str:
    return hashlib.sha256(model_xml().encode()).hexdigest()


def _golden() -> dict[str, Any]:
    return json.loads((GOLDEN / "v1.json").read_text())


def test_the_ids_are_of_this_version() -> None:
    assert all(name.endswith("-v1") for name in ENV_IDS.values())


def test_the_model_is_the_frozen_one() -> None:
    assert _model_digest() == _golden()["model"]


@pytest.mark.parametrize("task", TASKS)
def test_motion_is_unchanged(task: Task) -> None:
    positions, _ = _played(task)
    # For processors without the promise, such as 64-bit Arm; `test_processors` compares bits on the others.
    np.testing.assert_allclose(positions, _golden()["positions"][task], atol=1e-6)


@pytest.mark.parametrize("task", TASKS)
def test_images_are_unchanged(task: Task) -> None:
    _, pictures = _played(task)
    golden = np.asarray(Image.open(GOLDEN / f"v1-{task}.png"))
    # On them, a pixel whose ray grazes an edge may differ.
    assert (pictures != golden).any(axis=2).sum() <= 4


def _write() -> None:
    GOLDEN.mkdir(exist_ok=True)
    played = {task: _played(task) for task in TASKS}
    record = {"model": _model_digest(), "positions": {task: positions for task, (positions, _) in played.items()}}
    (GOLDEN / "v1.json").write_text(json.dumps(record) + "\n")
    for task, (_, pictures) in played.items():
        Image.fromarray(pictures).save(GOLDEN / f"v1-{task}.png")


if __name__ == "__main__":
    _write()
