"""What is play worth without a single step of a task? Plans over objects, with a forward model from play alone.

    gym-open collect --config collect/random-wide.toml
    gym-open dataset build --logs collect/logs/random-wide
    gym-open train encoder --config train/encoder-objects.toml --release datasets/open/explore/1.0.0
    .venv/bin/python benchmarks/study_zero_shot.py --release datasets/open/explore/1.0.0 \\
        --encoder train/encoders/encoder-objects --task goal-seeking

From play, a small network learns how far a move takes the agent, given what is in front of it: the masses in boxes
around the agent, turned so that the move points one way. A plan is the shortest path over places one move apart; a step
costs 1 / progress. The planner is told what the task wants in colours: which to touch, and which to avoid. Nothing is
learned from the task. The plan is made anew before each action, and remembers nothing.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open import artefacts, progress, seeding
from gym_open.agents.config import BOXES
from gym_open.agents.objects.encoders import SlotEncoder
from gym_open.agents.objects.plane import Plane, plane_of
from gym_open.agents.objects.readout import EDGES, _write_grid
from gym_open.agents.symmetry import ELEMENTS
from gym_open.envs.constants import COLOUR, MOVES, SCENERY_COLOUR
from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.sets import puzzles_of
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import play
from gym_open.evaluate.scores import summarise
from gym_open.formats.models import load_encoder
from gym_open.formats.releases import IMAGE, open_release
from gym_open.formats.windows import Pictures, Windows
from gym_open.hardware import hardware
from gym_open.version import __version__

NEAR = 4
"""Boxes on each side of the agent that the forward model sees: 3.2 moves."""
TOUCH = 0.95
"""Moves between two centres that touch: a diameter is 0.71, and centroids are inexact."""
CLOSER = 0.3
"""Moves by which a move must come closer to a goal to touch it."""
AFRAID = 1.9
"""Moves from the middle of a danger patch that a plan keeps away."""
UPDATES, BATCH, SWEEPS = 1500, 256, 60
SHADES = np.linspace(0.5, 1.0, 6)
"""Light and shaded sides of an object show its colour times these."""
TASKS: tuple[Task, ...] = ("goal-seeking", "avoidance")
"""Tasks that want the agent to touch yellow. On tool-use, play by random moves hardly ever leaves a pen, so the forward
model knows no way out; preferences need a memory of what was touched."""


class Scene(NamedTuple):
    """What an encoder sees in one image."""

    maps: np.ndarray
    """(42, 42, K), without the agent."""
    agent: np.ndarray
    """(x, y) in moves."""


class Eye:
    """Scenes and boxes around any place, from an encoder of colour slots."""

    def __init__(self, encoder: SlotEncoder) -> None:
        self.encoder = encoder
        self.plane: Plane = plane_of(encoder.homography.numpy())
        self.reach = encoder.reach.numpy()
        self.boxes = np.flatnonzero(np.abs(np.indices((BOXES, BOXES)) - BOXES // 2).max(axis=0).ravel() <= NEAR)
        self.turns = _turns_of_boxes()

    @torch.no_grad()
    def look(self, images: Tensor) -> Iterator[Scene]:
        """The scene of each image."""
        for maps in self.encoder.maps(images).numpy():
            own = maps[..., self.encoder.agent] * self.plane.weights
            agent = (own[..., None] * self.plane.places).sum(axis=(0, 1)) / max(own.sum(), 1e-3)
            others = maps.copy()
            others[..., self.encoder.agent] = 0
            yield Scene(others, agent)

    def around(self, maps: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Masses in the near boxes around a place and distances to the walls, for each of the eight symmetries."""
        slots = maps.shape[2]
        grid = np.zeros(slots * BOXES * BOXES, np.float32)
        _write_grid(maps, self.plane.places, self.plane.weights, place[0], place[1], EDGES, grid)
        grid = grid.reshape(slots, BOXES * BOXES)
        walls = np.array([self.reach[0] - place[0], self.reach[1] - place[1], self.reach[0] + place[0],
                          self.reach[1] + place[1]]).clip(-1, 3)  # fmt: skip
        return np.stack([
            np.concatenate([grid[:, self.turns[g]][:, self.boxes].ravel(), walls[_WALL_TURNS[g]]]) for g in range(8)
        ])  # fmt: skip


def _turns_of_boxes() -> np.ndarray:
    """For each symmetry, the box that it takes to each box, (8, 225)."""
    middle = BOXES // 2
    boxes = np.moveaxis(np.indices((BOXES, BOXES)), 0, -1).reshape(-1, 2) - middle
    sources = [boxes @ element for element in ELEMENTS]
    return np.array([(one[:, 0] + middle) * BOXES + one[:, 1] + middle for one in sources])


_SIDES = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
_WALL_TURNS = np.array([
    [next(i for i, side in enumerate(_SIDES) if (side == (element.T @ one)).all()) for one in _SIDES]
    for element in ELEMENTS
])  # fmt: skip
_STRAIGHT = [move for move in range(1, 9) if 0 in MOVES[move]]
CANON = np.array([
    next(g for g, one in enumerate(ELEMENTS) if not move or tuple(one @ MOVES[move]) == MOVES[2 - (move in _STRAIGHT)])
    for move in range(9)
])  # fmt: skip
"""Symmetry that turns each move to the east, or to the north-east."""


def forward_model(eye: Eye, windows: Windows, seed: int) -> dict[bool, nn.Sequential]:
    """Networks for straight and for diagonal moves: from boxes to the share of the move that is made."""
    inputs: dict[bool, list[np.ndarray]] = {True: [], False: []}
    made: dict[bool, list[float]] = {True: [], False: []}
    with progress.bar("play", len(windows)) as bar:
        for begin in range(0, len(windows), 500):
            batch = windows.fetch(np.arange(begin, min(begin + 500, len(windows))))
            images, actions = torch.from_numpy(batch[IMAGE]), batch["action.index"][:, 0]
            scenes, later = eye.look(images[:, 0]), eye.look(images[:, 1])
            for before, after, action in zip(scenes, later, actions.tolist(), strict=True):
                if action:
                    way, kind = np.array(MOVES[action]), action in _STRAIGHT
                    inputs[kind].append(eye.around(before.maps, before.agent)[CANON[action]])
                    made[kind].append(float(((after.agent - before.agent) @ way / (way @ way)).clip(0, 1)))
            bar.advance(len(actions))
    return {kind: _fit(np.stack(inputs[kind]), np.array(made[kind], np.float32), seed) for kind in (True, False)}


def _fit(inputs: np.ndarray, made: np.ndarray, seed: int) -> nn.Sequential:
    x, y = torch.from_numpy(inputs).float(), torch.from_numpy(made)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = nn.Sequential(nn.Linear(x.shape[1], 64), nn.ReLU(), nn.Dropout(0.2), nn.Linear(64, 1))
        optimizer = torch.optim.AdamW(net.parameters(), lr=1e-3, weight_decay=0.1)
        rng = seeding.generator(seed, "zero-shot", "batches")
        held_out = torch.from_numpy(rng.random(len(x)) < 0.1)
        learned = (~held_out).nonzero().flatten().numpy()
        for _ in range(UPDATES):
            chosen = torch.from_numpy(rng.choice(learned, BATCH))
            loss = F.binary_cross_entropy_with_logits(net(x[chosen]).flatten(), y[chosen])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        net.eval()
        with torch.no_grad():
            error = (net(x[held_out]).flatten().sigmoid() - y[held_out]).square().mean() / y.var()
    print(f"forward model: R² {1 - float(error):.2f} on {int(held_out.sum())} held-out moves of play")
    return net


def slots_of(encoder: SlotEncoder) -> dict[str, list[int]]:
    """Slots whose colour is a shade of that of each kind of thing."""
    table = encoder.mean_image.permute(1, 2, 0)[30:60, 20:50].median(dim=0).values.median(dim=0).values.numpy()
    seen = encoder.colours.numpy() * 255 / encoder.config.pixel_scale + table
    shades = {kind: SHADES[:, None] * np.array(colour) for kind, colour in {**COLOUR, **SCENERY_COLOUR}.items()}
    nearest = [min(shades, key=lambda kind: np.linalg.norm(shades[kind] - one, axis=1).min()) for one in seen]
    return {kind: [k for k, found in enumerate(nearest) if found == kind] for kind in shades}


class Graph(NamedTuple):
    """Places one move apart, around the agent."""

    nodes: np.ndarray
    """(places, 2) in moves."""
    number: np.ndarray
    """Number of each place of the grid, −1 outside the table, (19, 33)."""
    inside: np.ndarray
    """(19, 33) bool."""
    made: np.ndarray
    """Share of each move that is made from each place, (places, 8)."""


def _ahead(values: np.ndarray, following: np.ndarray) -> np.ndarray:
    """Cost from where each move leads: nothing at a goal, infinite outside the table."""
    found = np.where(following >= 0, values[following], 0.0)
    return np.where(following == -1, np.inf, found)


class Planner:
    """Chooses the first move of the shortest path to what is wanted."""

    def __init__(self, eye: Eye, model: dict[bool, nn.Sequential], task: Task) -> None:
        self.eye, self.model = eye, model
        self.kinds = slots_of(eye.encoder)
        self.afraid = task == "avoidance"

    def __call__(self, images: np.ndarray) -> np.ndarray:
        """Action probabilities (B, 9): all on the plan's first move."""
        chosen = [self.plan(scene) for scene in self.eye.look(torch.from_numpy(images))]
        return np.eye(9)[chosen]

    def plan(self, scene: Scene) -> int:
        """The first move."""
        goals = self.where(scene.maps, "yellow")
        if not len(goals):  # hidden: look for it
            return int(np.abs(scene.agent * 1000).sum()) % 8 + 1
        places = scene.agent + np.stack(np.meshgrid(np.arange(-9, 10), np.arange(-16, 17), indexing="ij"), axis=-1)
        inside: np.ndarray = np.all(np.abs(places) <= self.eye.reach + 0.3, axis=2)
        inside[9, 16] = True  # where the agent is
        number = np.full(inside.shape, -1)
        number[inside] = np.arange(inside.sum())
        graph = Graph(places[inside], number, inside, self.outcomes(scene.maps, places[inside]))
        danger = self.where(scene.maps, "patch") if self.afraid else np.zeros((0, 2))
        cost, following = self.edges(graph, goals, danger)
        values = np.full(len(graph.nodes), np.inf)
        for _ in range(SWEEPS):
            values = (cost + _ahead(values, following)).min(axis=1)
        return int((cost + _ahead(values, following))[number[9, 16]].argmin()) + 1

    def outcomes(self, maps: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Share of each move that is made from each place, (places, 8)."""
        around = np.stack([self.eye.around(maps, node) for node in nodes])
        made = np.empty((len(nodes), 8))
        with torch.no_grad():
            for move in range(1, 9):
                seen = torch.from_numpy(around[:, CANON[move]]).float()
                made[:, move - 1] = self.model[move in _STRAIGHT](seen).flatten().sigmoid().numpy()
        return made

    def edges(self, graph: Graph, goals: np.ndarray, danger: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost of each move from each place, and where it leads: a place, −1 for nowhere, −2 for a goal."""
        nodes = graph.nodes
        following = np.full((len(nodes), 8), -1)
        cost = 1 / graph.made.clip(0.03, 1)
        start = np.linalg.norm(nodes[:, None] - goals, axis=2)
        for move, way in enumerate(np.array(MOVES[1:])):
            to = np.argwhere(graph.inside) + way
            fits = (to >= 0).all(axis=1) & (to < graph.inside.shape).all(axis=1)
            following[fits, move] = graph.number[tuple(to[fits].T)]
            cost[:, move] += 0.02 * (np.abs(way).sum() - 1)
            passed = nodes[:, None] + way * np.linspace(0.3, 1, 4)[:, None]
            if len(danger):
                near = np.abs(passed[:, :, None] - danger).max(axis=3).min(axis=(1, 2))
                cost[near < AFRAID, move] += 100
            apart = np.linalg.norm(passed[:, :, None] - goals, axis=3).min(axis=1)
            hits = (apart < np.minimum(TOUCH, start - CLOSER)).any(axis=1)
            following[hits, move] = -2
            cost[hits, move] = np.where(cost[hits, move] > 90, cost[hits, move], 1.0)
        return cost, following

    def where(self, maps: np.ndarray, kind: str) -> np.ndarray:
        """Middles of the connected areas of this kind, (n, 2); for a patch, the middle of all of it."""
        from scipy.ndimage import label

        mass = maps[..., self.kinds[kind]].sum(axis=2) * self.eye.plane.weights
        labelled: tuple[np.ndarray, int] = label(mass > 0.05, structure=np.ones((3, 3)))  # pyright: ignore
        parts, count = labelled
        groups = [parts > 0] if kind == "patch" and count else [parts == i for i in range(1, count + 1)]
        found = [((mass * group)[..., None] * self.eye.plane.places).sum(axis=(0, 1)) / (mass * group).sum()
                 for group in groups if (mass * group).sum() > 0.6]  # fmt: skip
        return np.array(found).reshape(-1, 2)


def main() -> None:
    """Print the score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--release", type=Path, required=True)
    parser.add_argument("--encoder", type=Path, required=True)
    parser.add_argument("--task", choices=TASKS, default="goal-seeking")
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file for the score and every action, as JSON")
    given = parser.parse_args()
    torch.set_num_threads(1)
    encoder = load_encoder(given.encoder)
    if not isinstance(encoder, SlotEncoder):
        raise SystemExit(f"{given.encoder}: an encoder of colour slots is needed")
    eye = Eye(encoder)
    model = forward_model(eye, Windows(Pictures(open_release(given.release)), "train", length=2), given.seed)
    config = EvaluateConfig(task=given.task, split=given.split, threads=1)
    played = play(Planner(eye, model, given.task), given.task, puzzles_of(given.task, given.split), config)
    found = summarise(played)
    if given.out:
        record = {
            "agent": "zero-shot", "task": given.task, "split": given.split, "seed": given.seed,
            "encoder": artefacts.digest(given.encoder), "release": artefacts.digest(given.release),
            "code": __version__, "hardware": hardware(1, "cpu"), **found,
            "actions": [row[:n].tolist() for row, n in zip(played.actions, played.steps, strict=True)],
        }  # fmt: skip
        given.out.write_bytes(artefacts.canonical_json(record))
    print(f"{given.task}, {given.split}: A-Success {found['a_success']:.3f}, return {found['mean_return']:.2f}")


if __name__ == "__main__":
    main()
