"""`gym-open train probe`: what a linear map can read from a frozen encoder about tables it never saw."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gym_open import artefacts, progress, seeding
from gym_open.agents.encoder import Encoder
from gym_open.artefacts import Lineage
from gym_open.envs.constants import IMAGE_SIZE, PITCH
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World
from gym_open.formats.models import load_encoder
from gym_open.train.config import ProbeConfig
from gym_open.train.ridge import fit_ridge, r_squared

PROBE = "probe.json"
TARGETS = {"agent": "agent", "yellow": "yellow_0", "green": "green_0"}
"""What is looked for, and its body in the model."""
ONE_OF_EACH = SandboxConfig(yellow=(1, 1), green=(1, 1))
"""Sandbox worlds where "the yellow goal" and "the green goal" each mean one thing."""
BATCH = 500


@dataclass(frozen=True)
class Sample:
    """Worlds, one picture each: (n, 84, 84, 3) uint8, and table positions (n, 2) in metres by target."""

    images: Tensor
    positions: dict[str, Tensor]


def probe(config: ProbeConfig, encoder: Path, out: Path) -> artefacts.Outcome:
    """Probe a frozen encoder, an untrained one of the same architecture, and the pixels, for where things are.

    Payload: `probe.json`, `{"targets": {target: {features: {"r2", "error_cells"}}}, "worlds": {part: n}}` with targets
    `agent`, `yellow`, `green` and features `trained`, `untrained`, `pixels`. `r2` is over both coordinates on held-out
    worlds; `error_cells` is the mean distance to the true position there, in cells of the grid.

    Args:
        config: number of worlds, strengths of regularisation, seed.
        encoder: an encoder artefact.
        out: folder of the result.

    Raises:
        ArtefactError: if the encoder is damaged.
    """

    def work(partial: Path) -> Mapping[str, Any]:
        torch.set_num_threads(config.threads)
        trained = load_encoder(encoder)
        known = logged_puzzles(artefacts.lineage(encoder))
        sizes = {"train": config.train_worlds, "validation": config.validation_worlds, "test": config.test_worlds}
        samples = draw_samples(sizes, known, config.seed)
        record = {"targets": score(config, trained, samples), "worlds": sizes}
        (partial / PROBE).write_bytes(artefacts.canonical_json(record))
        return {"worlds": sum(sizes.values())}

    return artefacts.build(out, kind="probe", config=config, parents=[encoder], work=work)


def logged_puzzles(lineage: Lineage) -> set[str]:
    """Digests of all puzzles in the logs that an artefact comes from."""
    own = set(lineage.facts.get("puzzles", []))
    return own.union(*(logged_puzzles(parent.lineage) for parent in lineage.parents))


def draw_samples(sizes: Mapping[str, int], known: set[str], seed: int) -> dict[str, Sample]:
    """Fresh sandbox worlds by part; no world is in `known` (digests), and none is drawn twice."""
    world, used, samples = World(), set(known), {}
    with progress.bar("draw probe worlds", sum(sizes.values())) as bar:
        for part, size in sizes.items():
            rng = seeding.generator(seed, "probe", part)
            images = torch.empty((size, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=torch.uint8)
            positions = {target: torch.empty((size, 2), dtype=torch.float64) for target in TARGETS}
            for i in range(size):
                world.load(_fresh_puzzle(rng, used))
                images[i] = torch.from_numpy(world.observe())
                state = world.object_state()
                for target, body in TARGETS.items():
                    positions[target][i] = torch.from_numpy(state[INVENTORY.index(body), :2])
                bar.advance()
            samples[part] = Sample(images, positions)
    return samples


def _fresh_puzzle(rng: np.random.Generator, used: set[str]) -> Puzzle:
    while True:
        puzzle = sample_puzzle("sandbox", rng, ONE_OF_EACH)
        if puzzle.digest not in used:
            used.add(puzzle.digest)
            return puzzle


def score(config: ProbeConfig, trained: Encoder, samples: Mapping[str, Sample]) -> dict[str, dict[str, Any]]:
    """Scores by target and kind of features."""
    init = torch.Generator().manual_seed(seeding.integer(config.seed, "probe", "untrained"))
    untrained = Encoder(trained.config, init)
    untrained.mean_image.copy_(trained.mean_image)
    readers: dict[str, Callable[[Tensor], Tensor]] = {"trained": trained, "untrained": untrained}
    if config.pixels:
        readers["pixels"] = nn.Flatten()
    y = {part: torch.cat(list(sample.positions.values()), dim=1) for part, sample in samples.items()}
    scores: dict[str, dict[str, Any]] = {target: {} for target in TARGETS}
    with progress.bar("probe", len(readers)) as bar:
        for name, read in readers.items():
            x = {part: _features(read, trained, sample.images) for part, sample in samples.items()}
            predicted = fit_ridge(x["train"], y["train"], (x["validation"], y["validation"]), config.ridge).predict(
                x["test"]
            )
            for target, found in zip(TARGETS, predicted.split(2, dim=1), strict=True):
                true = samples["test"].positions[target]
                error = (found - true).norm(dim=1).mean() / PITCH
                scores[target][name] = {"r2": r_squared(found, true), "error_cells": error.item()}
            bar.advance()
    return scores


@torch.no_grad()
def _features(read: Callable[[Tensor], Tensor], encoder: Encoder, images: Tensor) -> Tensor:
    return torch.cat([read(encoder.prepare(batch)) for batch in images.split(BATCH)]).double()
