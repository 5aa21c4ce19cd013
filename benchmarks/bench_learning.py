"""Speed of encoder training and of exploration, compared with the matrix products alone of their networks.

Candidates, clock and limits are those of `bench_ppo.py`. A round of exploration is a rollout of
`collect/curl-ride.toml` with its update, the losses of its worlds and its log. A round of encoder training is `STEPS`
gradient steps on random images, without reading batches from a release.

Run: uv run python benchmarks/bench_learning.py [--threads 1 2] [--rounds 5]
"""

import argparse
import statistics
import tempfile
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import msgspec
import torch
from bench_ppo import MFLOP_BACKWARD, MFLOP_FORWARD, Work, alone, compare, products, ratio, with_torchs
from rich.console import Console
from rich.table import Table

from gym_open.agents.augment import draw_shifts
from gym_open.agents.encoder import IMAGE_SHAPE, Encoder, autocast
from gym_open.agents.world_model import TransitionBatch
from gym_open.agents.world_models import make_world_model
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import Exploration
from gym_open.config import load
from gym_open.envs.constants import N_ACTIONS
from gym_open.precision import Precision, native_precision
from gym_open.train.config import EncoderTrainConfig

STEPS = 4
PLAY = load(Path(__file__).parents[1] / "collect/curl-ride.toml", CollectConfig)
PASSES: dict[str, tuple[int, int]] = {"curl": (2, 1), "icm": (2, 2), "rnd": (2, 1)}
"""Forward and backward passes of an image in a gradient step."""
FULL = 8
"""Rollouts after which the transitions of every world are nearly complete."""


def encoder_training(name: str, precision: Precision) -> tuple[Work, int, float]:
    """Gradient steps as in `train encoder`, the number of their images, and their MFLOP."""
    config, generator = EncoderTrainConfig(world_model=name), torch.Generator().manual_seed(0)
    model = make_world_model(name, config, Encoder(config.encoder, generator), N_ACTIONS, generator)
    learned = [parameter for parameter in model.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(learned, lr=config.learning_rate, fused=True)
    size = config.batch_size
    obs, after = torch.randint(256, (2, size, *IMAGE_SHAPE), dtype=torch.uint8, generator=generator)
    actions = torch.randint(N_ACTIONS, (size,), generator=generator)

    def work() -> None:
        for _ in range(STEPS):
            drawn = draw_shifts(size, config.shift_pad, generator)
            with autocast(precision):
                loss, _ = model.measure(TransitionBatch(obs, actions, after), drawn, generator)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            model.stepped()

    forward, backward = PASSES[name]
    return work, STEPS * size, STEPS * size * (forward * MFLOP_FORWARD + backward * MFLOP_BACKWARD)


def exploration(precision: Precision, folder: Path, logs: ExitStack) -> tuple[Work, int, float]:
    """A rollout with its update, its steps, and its MFLOP: one pass of each image, and CURL's two networks."""
    ppo = msgspec.structs.replace(PLAY.explorer.ppo, precision=precision)
    config = msgspec.structs.replace(PLAY, explorer=msgspec.structs.replace(PLAY.explorer, ppo=ppo))
    (folder / "checkpoint").mkdir(parents=True)
    playing = Exploration(config, folder, logs)
    for _ in range(FULL):
        playing.rollout(config.rollout)
    steps = config.streams * config.rollout
    looked = config.streams * (config.rollout + 1) + 2 * config.streams * config.probe
    learned = ppo.update_epochs * steps
    mflop = looked * MFLOP_FORWARD + learned * (2 * MFLOP_FORWARD + MFLOP_BACKWARD)
    return partial(playing.rollout, config.rollout), steps, mflop


def measure(threads: int, rounds: int, folder: Path) -> Table:
    """One row per candidate."""
    precisions: list[Precision] = ["bf16", "fp32"] if native_precision() == "bf16" else ["fp32"]
    work: dict[str, Work] = {}
    images: dict[str, int] = {}
    with ExitStack() as logs:
        for precision in precisions:
            candidates = {f"train encoder, {name}, {precision}": encoder_training(name, precision) for name in PASSES}
            play = exploration(precision, folder / f"{threads} {precision}", logs)
            for name, (one, count, mflop) in {**candidates, f"collect, curl-ride, {precision}": play}.items():
                work[name], images[name] = alone(one, threads), count
                work[f"products of {name}"] = with_torchs(partial(products, mflop, precision), threads)
        found = compare(work, threads, rounds)
    table = Table("", "images/s", "× the products' time", title=f"threads: {threads}")
    for name, count in images.items():
        speed = count / statistics.median(found[name])
        table.add_row(name, f"{speed:,.0f}", ratio(found[name], found[f"products of {name}"]))
    return table


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for threads in options.threads:
            Console(width=100).print(measure(threads, options.rounds, Path(folder)))


if __name__ == "__main__":
    main()
