"""Time to pack, verify, restore and read a compact release, compared with lower bounds; bytes per step.

Random exploration is collected once. A round times everything in turn, so that all have the same load. The table shows
medians over rounds, also of ratios. The lower bound of restoring is to simulate, draw and encode every frame in threads
and to do nothing else; that of a cache is to simulate and draw.

Run: uv run python benchmarks/bench_compact.py
"""

import resource
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table

from gym_open import artefacts
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.config import load
from gym_open.datasets.build import build_release
from gym_open.datasets.compact.overview import sizes_of
from gym_open.datasets.compact.pack import pack_release
from gym_open.datasets.compact.restore import restore_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.verify import verify_release
from gym_open.formats.compact import open_compact
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.windows import Pictures
from gym_open.replay.compact import open_dataset
from gym_open.replay.compact.player import CompactPlayer, in_order, stored_episodes
from gym_open.replay.compact.release import content_of

ROUNDS, STEPS = 3, 20_480
SOURCE = Path(__file__).parents[1] / "collect/random.toml"
Rates = dict[str, float]


def rate(count: float, work: Callable[[], Any]) -> float:
    """Items per second, if `work` processes `count` items."""
    began = time.perf_counter()
    work()
    return count / (time.perf_counter() - began)


def bounds(root: Path, frames: int) -> Rates:
    """Frames per second of the parts of the work, in threads."""
    compact = open_compact(root)

    def played(task: Callable[[Any], Any], *, images: bool = True) -> float:
        player = CompactPlayer(compact)
        done = in_order(stored_episodes(compact), lambda stored: task(player.play(stored, images=images)))
        return rate(frames, lambda: [None for _ in done])

    return {
        "simulate": played(lambda _: None, images=False),
        "simulate, draw": played(lambda _: None),
        "simulate, draw, digest": played(content_of),
        "simulate, draw, encode": played(lambda one: encode_pngs(one.images)),
    }


def one_round(folder: Path, release: Path, frames: int) -> Rates:
    for name in ("packed", "back", "caches"):
        shutil.rmtree(folder / name, ignore_errors=True)
    packed = folder / "packed"
    found = {"pack": rate(frames, lambda: pack_release(release, packed))}
    found |= bounds(packed, frames)
    found["verify"] = rate(frames, lambda: verify_release(packed))
    found["restore"] = rate(frames, lambda: restore_release(packed, folder / "back"))
    for name, root in (("cache from PNG", release), ("cache from actions", packed)):
        opened = open_dataset(root)
        found[name] = rate(frames, lambda opened=opened, name=name: Pictures(opened, cache=folder / "caches" / name))
    assert artefacts.digest(folder / "back") == artefacts.digest(release)
    return found


def show(rounds: list[Rates], sizes: dict[str, float]) -> None:
    def median(name: str) -> str:
        return f"{statistics.median(row[name] for row in rounds):,.0f}"

    def ratio(name: str, other: str) -> str:
        return f"{statistics.median(row[name] / row[other] for row in rounds):.2f}"

    console = Console(width=100)
    table = Table("", "frames per second", "× simulate, draw, encode", title=f"{STEPS:,} steps of random play")
    for name in ("simulate", "simulate, draw", "simulate, draw, digest", "simulate, draw, encode", "pack", "verify"):
        table.add_row(name, median(name), ratio(name, "simulate, draw, encode"))
    table.add_row("restore", median("restore"), ratio("restore", "simulate, draw, encode"))
    console.print(table)
    table = Table("", "frames per second", "× cache from PNG")
    for name in ("cache from PNG", "cache from actions"):
        table.add_row(name, median(name), ratio(name, "cache from PNG"))
    console.print(table)
    table = Table("bytes per step", "")
    for name, size in sizes.items():
        table.add_row(name, f"{size:,.3f}")
    console.print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    console.print(f"greatest memory of this process: {peak:,.0f} MiB")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = msgspec.structs.replace(load(SOURCE, CollectConfig), steps=STEPS)
        log = collect(config, folder / "log").path
        release = build_release(ReleaseConfig(), [log], folder / "1.0.0").path
        film = build_release(ReleaseConfig(pictures="video"), [log], folder / "film").path
        frames = len(open_dataset(release))
        rounds = [one_round(folder, release, frames) for _ in range(ROUNDS)]
        compact = open_compact(folder / "packed")
        sizes = {name: size / STEPS for name, size in sizes_of(compact).items()}
        for kind, root in (("release with PNG", release), ("release with lossless video", film), ("log", log)):
            sizes[kind] = sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / STEPS
    show(rounds, sizes)


if __name__ == "__main__":
    main()
