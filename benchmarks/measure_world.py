"""Measurements of the physics at the world's timestep and at half of it: the table of docs/environment.md.

.venv/bin/python benchmarks/measure_world.py                  # everything but the long run: some minutes
.venv/bin/python benchmarks/measure_world.py --long 10000     # 10,000 random steps in each of 100 layouts
"""

import argparse
from collections.abc import Callable

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from gym_open.envs import constants as c
from gym_open.envs.options import WorldOptions
from gym_open.envs.puzzles import SIDES, TASKS, Pen, Placement, Puzzle, Task, arranged
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.world import World
from gym_open.progress import bar

WORLDS = (WorldOptions(), WorldOptions(timestep_s=c.TIMESTEP_S / 2, substeps=2 * c.SUBSTEPS))
"""World version 1, and the same world at half the timestep."""
EAST, NORTH = 1, 3
EVERYTHING = SandboxConfig(
    heavy=(1, 3), light=(1, 3), push=(1, 2), rectangle=(1, 2), cone=(1, 2), stack=(1, 1), pen_probability=0.2
)
KINDS = tuple(kind for kind in c.CAPACITY if kind != "agent")
_PHASES = np.linspace(0, 1, 24, endpoint=False)
"""Start offsets of a body, as fractions of its way per substep: a contact can begin between two substeps."""


def laid(options: WorldOptions, *objects: tuple, pen: Pen | None = None) -> World:
    """A world with these objects (kind, row, column) on its table."""
    world = World(options)
    world.load(Puzzle("sandbox", arranged([Placement(*item) for item in objects]), pen=pen))
    return world


def place(world: World, name: str) -> np.ndarray:
    """Position of an object, (2,), as a view."""
    return world.data.qpos.reshape(-1, 7)[world.inventory.index(name), :2]


def speed(world: World, name: str) -> np.ndarray:
    """Velocity of an object, (3,), as a view."""
    return world.data.qvel.reshape(-1, 6)[world.inventory.index(name), :3]


def aside(world: World) -> np.ndarray:
    """Depths of the last substep's contacts, without those with the ground."""
    contact = world.data.contact
    return -contact.dist[~(contact.geom == world.model.geom("ground").id).any(axis=1)]


def move(world: World, action: int, each: Callable[[], None]) -> None:
    """Take an action as `World.step` does, and call a function after every substep."""
    velocity = world.data.qvel
    velocity[:2] += c.MOVE_SPEED * np.array(c.MOVES[action])
    for _ in range(world.options.substeps):
        mujoco.mj_step(world.model, world.data)
        each()
    velocity[:6] = 0, 0, min(velocity[2], 0), 0, 0, 0


def spread(values: list[float], unit: str = "", digits: int = 2) -> str:
    """Mean and range."""
    return f"{np.mean(values):.{digits}f}{unit} ({min(values):.{digits}f}–{max(values):.{digits}f})"


def moves(options: WorldOptions) -> str:
    """Lengths of the eight moves on a free table."""
    lengths = []
    for action in range(1, c.N_ACTIONS):
        world = laid(options, ("agent", 8, 4))
        before = place(world, "agent").copy()
        world.step(action)
        gone = np.linalg.norm(place(world, "agent") - before) / c.PITCH
        lengths.append(float(gone / np.linalg.norm(c.MOVES[action])))
    return spread(lengths, " cells", 3)


def push(options: WorldOptions, kind: str) -> str:
    """Distance that an object moves until it rests, after two moves of the agent towards it."""
    gone = []
    for phase in _PHASES:
        world = laid(options, ("agent", 14, 4), (kind, 12, 4))
        place(world, "agent")[1] += phase * c.MOVE_SPEED * options.timestep_s
        start = place(world, f"{kind}_0").copy()
        for _ in range(2):
            world.step(NORTH)
        world.advance(round(8 / options.timestep_s))
        gone.append(float(np.linalg.norm(place(world, f"{kind}_0") - start)) * 100)
    return spread(gone, " cm", 1)


def restitution(options: WorldOptions, kind: str, other: str | None) -> str:
    """Separation speed over approach speed of a collision along x, and its greatest depth."""
    ratios, deepest = [], 0.0
    start = c.MOVE_SPEED if kind == "agent" else 2.5
    for phase in _PHASES:
        if other is not None:
            world = laid(options, (kind, 8, 3), (other, 8, 5))
        elif kind == "agent":
            world = laid(options, (kind, 8, 6))
        else:
            world = laid(options, ("agent", 1, 1), (kind, 8, 7))
        name = kind if kind == "agent" else f"{kind}_0"
        speed(world, name)[0] = start
        place(world, name)[0] += phase * start * options.timestep_s
        closing, touched = start, False
        while True:
            now = speed(world, name)[0] - (0 if other is None else speed(world, f"{other}_0")[0])
            mujoco.mj_step(world.model, world.data)
            depths = aside(world)
            if depths.size:
                closing, touched = (closing if touched else now), True
                deepest = max(deepest, float(depths.max()))
            elif touched:
                break
        ratios.append(-(speed(world, name)[0] - (0 if other is None else speed(world, f"{other}_0")[0])) / closing)
    return f"{spread(ratios)}, {deepest * 100:.1f} cm deep"


def energy(world: World) -> float:
    """Energy of all objects on the table in joules: potential and kinetic."""
    model, data, total = world.model, world.data, 0.0
    turn = np.zeros(9)
    for i in world.present.nonzero()[0]:
        body = model.body(world.inventory[i])
        pose, velocity = data.qpos[7 * i : 7 * i + 7], data.qvel[6 * i : 6 * i + 6]
        mujoco.mju_quat2Mat(turn, pose[3:])
        frame = turn.reshape(3, 3)
        middle = velocity[:3] + frame @ np.cross(velocity[3:], body.ipos)
        height = pose[2] + (frame @ body.ipos)[2]
        total += body.mass[0] * (9.81 * height + middle @ middle / 2) + velocity[3:] @ (body.inertia * velocity[3:]) / 2
    return float(total)


def energy_made(options: WorldOptions, layouts: int = 300, steps: int = 40) -> str:
    """Increase of energy after the push, in random actions that begin with contacts to the ground alone.

    A contact is a spring: what it holds when an action begins comes out later, so such actions are left out.
    """
    rng, world = np.random.default_rng(0), World(options)
    rises = []
    for number in range(layouts):
        world.load(drawn(number, rng))
        for action in rng.integers(1, c.N_ACTIONS, steps).tolist():
            mujoco.mj_fwdPosition(world.model, world.data)
            free = not aside(world).size
            found: list[float] = []
            velocity = world.data.qvel
            velocity[:2] += c.MOVE_SPEED * np.array(c.MOVES[action])
            before = energy(world)
            velocity[:2] -= c.MOVE_SPEED * np.array(c.MOVES[action])
            move(world, action, lambda found=found: found.append(energy(world)))
            if free:
                rises.append(max(found) / before - 1)
    risen = sum(rise > 1e-3 for rise in rises)
    return f"{max(rises) * 100:.1f}% at most, over 0.1% in {risen} of {len(rises)} actions"


def drawn(number: int, rng: np.random.Generator) -> Puzzle:
    """A layout: of each task in turn, of the sandbox, and of the sandbox with objects of every kind."""
    tasks: tuple[Task, ...] = (*TASKS, "sandbox", "sandbox")
    turn = number % len(tasks)
    return sample_puzzle(tasks[turn], rng, EVERYTHING if turn == len(tasks) - 1 else SandboxConfig())


def tunnelling(options: WorldOptions) -> str:
    """Deepest overlap when the agent runs into each kind from eight directions. Half its size would be a passage."""
    deepest = dict.fromkeys((*KINDS, "stack"), 0.0)
    for kind in deepest:
        for action in range(1, c.N_ACTIONS):
            x, y = c.MOVES[action]
            for phase in _PHASES[::2]:
                world = laid(options, ("agent", 8, 4), (kind, 8 - 2 * y, 4 + 2 * x))
                place(world, "agent")[:] += phase * c.MOVE_SPEED * options.timestep_s * np.array([x, y])
                for _ in range(4):
                    depths = [0.0]
                    move(world, action, lambda world=world, depths=depths: depths.extend(aside(world)))
                    deepest[kind] = max(deepest[kind], *depths)
    return ", ".join(f"{kind} {depth * 100:.1f}" for kind, depth in deepest.items()) + " cm"


def flung(options: WorldOptions, kind: str, shots: int = 200) -> str:
    """Objects thrown at 6 m/s at walls, corners and a pen's walls: how many pass through, and their depth."""
    rng, through, deepest = np.random.default_rng(0), 0, 0.0
    agent = kind == "agent"
    centre = np.array(c.cell_centre(8, 4))
    for shot in range(shots):
        direction = np.array([np.cos(angle := rng.uniform(0, 2 * np.pi)), np.sin(angle)])
        penned = shot % 2 == 0
        if agent:
            world = laid(options, ("agent", 9, 4), pen=Pen(8, 4, "north") if penned else None)
        else:
            world = laid(options, ("agent", 1, 1), (kind, 13, 4), pen=Pen(8, 4, "north") if penned else None)
        world.data.mocap_pos[world.model.body("ramp").mocapid[0]] = 0, -60, 0
        start = centre
        if penned and not agent:  # from outside, towards the pen
            start = centre + (0.46, 0.5) * direction / np.abs(direction).max()
            direction = -direction
        name = kind if agent else f"{kind}_0"
        place(world, name)[:] = start
        mujoco.mj_forward(world.model, world.data)
        speed(world, name)[:2] = 6 * direction
        for _ in range(round((0.1 if penned else 0.25) / options.timestep_s)):
            mujoco.mj_step(world.model, world.data)
            deepest = max(deepest, float(aside(world).max(initial=0)))
        inside = bool((np.abs(place(world, name) - centre) < c.PEN_HALF).all())
        out = bool((np.abs(place(world, name)) > (c.WALL_X, c.WALL_Y)).any())
        through += inside != agent if penned else out
    return f"{through} of {shots} through, {deepest * 100:.1f} cm deep"


def outside(world: World) -> bool:
    """Whether the agent is out of the pen."""
    assert world.puzzle.pen is not None
    centre = c.cell_centre(world.puzzle.pen.row, world.puzzle.pen.column)
    return bool((np.abs(place(world, "agent") - centre) > c.PEN_HALF).any())


def walk_up(world: World) -> bool:
    """Go to the foot of the ramp and up. Return whether the agent leaves the pen."""
    assert world.puzzle.pen is not None
    row, column = SIDES[world.puzzle.pen.ramp_side]
    up = np.array([column, -row])
    foot = np.array(c.cell_centre(world.puzzle.pen.row, world.puzzle.pen.column)) - up * c.PITCH
    for _ in range(4):  # back to the row of the foot, then along it
        away = np.rint((foot - place(world, "agent")) / c.PITCH).astype(int)
        along = int(away @ up)
        direction = np.sign(along) * up if along else np.sign(away)
        world.step(c.MOVES.index((int(direction[0]), int(direction[1]))))
    for _ in range(6):
        world.step(c.MOVES.index((column, -row)))
        if outside(world):
            return True
    return False


def pen(options: WorldOptions, pens: int = 200) -> list[str]:
    """How often the agent leaves the pen: without a ramp, by random actions with it, and by walking up it."""
    rng, world = np.random.default_rng(0), World(options)
    runs = [action for action in (1, 2, 3, 4, 5, 6, 7, 8, 2, 6, 4, 8) for _ in range(6)]
    left = [0, 0, 0]
    for _ in range(pens):
        puzzle = sample_puzzle("tool-use", rng)
        for which in range(2):
            world.load(puzzle)
            actions = rng.integers(1, c.N_ACTIONS, 200).tolist()
            if which == 0:
                world.data.mocap_pos[world.model.body("ramp").mocapid[0]] = 0, -60, 0
                actions += runs
            for action in actions:
                world.step(action)
                if outside(world):
                    left[which] += 1
                    break
        world.load(puzzle)
        left[2] += walk_up(world)
    return [f"{count} of {pens}" for count in left]


def apart(layouts: int = 200, steps: int = 5) -> str:
    """Distances between objects at the timestep and at half of it, after some random actions."""
    rng, worlds = np.random.default_rng(1), [World(options) for options in WORLDS]
    found: list[float] = []
    for number in range(layouts):
        puzzle, actions = drawn(number, rng), rng.integers(1, c.N_ACTIONS, steps).tolist()
        for world in worlds:
            world.load(puzzle)
        start = worlds[0].object_state()[:, :2]
        for action in actions:
            for world in worlds:
                world.step(action)
        one, other = (world.object_state()[:, :2] for world in worlds)
        moved = np.linalg.norm(one - start, axis=1) > 0.01
        found += np.linalg.norm(one - other, axis=1)[moved].tolist()
    median, most = np.quantile(found, (0.5, 0.9)) * 100
    return f"median {median:.1f} cm, 90% within {most:.1f} cm"


def long_play(options: WorldOptions, layouts: int, steps: int) -> dict[str, float]:
    """Extremes under random actions. It raises if anything leaves the table or is not finite."""
    rng, world = np.random.default_rng(0), World(options)
    worst = dict.fromkeys(("deepest, cm", "highest agent, cm", "fastest, m/s"), 0.0)
    highest = {"highest other, cm": 0.0, "highest other where there is a stack, cm": 0.0}
    outside = 0
    with bar(f"{options.timestep_s} s", layouts * steps) as progress:
        for number in range(layouts):
            world.load(drawn(number, rng))
            objects = world.present.nonzero()[0]
            under = list(highest)[any(item.kind == "stack" for item in world.puzzle.objects)]
            for action in rng.integers(1, c.N_ACTIONS, steps).tolist():
                world.step(action)
                places = world.data.qpos.reshape(-1, 7)[objects, :3]
                speeds = world.data.qvel.reshape(-1, 6)[objects, :3]
                assert np.isfinite(places).all()
                assert np.isfinite(speeds).all()
                outside += bool((np.abs(places[:, :2]) > (c.WALL_X, c.WALL_Y)).any())
                now = (
                    -100 * world.data.contact.dist.min(initial=0),
                    100 * places[0, 2],
                    np.sqrt((speeds**2).sum(axis=1).max()),
                )
                for key, value in zip(worst, now, strict=True):
                    worst[key] = max(worst[key], float(value))
                highest[under] = max(highest[under], 100 * float(places[1:, 2].max(initial=0)))
            progress.advance(steps)
    return {"outside": outside, **worst, **highest}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--long", type=int, metavar="STEPS")
    arguments = parser.parse_args()
    table = Table("what", *(f"{options.timestep_s} s × {options.substeps}" for options in WORLDS))
    if arguments.long:
        results = [long_play(options, 100, arguments.long) for options in WORLDS]
        for key in results[0]:
            table.add_row(key, *(f"{result[key]:.1f}" for result in results))
        Console().print(table)
        return
    table.add_row("one move", *map(moves, WORLDS))
    for kind in KINDS:
        table.add_row(f"way of a {kind} after two moves at it", *(push(options, kind) for options in WORLDS))
    for kind in KINDS:
        table.add_row(f"restitution, agent – {kind}", *(restitution(options, "agent", kind) for options in WORLDS))
    for kind in ("agent", *KINDS):
        table.add_row(f"restitution, {kind} – wall", *(restitution(options, kind, None) for options in WORLDS))
    table.add_row("energy made", *map(energy_made, WORLDS))
    table.add_row("deepest overlap with the agent", *map(tunnelling, WORLDS))
    for kind in ("agent", *KINDS):
        table.add_row(f"{kind} thrown at walls at 6 m/s", *(flung(options, kind) for options in WORLDS))
    names = "pen left without ramp", "in 200 random steps with it", "by walking up it"
    for name, *values in zip(names, *map(pen, WORLDS), strict=True):
        table.add_row(name, *values)
    table.add_row("apart after 5 actions", "", apart())
    Console(width=200).print(table)


if __name__ == "__main__":
    main()
