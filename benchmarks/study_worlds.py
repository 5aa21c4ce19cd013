"""How many worlds must play see before an encoder can know where things are? And what is it worth to know?

    .venv/bin/python benchmarks/study_worlds.py --out /tmp/told            # a table, and an encoder for every row
    gym-open train policy --config train/policy-strong.toml --encoder /tmp/told/worlds-5000 --agent told-5000

The paper's network is told, in pictures of random play, which cell of the table each agent, goal and cube is in. The
same number of pictures comes from few worlds or from many. In new worlds it must name the cells: of the n objects of a
kind, how many lie in the n cells that it holds most likely. No world model is involved: this is what the pictures, not
the objective, allow.
"""

import argparse
import itertools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from gym_open import artefacts, progress, seeding
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder, autocast
from gym_open.config import Config
from gym_open.envs import constants as c
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.world import World
from gym_open.formats.models import save_encoder

KINDS = ("agent", "yellow", "green", "heavy", "light")
BODIES = [[i for i, body in enumerate(INVENTORY) if body.split("_")[0] == kind] for kind in KINDS]
CELLS = c.ROWS * c.COLUMNS
APART = 3
"""Random moves between two pictures of one world."""
HELD_OUT = 500


class TellConfig(Config, frozen=True, kw_only=True):
    """What decides such an encoder."""

    worlds: int
    pictures: int = 10_000
    updates: int = 2_000
    batch_size: int = 128
    learning_rate: float = 5e-4
    seed: int = 0


def draw(worlds: int, pictures: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Pictures (N, 84, 84, 3) uint8 of random play, and which cells hold something, (N, kinds, cells) float32."""
    world = World()
    images = np.empty((pictures, c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    there = np.zeros((pictures, len(KINDS), CELLS), np.float32)
    ends = np.linspace(0, pictures, worlds + 1).astype(int)
    with progress.bar("draw worlds", worlds) as bar:
        for first, last in itertools.pairwise(ends.tolist()):
            world.load(sample_puzzle("sandbox", rng))
            for i in range(first, last):
                for action in rng.integers(1, c.N_ACTIONS, size=APART).tolist():
                    world.step(action)
                world.observe(images[i])
                places = world.object_state()[:, :2]
                for kind, bodies in enumerate(BODIES):
                    own = places[bodies]
                    there[i, kind, cell_of(own[np.abs(own[:, 1]) < c.WALL_Y])] = 1
            bar.advance()
    return torch.from_numpy(images), torch.from_numpy(there)


def cell_of(places: np.ndarray) -> np.ndarray:
    """Number of the grid cell that is nearest to each of the places, (n, 2) in metres."""
    columns = np.clip(np.rint((places[:, 0] - c.CELL_0[0]) / c.PITCH), 0, c.COLUMNS - 1)
    rows = np.clip(np.rint((c.CELL_0[1] - places[:, 1]) / c.PITCH), 0, c.ROWS - 1)
    return (rows * c.COLUMNS + columns).astype(int)


def tell(config: TellConfig, encoder: Encoder, head: nn.Linear, images: Tensor, there: Tensor) -> None:
    """Teach encoder and head which cells are taken."""
    rng = seeding.generator(config.seed, "tell", "batches")
    learned = [*encoder.parameters(), *head.parameters()]
    optimizer = torch.optim.Adam(learned, lr=config.learning_rate, fused=True)
    with progress.bar(f"{config.worlds:,} worlds", config.updates) as bar:
        for _ in range(config.updates):
            chosen = torch.from_numpy(rng.integers(len(images), size=config.batch_size))
            with autocast("bf16", "cpu"):
                logits = head(encoder(encoder.prepare(images[chosen])))
            loss = nn.functional.binary_cross_entropy_with_logits(logits.float(), there[chosen].flatten(1))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            bar.advance(note=f"loss {loss.item():.4f}")


def found(encoder: Encoder, head: nn.Linear, images: Tensor, there: Tensor) -> list[float]:
    """By kind, the share of taken cells that are among the n most likely ones, n being how many are taken."""
    with torch.no_grad():
        features = torch.cat([encoder.encode(part) for part in images.split(250)])
        logits = head(features).view(len(images), len(KINDS), CELLS)
    best = logits.argsort(dim=-1, descending=True).argsort(dim=-1)
    named = (best < there.sum(dim=-1, keepdim=True)) & there.bool()
    return (named.sum(dim=(0, 2)) / there.sum(dim=(0, 2))).tolist()


def study(config: TellConfig, out: Path, held_out: tuple[Tensor, Tensor]) -> list[float]:
    """Make the encoder of one row, and say what it finds in new worlds."""

    def work(folder: Path) -> Mapping[str, Any]:
        init = torch.Generator().manual_seed(seeding.integer(config.seed, "tell", "init"))
        encoder = Encoder(EncoderConfig(), init)
        head = nn.Linear(encoder.config.features, len(KINDS) * CELLS)
        images, there = draw(config.worlds, config.pictures, seeding.generator(config.seed, "tell", config.worlds))
        encoder.set_mean_image(images)
        tell(config, encoder, head, images, there)
        save_encoder(folder, encoder)
        return {"world_model": "told", "worlds": config.worlds, "found": found(encoder, head, *held_out)}

    made = artefacts.build(out, kind="encoder", config=config, parents=[], work=work)
    return artefacts.lineage(made.path).facts["found"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the encoders")
    parser.add_argument("--worlds", type=int, nargs="+", default=[10, 50, 500, 5_000])
    parser.add_argument("--pictures", type=int, default=10_000)
    parser.add_argument("--updates", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    held_out = draw(HELD_OUT, HELD_OUT, seeding.generator(given.seed, "tell", "held out"))
    table = Table("worlds", *(f"{kind} found" for kind in KINDS), "seconds", title="objects found in new worlds")
    for worlds in given.worlds:
        began = time.perf_counter()
        config = TellConfig(worlds=worlds, pictures=given.pictures, updates=given.updates, seed=given.seed)
        shares = study(config, given.out / f"worlds-{worlds}", held_out)
        table.add_row(f"{worlds:,}", *(f"{share:.2f}" for share in shares), f"{time.perf_counter() - began:.0f}")
    chance = held_out[1].sum(dim=(0, 2)) / HELD_OUT / CELLS
    table.add_row("chance", *(f"{share:.2f}" for share in chance.tolist()), "")
    Console().print(table)


if __name__ == "__main__":
    main()
