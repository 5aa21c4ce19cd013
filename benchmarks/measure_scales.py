"""How the loss of a world falls while a stream explores it, for every world model: the basis of the loss scales.

One stream explores four fresh worlds, one after the other. The script prints the raw loss by steps in the world, the
level that counts as learned (the threshold divided by the model's scale), and when the loss first reached it. It also
draws the curves.

Run: uv run python benchmarks/measure_scales.py docs/pictures/loss-scales.png     (a quarter of an hour on one core)
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.config import load

NAMES = ("curl-ride", "icm-ride", "rnd-ride", "curl-random", "icm", "rnd")
WORLDS, STAY, ROLLOUT = 4, 5120, 256
SHOWN = (256, 1024, 2560, 5120)
FOLDER = Path(__file__).parents[1] / "collect"
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")


def measure(name: str, folder: Path) -> tuple[np.ndarray, float]:
    """Raw loss of the current world, (worlds, rollouts of a segment), and the level that counts as learned."""
    config = load(FOLDER / f"{name}.toml", CollectConfig)
    curriculum = msgspec.structs.replace(config.curriculum, rule="interval", interval=STAY)
    sizes: dict[str, Any] = {"streams": 1, "rollout": ROLLOUT, "pool": WORLDS, "steps": WORLDS * STAY}
    made = collect(msgspec.structs.replace(config, curriculum=curriculum, **sizes), folder / name).path
    summary = msgspec.json.decode((made / "summary.json").read_bytes())
    scale = getattr(config.explorer, config.explorer.world_model).loss_scale
    losses = [row[summary["curve"]["columns"].index("world_loss")] for row in summary["curve"]["rows"]]
    return np.array(losses).reshape(WORLDS, -1) / scale, config.curriculum.threshold / scale


def draw(found: dict[str, tuple[np.ndarray, float]], path: Path) -> None:
    """One panel per explorer, with one line per world and the level that counts as learned."""
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    steps = ROLLOUT * (1 + np.arange(STAY // ROLLOUT))
    for axes, (name, (losses, learned)) in zip(figure.subplots(2, 3).flat, found.items(), strict=True):
        for number, (row, colour) in enumerate(zip(losses, COLOURS, strict=True), 1):
            axes.plot(steps, row, color=colour, label=f"world {number}", marker="os^D"[number - 1], markersize=3)
        axes.axhline(learned, color="black", linestyle="--", label="learned")
        axes.set(title=name, yscale="log", xlabel="steps in the world", ylabel="loss of the world, raw")
        axes.grid(alpha=0.3)
    figure.axes[0].legend()
    figure.savefig(path, metadata={"Software": None})


def main(path: Path) -> None:
    found: dict[str, tuple[np.ndarray, float]] = {}
    table = Table("explorer", "learned", "world", *(f"{steps:,}" for steps in SHOWN), "first learned after")
    for name in NAMES:
        with tempfile.TemporaryDirectory() as folder:
            found[name] = losses, learned = measure(name, Path(folder))
        for number, row in enumerate(losses, 1):
            under = np.flatnonzero(row < learned)
            after = f"{ROLLOUT * (1 + under[0]):,}" if under.size else "–"
            shown = (f"{row[steps // ROLLOUT - 1]:.3g}" for steps in SHOWN)
            table.add_row(name, f"{learned:.3g}", str(number), *shown, after)
    Console(width=110).print(table)
    draw(found, path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
