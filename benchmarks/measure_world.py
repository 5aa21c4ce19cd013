"""What the physics comes out as: the table of docs/environment.md.

.venv/bin/python benchmarks/measure_world.py
"""

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from gym_open.envs import constants as c
from gym_open.envs import model as m
from gym_open.envs.generators import sample_puzzle
from gym_open.envs.puzzles import TASKS, Placement, Puzzle, Task, arranged
from gym_open.envs.world import World

NORTH = 3
PHASES = np.linspace(0, 1, 24, endpoint=False)
"""Fractions of a substep's way by which a body starts further on: a contact begins between two substeps."""


def laid(*objects: tuple) -> World:
    world = World()
    world.load(Puzzle("sandbox", arranged([Placement(*item) for item in objects])))
    return world


def state(world: World, name: str) -> np.ndarray:
    return world.object_state()[m.INVENTORY.index(name)]


def launch(world: World, name: str, speed: float, phase: float) -> None:
    index = m.INVENTORY.index(name)
    world.data.qvel[6 * index] = speed
    world.data.qpos[7 * index] += phase * speed * c.TIMESTEP_S


def moves() -> str:
    lengths = []
    for action in range(1, 9):
        world = laid(("agent", 8, 4))
        before = state(world, "agent")[:2].copy()
        world.step(action)
        way = np.linalg.norm(state(world, "agent")[:2] - before) / c.PITCH
        lengths.append(way / np.linalg.norm(c.MOVES[action]))
    return f"{min(lengths):.3f}–{max(lengths):.3f} cells (diagonals ÷ √2)"


def push(kind: str) -> str:
    gone = []
    for phase in PHASES:
        world = laid(("agent", 14, 4), (kind, 12, 4))
        world.data.qpos[1] += phase * c.MOVE_SPEED * c.TIMESTEP_S
        start = state(world, f"{kind}_0")[:2].copy()
        for _ in range(2):
            world.step(NORTH)
        for _ in range(1500):
            mujoco.mj_step(world.model, world.data)
        gone.append(np.linalg.norm(state(world, f"{kind}_0")[:2] - start) * 100)
    return f"{np.mean(gone):.1f} cm ({min(gone):.1f}–{max(gone):.1f})"


def restitution(world: World, moving: str, speed: float, phase: float, other: str | None) -> tuple[float, float]:
    """Speed apart over speed together in x of one collision, and its greatest depth in metres."""
    launch(world, moving, speed, phase)
    ground = world.model.geom("ground").id
    mover, target = m.INVENTORY.index(moving), None if other is None else m.INVENTORY.index(other)
    before, depth, touched = speed, 0.0, False

    def closing() -> float:
        return float(world.data.qvel[6 * mover] - (0 if target is None else world.data.qvel[6 * target]))

    for _ in range(500):
        now = closing()
        mujoco.mj_step(world.model, world.data)
        contact = world.data.contact
        aside = ~(contact.geom == ground).any(axis=1)
        if aside.any():
            before, touched = (before, True) if touched else (now, True)
            depth = max(depth, -float(contact.dist[aside].min()))
        elif touched:
            return -closing() / before, depth
    raise AssertionError("no collision")


def bounce(moving: str, other: str | None) -> str:
    results = []
    for phase in PHASES:
        if other is None:
            kind = m.kind_of(moving)
            world = laid(("agent", 8, 6)) if kind == "agent" else laid(("agent", 1, 1), (kind, 8, 7))
        else:
            world = laid(("agent", 8, 3), (m.kind_of(other), 8, 5))
        results.append(restitution(world, moving, c.MOVE_SPEED if moving == "agent" else 2.5, phase, other))
    ratios, depths = zip(*results, strict=True)
    return f"{np.mean(ratios):.2f} ({min(ratios):.2f}–{max(ratios):.2f}), {max(depths) * 100:.1f} cm deep"


def random_play(layouts: int, steps: int) -> str:
    rng, world = np.random.default_rng(0), World()
    tasks: tuple[Task, ...] = ("sandbox", *TASKS)
    deepest, highest, fastest, outside = 0.0, 0.0, 0.0, 0
    for number in range(layouts):
        world.load(sample_puzzle(tasks[number % len(tasks)], rng))
        for action in rng.integers(1, c.N_ACTIONS, steps).tolist():
            world.step(action)
            states = world.object_state()[world.present]
            assert np.isfinite(states).all()
            outside += int((np.abs(states[:, :2]) > (c.WALL_X, c.WALL_Y)).any())
            deepest = max(deepest, -float(world.data.contact.dist.min(initial=0)))
            highest = max(highest, float(states[:, 2].max()))
            fastest = max(fastest, float(np.linalg.norm(states[:, 7:10], axis=1).max()))
    return (
        f"{outside} outside, {deepest * 100:.1f} cm deepest, centres up to {highest * 100:.1f} cm high, "
        f"{fastest:.1f} m/s fastest"
    )


def sparse_against_dense(layouts: int, steps: int) -> str:
    """Furthest that any object is apart after the same play with MuJoCo's other Jacobian format."""
    sparse = mujoco.MjModel.from_xml_string(m.model_xml().replace('jacobian="dense"', 'jacobian="sparse"'))
    rng, apart = np.random.default_rng(1), 0.0
    for number in range(layouts):
        puzzle = sample_puzzle(TASKS[number % len(TASKS)], rng)
        worlds = World(), World()
        worlds[1].model = sparse
        for world in worlds:
            world.load(puzzle)
        for action in rng.integers(1, c.N_ACTIONS, steps).tolist():
            states = []
            for world in worlds:
                world.step(action)
                states.append(world.object_state()[world.present, :3])
            apart = max(apart, float(np.abs(states[0] - states[1]).max()))
    return f"{apart * 1000:.2g} mm"


def main() -> None:
    table = Table("what", "measured")
    table.add_row("one move", moves())
    for kind in ("light", "heavy", "yellow"):
        table.add_row(f"agent's push of one {kind}, way until rest", push(kind))
    for kind in ("light_0", "heavy_0", "yellow_0"):
        table.add_row(f"restitution agent – {kind}", bounce("agent", kind))
    for moving in ("agent", "light_0", "yellow_0"):
        table.add_row(f"restitution {moving} – wall", bounce(moving, None))
    table.add_row("random play, 100 layouts × 100 steps", random_play(100, 100))
    table.add_row("sparse against dense Jacobian, 20 layouts × 20 steps", sparse_against_dense(20, 20))
    Console().print(table)


if __name__ == "__main__":
    main()
