"""Time to build, verify and read a release, compared with lower bounds and with LeRobot's reader; bytes per frame.

Random exploration is collected once. A round times everything in turn, so that all have the same load. The table shows
medians over rounds, also of ratios. Windows have four frames and are drawn at random from split train. "none", "disk"
and "memory" say where our reader keeps its cache; torch's loader has it on disk.

Run: uv run python benchmarks/bench_dataset.py
"""

import itertools
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.config import load
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.verify import verify_release
from gym_open.envs.constants import CONTROL_DT_S
from gym_open.formats.logs.reader import open_logs
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import IMAGE, Release, open_release
from gym_open.formats.windows import Pictures, Windows
from gym_open.hardware import usable_cores

ROUNDS, STEPS, LENGTH, BATCH, BATCHES = 3, 20_000, 4, 64, 60
SOURCE = Path(__file__).parents[1] / "collect/random.toml"
LEROBOT = ("LeRobot", "LeRobot of two features")
"""LeRobot's reader by default, where windows also hold all other features of one frame, and limited to our features."""
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
Rates = dict[str, float]


def rate(count: float, work: Callable[[], Any]) -> float:
    """Items per second, if `work` processes `count` items."""
    began = time.perf_counter()
    work()
    return count / (time.perf_counter() - began)


def build(log: Path, release: Path) -> Rates:
    """Frames per second of a build, and of the steps that it cannot avoid."""
    pieces: list[np.ndarray] = []

    def read() -> None:
        for one in open_logs(log):
            pieces.extend(segment.images for segment in one.segments(ReleaseConfig().max_episode_steps))

    reading = rate(STEPS, read)
    frames = sum(map(len, pieces))
    spans = [piece[i : i + 128] for piece in pieces for i in range(0, len(piece), 128)]
    with ThreadPoolExecutor(usable_cores()) as pool:
        encoding = rate(frames, lambda: list(pool.map(encode_pngs, spans)))
    building = rate(frames, lambda: build_release(ReleaseConfig(), [log], release))
    return {"log reading alone": reading, "PNG encoding alone": encoding, "build": building}


def verify(release: Path) -> Rates:
    """Verified steps per second."""
    return {
        "verify": rate(STEPS, lambda: verify_release(release)),
        "verify, quick": rate(STEPS, lambda: verify_release(release, replay=False)),
    }


def read(release: Release, cache: Path) -> Rates:
    """Frames per second when a cache is made, and windows per second when it is read."""
    made: dict[str, Pictures] = {}
    frames = len(release)

    def make(name: str, **where: Any) -> float:
        return rate(frames, lambda: made.update({name: Pictures(release, **where)}))

    found = {"cache in memory": make("memory"), "cache on disk": make("disk", cache=cache)}
    opened = rate(1, lambda: Pictures(open_release(release.root), cache=cache))
    made["none"] = Pictures(release, limit_bytes=0)
    for name, count in itertools.product(made, (1, 2)):
        batches = Windows(made[name], "train", LENGTH).batches(np.random.default_rng(0), BATCH, workers=count)
        found[f"{name}, {count}"] = drained(batches, BATCHES if name != "none" else 4, BATCH)
    windows = Windows(made["disk"], "train", LENGTH)
    loader = torch.utils.data.DataLoader(windows, batch_size=BATCH, shuffle=True, num_workers=2)
    found["torch's loader, 2"] = drained(iter(loader), BATCHES // 4, BATCH)
    raw = release.images(release.split("train"))
    starts = np.random.default_rng(0).integers(0, len(raw) - LENGTH, (BATCHES, BATCH))
    found["memcpy"] = rate(starts.size, lambda: [np.stack([raw[i : i + LENGTH] for i in row]) for row in starts])
    return found | {"opens": opened, "cache bytes": made["disk"].nbytes / frames}


def drained(batches: Iterator[Any], count: int, size: int) -> float:
    """Windows per second in `count` batches of `size`, after a first batch."""
    next(batches)
    return rate(count * size, lambda: list(zip(range(count), batches, strict=False)))


def lerobot(release: Path) -> Rates:
    """Windows per second of LeRobot's reader, with the same contents."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    moments = [i * CONTROL_DT_S for i in range(LENGTH)]
    deltas = {IMAGE: moments, "action.index": moments}
    found = {}
    for name in LEROBOT:
        dataset = LeRobotDataset("open/explore", root=release, delta_timestamps=deltas)
        if name == LEROBOT[1]:
            dataset.hf_dataset = dataset.hf_dataset.select_columns([*deltas, *INDICES])
        for count in (0, 1, 2):
            loader = torch.utils.data.DataLoader(dataset, batch_size=16, shuffle=True, num_workers=count)
            found[f"{name}, {count}"] = drained(iter(loader), 12, 16)
    return found


def one_round(folder: Path, log: Path) -> Rates:
    path = folder / "1.0.0"
    found = build(log, path) | verify(path) | read(open_release(path), folder / "cache") | lerobot(path)
    size = sum(item.stat().st_size for item in path.rglob("*") if item.is_file())
    return found | {"bytes": size / len(open_release(path))}


def show(rounds: list[Rates]) -> None:
    def median(name: str) -> str:
        return f"{statistics.median(row[name] for row in rounds):,.0f}"

    def ratio(name: str, other: str) -> str:
        return f"{statistics.median(row[name] / row[other] for row in rounds):.2f}"

    console = Console(width=100)
    table = Table("build and verify", "per second", "× log reading", "× PNG encoding", title=f"{STEPS:,} steps")
    for name in ("log reading alone", "PNG encoding alone", "build"):
        table.add_row(
            f"{name} (frames)", median(name), ratio(name, "log reading alone"), ratio(name, "PNG encoding alone")
        )
    for name in ("verify, quick", "verify"):
        table.add_row(f"{name} (steps)", median(name), "", "")
    console.print(table)
    table = Table("4-frame windows", "per second", "× LeRobot's best", "× memcpy", title="read")
    names = [f"{name}, {count}" for name in ("none", "disk", "memory") for count in (1, 2)] + ["torch's loader, 2"]
    theirs = [f"{name}, {count}" for name in LEROBOT for count in (0, 1, 2)]
    best = max(theirs, key=lambda name: statistics.median(row[name] for row in rounds))
    for name in (*theirs, *names, "memcpy"):
        table.add_row(
            f"{name}" + " workers" * (name != "memcpy"), median(name), ratio(name, best), ratio(name, "memcpy")
        )
    console.print(table)
    opens = statistics.median(1000 / row["opens"] for row in rounds)
    console.print(
        f"cache: made at {median('cache in memory')} frames/s in memory, {median('cache on disk')} on disk; found "
        f"again in {opens:.0f} ms\nbytes a frame: {median('bytes')} of the release, {median('cache bytes')} cached"
    )


def main() -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        os.environ |= {"HF_HOME": f"{name}/hub", "HF_HUB_OFFLINE": "1"}
        log = collect(msgspec.structs.replace(load(SOURCE, CollectConfig), steps=STEPS), Path(name) / "log").path
        rounds = [one_round(Path(name) / f"round-{i}", log) for i in range(ROUNDS)]
    show(rounds)


if __name__ == "__main__":
    main()
