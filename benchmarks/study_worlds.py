"""How many worlds does exploration need before an encoder can locate objects? And how much does this help a policy?

    .venv/bin/python benchmarks/study_worlds.py --out /tmp/told            # a table, and an encoder for every row
    gym-open train policy --config train/policy-strong.toml --encoder /tmp/told/cells-5000 --agent told-cells
    gym-open train policy --config train/policy-strong.toml --encoder /tmp/told/agent-50 --agent told-agent

The paper's network learns with supervision, from images of random exploration: either the cells of agent, goals and
cubes (`cells`), or the position of the agent alone (`agent`). The same number of images comes from few worlds or from
many. There is no world model: the result shows what the images allow, not what an objective finds.

In new worlds, it must find the cells: of the n objects of a kind, how many are in the n most likely cells. Or it must
find the agent: its mean error in cells.
"""

import argparse
import itertools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

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
"""Random moves between two images of one world."""
HELD_OUT = 500


class TellConfig(Config, frozen=True, kw_only=True):
    """Configuration of such an encoder."""

    what: Literal["cells", "agent"]
    worlds: int
    pictures: int = 10_000
    updates: int = 2_000
    batch_size: int = 128
    learning_rate: float = 5e-4
    seed: int = 0


class LabelledImages(NamedTuple):
    """Images of random exploration, and their labels."""

    images: Tensor
    """(N, 84, 84, 3) uint8."""
    cells: Tensor
    """Which cells hold an object, (N, kinds, cells) float32."""
    agent: Tensor
    """Position of the agent, (N, 2) float32, in cells from the middle of the table."""


def draw(worlds: int, pictures: int, rng: np.random.Generator) -> LabelledImages:
    """Draw images of `worlds` new worlds, equally many of each."""
    world = World()
    images = np.empty((pictures, c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    there = np.zeros((pictures, len(KINDS), CELLS), np.float32)
    agent = np.empty((pictures, 2), np.float32)
    ends = np.linspace(0, pictures, worlds + 1).astype(int)
    with progress.bar("draw worlds", worlds) as bar:
        for first, last in itertools.pairwise(ends.tolist()):
            world.load(sample_puzzle("sandbox", rng))
            for i in range(first, last):
                for action in rng.integers(1, c.N_ACTIONS, size=APART).tolist():
                    world.step(action)
                world.observe(images[i])
                places = world.object_state()[:, :2]
                agent[i] = places[BODIES[0][0]] / c.PITCH
                for kind, bodies in enumerate(BODIES):
                    own = places[bodies]
                    there[i, kind, cell_of(own[np.abs(own[:, 1]) < c.WALL_Y])] = 1
            bar.advance()
    return LabelledImages(torch.from_numpy(images), torch.from_numpy(there), torch.from_numpy(agent))


def cell_of(places: np.ndarray) -> np.ndarray:
    """Number of the grid cell that is nearest to each position, (n, 2) in metres."""
    columns = np.clip(np.rint((places[:, 0] - c.CELL_0[0]) / c.PITCH), 0, c.COLUMNS - 1)
    rows = np.clip(np.rint((c.CELL_0[1] - places[:, 1]) / c.PITCH), 0, c.ROWS - 1)
    return (rows * c.COLUMNS + columns).astype(int)


def supervise(config: TellConfig, encoder: Encoder, head: nn.Linear, labelled: LabelledImages) -> None:
    """Train encoder and head to predict the occupied cells, or the position of the agent."""
    rng = seeding.generator(config.seed, "tell", "batches")
    optimizer = torch.optim.Adam([*encoder.parameters(), *head.parameters()], lr=config.learning_rate, fused=True)
    with progress.bar(f"{config.worlds:,} worlds", config.updates) as bar:
        for _ in range(config.updates):
            chosen = torch.from_numpy(rng.integers(len(labelled.images), size=config.batch_size))
            with autocast("auto"):
                answer = head(encoder(encoder.prepare(labelled.images[chosen])))
            if config.what == "cells":
                truth = labelled.cells[chosen].flatten(1)
                loss = nn.functional.binary_cross_entropy_with_logits(answer.float(), truth)
            else:
                loss = nn.functional.mse_loss(answer.float(), labelled.agent[chosen])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            bar.advance(note=f"loss {loss.item():.4f}")


@torch.no_grad()
def found(encoder: Encoder, head: nn.Linear, labelled: LabelledImages) -> list[float]:
    """Share of occupied cells that are among the n most likely ones, by kind. n is the number of occupied cells."""
    logits = head(torch.cat([encoder.encode(part) for part in labelled.images.split(250)])).view(labelled.cells.shape)
    best = logits.argsort(dim=-1, descending=True).argsort(dim=-1)
    named = (best < labelled.cells.sum(dim=-1, keepdim=True)) & labelled.cells.bool()
    return (named.sum(dim=(0, 2)) / labelled.cells.sum(dim=(0, 2))).tolist()


@torch.no_grad()
def missed_by(encoder: Encoder, head: nn.Linear, labelled: LabelledImages) -> list[float]:
    """Mean distance in cells between the agent and its predicted position."""
    answer = head(torch.cat([encoder.encode(part) for part in labelled.images.split(250)]))
    return [(answer - labelled.agent).norm(dim=1).mean().item()]


def study(config: TellConfig, out: Path, held_out: LabelledImages) -> list[float]:
    """Train the encoder of one row, and measure it in new worlds."""

    def work(folder: Path) -> Mapping[str, Any]:
        init = torch.Generator().manual_seed(seeding.integer(config.seed, "tell", "init"))
        encoder = Encoder(EncoderConfig(), init)
        head = nn.Linear(encoder.config.features, len(KINDS) * CELLS if config.what == "cells" else 2)
        labelled = draw(config.worlds, config.pictures, seeding.generator(config.seed, "tell", config.worlds))
        encoder.set_mean_image(labelled.images)
        supervise(config, encoder, head, labelled)
        save_encoder(folder, encoder)
        knows = (found if config.what == "cells" else missed_by)(encoder, head, held_out)
        return {"world_model": "told", "worlds": config.worlds, "knows": knows}

    made = artefacts.build(out, kind="encoder", config=config, parents=[], work=work)
    return artefacts.lineage(made.path).facts["knows"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the encoders")
    parser.add_argument("--what", choices=("cells", "agent"), default="cells", help="what it learns to predict")
    parser.add_argument("--worlds", type=int, nargs="+", default=[10, 50, 500, 5_000])
    parser.add_argument("--pictures", type=int, default=10_000)
    parser.add_argument("--updates", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    held_out = draw(HELD_OUT, HELD_OUT, seeding.generator(given.seed, "tell", "held out"))
    named = [f"{kind} found" for kind in KINDS] if given.what == "cells" else ["agent missed by, cells"]
    table = Table("worlds", *named, "seconds", title="in new worlds")
    for worlds in given.worlds:
        began = time.perf_counter()
        config = TellConfig(
            what=given.what, worlds=worlds, pictures=given.pictures, updates=given.updates, seed=given.seed
        )
        knows = study(config, given.out / f"{given.what}-{worlds}", held_out)
        table.add_row(f"{worlds:,}", *(f"{one:.2f}" for one in knows), f"{time.perf_counter() - began:.0f}")
    table.add_row("chance", *(f"{one:.2f}" for one in chance(given.what, held_out)), "")
    Console().print(table)


def chance(what: str, labelled: LabelledImages) -> list[float]:
    """Result of random cells; and the mean distance of the agent from its mean position."""
    if what == "agent":
        return [(labelled.agent - labelled.agent.mean(dim=0)).norm(dim=1).mean().item()]
    return (labelled.cells.sum(dim=(0, 2)) / HELD_OUT / CELLS).tolist()


if __name__ == "__main__":
    main()
