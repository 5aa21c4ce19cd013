"""Recordings that are read back, and a log that was made for tests of viewers."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from gym_open import artefacts
from gym_open.config import Config


class Recording:
    """A recording that is read back column by column: the only one in a file, or the one with the id."""

    def __init__(self, path: Path, recording_id: str | None = None) -> None:
        reader = RrdReader(path)
        (self.store,) = [one for one in reader.recordings() if recording_id in {None, one.recording_id}]
        self._chunks = reader.stream(store=self.store).collect()

    def entities(self) -> set[str]:
        return {str(column.entity_path) for column in self._chunks.schema().component_columns()}

    def timelines(self) -> set[str]:
        return {column.name for column in self._chunks.schema().index_columns()}

    def column(self, entity: str, component: str, index: str = "step") -> tuple[list[Any], list[Any]]:
        """Times and values at which the component of the entity was logged."""
        table = self._chunks.reader(index=index, contents=entity).to_arrow_table().sort_by(index)
        times, values = table.column(index).to_pylist(), table.column(f"{entity}:{component}").to_pylist()
        kept = [(time, value) for time, value in zip(times, values, strict=True) if value is not None]
        return [time for time, _ in kept], [value for _, value in kept]

    def scalars(self, entity: str) -> dict[int, float]:
        """A series of single numbers by step."""
        steps, values = self.column(entity, "Scalars:scalars")
        return dict(zip(steps, np.ravel(values).tolist(), strict=True))

    def static(self, entity: str, component: str) -> Any:
        table = self._chunks.reader(index=None, contents=entity).to_arrow_table()
        return table.column(f"{entity}:{component}").to_pylist()[0]


@pytest.fixture(scope="session")
def read_back() -> Callable[..., Recording]:
    """`read_back(path)` reads a recording; `read_back(path, id)` reads one of several recordings in a file."""
    return Recording


class Staged(Config, frozen=True):
    """Replaces the configuration of the staged log."""

    seed: int = 0


STILL, AWAY = 40, 6
"""Steps in which the agent pushes without moving, and steps after that."""


def _write(folder: Path) -> dict[str, Any]:
    """A log of one stream and two worlds, with depth and segmentation; the agent gets stuck at step 32."""
    from gym_open.envs.physics.model import INVENTORY, model_xml
    from gym_open.envs.puzzles.generators import sample_puzzle
    from gym_open.formats.logs import LogHead, LogWriter, SegmentStart, StepMetrics, StepRecord, Stuck, Switch

    rng = np.random.default_rng(0)
    puzzles = tuple(sample_puzzle("sandbox", rng) for _ in range(2))
    image, state = np.zeros((84, 84, 3), np.uint8), np.zeros((len(INVENTORY), 13))
    state[:, 1], state[:, 3], state[0, :3] = -30.0, 1.0, (0.1, -0.2, 0.05)
    state[INVENTORY.index("heavy_3"), :2] = 0.5

    def seen(step: int) -> dict[str, np.ndarray]:
        depth = np.full((84, 84), 1.0 + step / 100, np.float32)
        geoms = np.full((84, 84), step % 60, np.int32)
        depth[0], geoms[0] = np.inf, -1
        return {"depth": depth, "segmentation": geoms}

    config = {"explorer": {"world_model": "none"}, "curriculum": {"rule": "interval", "threshold": 0.5}}
    head = LogHead(0, config, puzzles, {"code": "test"}, model_xml(), (), 1000)
    with LogWriter(folder, head) as log:
        step, metrics = 0, StepMetrics(0.0, np.nan, 2.0, 0.5)
        for index, length in enumerate((STILL + AWAY, 3)):
            log.switch(Switch(step, index - 1, index, "interval" if index else "start", [np.nan] * 2))
            picture = {"integration_state": np.zeros(5), "image": image, **seen(step)}
            log.segment(SegmentStart(index, step, index, puzzles[index], False, INVENTORY, state.copy(), **picture))
            for i in range(length):
                state = state.copy()
                state[0, 0] += 0.03 if index == 0 and i >= STILL else 0.0
                log.step(StepRecord(step, index, i, 1, state, (), image, metrics, **seen(step + 1)))
                step += 1
                if index == 0 and i + 1 in (32, STILL + 1):
                    x, y, z = state[0, :3].tolist()
                    log.stuck(Stuck(step, index, "agent", "agent", i + 1 == 32, (x, y, z)))
        log.switch(Switch(step, 1, -1, "budget", [np.nan] * 2))
    return {"task": "sandbox", "steps": STILL + AWAY + 3, "puzzles": sorted(puzzle.digest for puzzle in puzzles)}


@pytest.fixture(scope="session")
def staged_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log without a world model, in which the agent is stuck at steps 32 to 40."""

    def work(folder: Path) -> Mapping[str, Any]:
        return _write(folder)

    out = tmp_path_factory.mktemp("staged") / "log"
    return artefacts.build(out, kind="log", config=Staged(), parents=[], work=work).path
