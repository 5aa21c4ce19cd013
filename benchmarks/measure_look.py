"""Which camera, with or without antialiasing, lets a linear probe find the objects best?

    .venv/bin/python benchmarks/measure_look.py

Every camera shows the same layouts after some moves. A ridge regression predicts the positions of agent, yellow and
green sphere from pixels, and from the features of an untrained encoder, with and without subtracting the mean image.
Test layouts are not in the training data. It takes ten minutes on one core.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.envs import constants as c
from gym_open.envs.observation.raycast import Image
from gym_open.envs.observation.scene import Scene
from gym_open.envs.options import CameraOptions, WorldOptions
from gym_open.envs.physics.model import INVENTORY, build_model
from gym_open.envs.puzzles import Placement, Puzzle, arranged
from gym_open.envs.world import World

CAMERAS = {
    "original": CameraOptions(),
    "original, narrowed to the table (54°)": CameraOptions(field_of_view=53.8),
    "original place, aimed and rolled to fit (48°)": CameraOptions(direction=(41.97, 27.48, 14.84), field_of_view=48.1),
    "from above (59°)": CameraOptions(position=(0, 0, 2.1), direction=(90, 0, 0), field_of_view=59.1),
}
LOOKS = [(camera, 1) for camera in CAMERAS] + [("original", 2), ("from above (59°)", 2)]
"""Camera, and number of rendered pixels per image pixel in each direction."""
PROBES = {
    "size": "",
    "guess": "mean place",
    "pixels": "pixels",
    "plain maps": "convolutions, plain",
    "centred maps": "convolutions, centred",
    "plain": "features, plain",
    "centred": "features, centred",
}
SOUGHT = ("agent", "yellow_0", "green_0")
STRENGTHS = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)


class Layouts(NamedTuple):
    """States of worlds after some moves."""

    qpos: np.ndarray
    """(n, nq)."""
    present: np.ndarray
    """(n, n_objects) bool."""


def random_puzzle(rng: np.random.Generator) -> Puzzle:
    """Agent, one goal of each kind and 5–8 cubes on random cells: their positions are independent."""
    kinds = ["agent", "yellow", "green", *rng.choice(["heavy", "light"], rng.integers(5, 9))]
    cells = rng.choice((c.ROWS - 2) * (c.COLUMNS - 2), len(kinds), replace=False)
    places = [(1 + int(i) // (c.COLUMNS - 2), 1 + int(i) % (c.COLUMNS - 2)) for i in cells]
    return Puzzle(
        "sandbox", arranged([Placement(str(kind), *place) for kind, place in zip(kinds, places, strict=True)])
    )


def play(count: int, rng: np.random.Generator) -> Layouts:
    """Layouts after some random steps, so that objects are not at the centres of cells."""
    world = World()
    qpos, present = np.empty((count, world.model.nq)), np.empty((count, len(INVENTORY)), bool)
    for i in range(count):
        world.load(random_puzzle(rng))
        for action in rng.integers(1, c.N_ACTIONS, 6):
            world.step(int(action))
        qpos[i], present[i] = world.data.qpos, world.present
    return Layouts(qpos, present)


def show(layouts: Layouts, camera: CameraOptions, supersampling: int) -> tuple[np.ndarray, np.ndarray]:
    """Images (n, 84, 84, 3) uint8, and the agent's size (n,) in pixels of these images."""
    options = WorldOptions(camera=camera, image_size=c.IMAGE_SIZE * supersampling)
    model = build_model(options)
    scene, data = Scene(model, options.image_size), mujoco.MjData(model)
    hit, agent = np.zeros(len(INVENTORY), bool), model.geom("agent").id
    images = np.empty((len(layouts.qpos), c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    sizes = np.empty(len(images))
    for i, (qpos, present) in enumerate(zip(*layouts, strict=True)):
        scene.load(data, present, recolour_hits=False)
        image = scene.image(qpos, hit)
        images[i] = shrunk(image, supersampling)
        sizes[i] = (image.label == agent).sum() / supersampling**2
    return images, sizes


def shrunk(image: Image, by: int) -> np.ndarray:
    """The colours, averaged over `by` × `by` pixels."""
    n = len(image.rgb) // by
    return np.round(image.rgb.reshape(n, by, n, by, 3).mean(axis=(1, 3))).astype(np.uint8)


def features(images: np.ndarray, train: slice, *, centred: bool, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of an untrained encoder's convolutions (n, 3136) and of its last layer (n, 512).

    If asked for, the mean training image is subtracted from every image.
    """
    encoder = Encoder(EncoderConfig(), torch.Generator().manual_seed(seed))
    every = torch.from_numpy(images)
    if centred:
        encoder.set_mean_image(every[train][:1000])
    with torch.no_grad():
        maps = torch.cat([encoder.layers[:-2](encoder.prepare(batch)) for batch in every.split(250)])
        return maps.numpy(), encoder.layers[-2:](maps).numpy()


def probe_error(x: np.ndarray, y: np.ndarray, train: slice, validation: slice, test: slice) -> np.ndarray:
    """Mean distance in cells, (objects,), between true and predicted positions. Validation data choose the ridge."""
    x = x - x[train].mean(axis=0)
    x /= np.sqrt(np.square(x[train]).sum(axis=1).mean())
    mean, known = y[train].mean(axis=0), x[train]
    wide = known.shape[1] > known.shape[0]
    gram = known @ known.T if wide else known.T @ known
    right = (y[train] - mean).astype(np.float32) if wide else known.T @ (y[train] - mean).astype(np.float32)
    best, error = np.inf, np.zeros(0)
    for strength in STRENGTHS:
        solved = np.linalg.solve(gram + strength * np.eye(len(gram), dtype=np.float32), right)
        weights = known.T @ solved if wide else solved
        if (loss := np.square(x[validation] @ weights + mean - y[validation]).mean()) < best:
            best = loss
            miss = (x[test] @ weights + mean - y[test]).reshape(-1, len(SOUGHT), 2)
            error = np.linalg.norm(miss, axis=2).mean(axis=0)
    return error


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--pictures", type=int, default=5000, help="number of images: a fifth for the test, a tenth for validation"
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    n = arguments.pictures
    train, validation, test = slice(n * 7 // 10), slice(n * 7 // 10, n * 8 // 10), slice(n * 8 // 10, n)
    columns = [INVENTORY.index(name) for name in SOUGHT]
    found: dict[tuple[str, int], dict[str, list[np.ndarray]]] = {look: {name: [] for name in PROBES} for look in LOOKS}
    for seed in track(range(arguments.seeds), "seeds"):
        layouts = play(n, np.random.default_rng(seed))
        y = layouts.qpos.reshape(n, -1, 7)[:, columns, :2].reshape(n, -1) / c.PITCH
        for look, row in found.items():
            images, sizes = show(layouts, CAMERAS[look[0]], look[1])
            row["size"].append(np.array([sizes.mean(), np.quantile(sizes, 0.01)]))
            row["pixels"].append(probe_error(images.reshape(n, -1).astype(np.float32), y, train, validation, test))
            row["guess"].append(probe_error(np.ones((n, 1), np.float32), y, train, validation, test))
            for name in ("plain", "centred"):
                maps, last = features(images, train, centred=name == "centred", seed=seed)
                row[f"{name} maps"].append(probe_error(maps, y, train, validation, test))
                row[name].append(probe_error(last, y, train, validation, test))
    Console(width=250).print(table_of(found))


def table_of(found: dict[tuple[str, int], dict[str, list[np.ndarray]]]) -> Table:
    """Means over seeds, ± half the range."""
    probes = {name: title for name, title in PROBES.items() if title}
    table = Table(
        "camera",
        "AA",
        "agent, pixels",
        *probes.values(),
        title="distance in cells: agent, yellow, green",
    )
    for (name, supersampling), row in found.items():
        cells = ["  ".join(f"{mean:.2f}±{half:.2f}" for mean, half in spread(row[key])) for key in probes]
        size, least = np.mean(row["size"], axis=0)
        table.add_row(name, f"{supersampling}×{supersampling}", f"{size:.1f}, 1%: {least:.1f}", *cells)
    return table


def spread(runs: list[np.ndarray]) -> list[tuple[float, float]]:
    """Mean and half range over the runs, for each object."""
    each = np.array(runs)
    return list(zip(each.mean(axis=0).tolist(), ((each.max(axis=0) - each.min(axis=0)) / 2).tolist(), strict=True))


if __name__ == "__main__":
    main()
