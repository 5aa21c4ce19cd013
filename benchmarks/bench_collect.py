"""Steps per second of every explorer with its log, as a ratio to random exploration; cost of the log; bytes per step.

A round times every explorer for a few rollouts, with and without a log, in turns, so that all have the same load.
Ratios are medians over rounds. The time covers acting, learning, enqueueing for the log, and writing its last byte.

Run: uv run python benchmarks/bench_collect.py
"""

import statistics
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self
from unittest.mock import patch

import msgspec
import torch
from rich.console import Console
from rich.table import Table

from gym_open.agents.config import ExplorerConfig
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import Exploration
from gym_open.config import load

ROUNDS, WARM, ROLLOUTS = 3, 1, 6
NAMES = ("random", "curl-random", "curl-ride", "icm", "icm-ride", "rnd", "rnd-ride")
FOLDER = Path(__file__).parents[1] / "collect"


class NoLog:
    """Accepts the calls of a log writer, and does nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.segment = self.step = self.switch = self.stuck = self.flush = self.sync = self.abandon = self._nothing

    def _nothing(self, *_: Any) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


def steps_per_s(config: CollectConfig, *, logged: bool) -> tuple[float, float]:
    """Steps per second of all streams, and bytes of log per step."""
    rollouts = ROLLOUTS if config.explorer.world_model != "none" else 8 * ROLLOUTS
    with tempfile.TemporaryDirectory() as folder, ExitStack() as logs:
        (Path(folder) / "checkpoint").mkdir()
        with ExitStack() as patches:
            if not logged:
                patches.enter_context(patch("gym_open.collect.explore.resume_writer", NoLog))
            exploration = Exploration(config, Path(folder), logs)
        for _ in range(WARM):
            exploration.rollout(config.rollout)
        for stream in exploration.streams:
            stream.log.sync()
        before = sum(path.stat().st_size for path in Path(folder).glob("*.mcap"))
        began = time.perf_counter()
        for _ in range(rollouts):
            exploration.rollout(config.rollout)
        for stream in exploration.streams:
            stream.log.sync()
        took = time.perf_counter() - began
        steps = rollouts * config.rollout * config.streams
        written = sum(path.stat().st_size for path in Path(folder).glob("*.mcap")) - before
        for stream in exploration.streams:
            stream.log.abandon()
        logs.pop_all()
    return steps / took, written / steps


def main() -> None:
    torch.set_num_threads(1)
    configs = {name: load(FOLDER / f"{name}.toml", CollectConfig) for name in NAMES}
    separate = msgspec.structs.replace(ExplorerConfig(), share_encoder=False)
    configs["curl-ride, own encoders"] = msgspec.structs.replace(configs["curl-ride"], explorer=separate)
    speeds: dict[str, list[tuple[float, float, float]]] = {name: [] for name in configs}
    for _ in range(ROUNDS):
        for name, config in configs.items():
            (speed, size), (bare, _) = steps_per_s(config, logged=True), steps_per_s(config, logged=False)
            speeds[name].append((speed, bare, size))
    table = Table(
        "explorer", "steps/s", "ratio to random", "ratio to itself without a log", "bytes/step", title="collect"
    )
    for name, rows in speeds.items():
        of_random = statistics.median(row[0] / first[0] for row, first in zip(rows, speeds["random"], strict=True))
        of_bare = statistics.median(row[0] / row[1] for row in rows)
        fastest, size = max(row[0] for row in rows), statistics.median(row[2] for row in rows)
        table.add_row(name, f"{fastest:,.0f}", f"{of_random:.3f}", f"{of_bare:.2f}", f"{size:,.0f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
