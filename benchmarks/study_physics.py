"""Effects of other settings of the physics: the reasons in docs/environment.md.

.venv/bin/python benchmarks/study_physics.py     # about two minutes; the stiffest contacts cause the warnings
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple
from unittest import mock

import measure_world as measure
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from gym_open.envs import constants as c
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics import bounciness
from gym_open.envs.physics import model as m
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.world import World


class Setting(NamedTuple):
    """The XML text of a model with one replacement."""

    name: str
    old: str = ""
    new: str = ""
    timestep_s: float = c.TIMESTEP_S
    stiffness: float = 0.0
    """Parameters of contacts, if they differ from version 1."""


SETTINGS = (
    Setting("v1"),
    Setting("0.0025 s × 16", timestep_s=0.0025),
    Setting("0.002 s × 20", timestep_s=0.002),
    Setting("implicitfast", 'integrator="Euler"', 'integrator="implicitfast"'),
    Setting("implicit", 'integrator="Euler"', 'integrator="implicit"'),
    Setting("all awake", '<flag sleep="enable"/>', ""),
    Setting("sparse Jacobian", 'jacobian="dense"', 'jacobian="sparse"'),
    Setting("pyramidal cone", 'cone="elliptic"', 'cone="pyramidal"'),
    Setting("contacts 2¼ times as stiff", stiffness=90_000.0),
    Setting("contacts 4 times as stiff", stiffness=160_000.0),
    Setting("touching 1 cm early", '<geom condim="1" ', '<geom condim="1" margin="0.005" '),
    Setting("landing in 0.01 s", 'solref="0.02 1"', 'solref="0.01 1"'),
)


@contextmanager
def worlds_of(setting: Setting) -> Iterator[WorldOptions]:
    """Context with options: worlds with these options have this setting."""
    options = WorldOptions(timestep_s=setting.timestep_s, substeps=round(c.CONTROL_DT_S / setting.timestep_s))
    text = m.model_xml(options)
    if setting.stiffness:
        ratio = setting.stiffness / 40_000
        for value in (c.BOUNCINESS, c.BOUNCINESS / 2):
            usual = bounciness.contact_reference(value, options.timestep_s)
            brake = float(usual.split()[1]) * ratio**0.5  # the same damping ratio
            text = text.replace(usual, f"{-setting.stiffness} {brake}")
    model = mujoco.MjModel.from_xml_string(text.replace(setting.old, setting.new))
    with mock.patch.object(m, "build_model", return_value=model):
        yield options


def play(options: WorldOptions, layouts: int = 40, steps: int = 50) -> list[str]:
    """Deepest overlap, height and speed at any substep of random actions, and steps with an object outside."""
    rng, world = np.random.default_rng(0), World(options)
    deepest, highest, fastest, out = 0.0, 0.0, 0.0, 0
    for number in range(layouts):
        world.load(measure.drawn(number, rng))
        found: list[float] = [0.0]
        for action in rng.integers(1, c.N_ACTIONS, steps).tolist():
            measure.move(world, action, lambda found=found, world=world: found.extend(measure.aside(world)))
            state = world.object_state()[world.present]
            out += bool((np.abs(state[:, :2]) > (c.WALL_X, c.WALL_Y)).any())
            highest = max(highest, float(state[:, 2].max()))
            fastest = max(fastest, float(np.linalg.norm(state[:, 7:10], axis=1).max()))
        deepest = max(deepest, *found)
    return [f"{deepest * 100:.1f}", f"{highest * 100:.0f}", f"{fastest:.1f}", f"{out}"]


def slide(options: WorldOptions) -> str:
    """Distance in cm and direction of a cube that starts at 1.5 m/s, 22.5° off its row."""
    world = measure.laid(options, ("agent", 1, 1), ("light", 8, 4))
    start = measure.place(world, "light_0").copy()
    angle = np.deg2rad(22.5)
    measure.speed(world, "light_0")[:2] = 1.5 * np.cos(angle), 1.5 * np.sin(angle)
    world.advance(round(1.5 / options.timestep_s))
    x, y = measure.place(world, "light_0") - start
    return f"{np.hypot(x, y) * 100:.1f} at {np.rad2deg(np.arctan2(y, x)):.0f}°"


def cost(worlds: dict[str, World], layouts: list[Puzzle], steps: int = 60) -> dict[str, float]:
    """Microseconds of processor time per step. The worlds take turns."""
    spent = dict.fromkeys(worlds, 0.0)
    for number, puzzle in enumerate(layouts):
        actions = np.random.default_rng(number).integers(1, c.N_ACTIONS, steps).tolist()
        for name, world in worlds.items():
            world.load(puzzle)
            begun = time.process_time()
            for action in actions:
                world.step(action)
            spent[name] += time.process_time() - begun
    return {name: seconds / len(layouts) / steps * 1e6 for name, seconds in spent.items()}


def main() -> None:
    table = Table("setting", "step, of v1's", "deepest, cm", "highest, cm", "fastest, m/s", "outside")
    for heading in ("restitution agent – light", "light – wall", "energy made", "slide at 22.5°"):
        table.add_column(heading)
    rows: dict[str, list[str]] = {}
    worlds: dict[str, World] = {}
    for setting in SETTINGS:
        with worlds_of(setting) as options:
            worlds[setting.name] = World(options)
            bounces = [measure.restitution(options, *pair) for pair in (("agent", "light"), ("light", None))]
            rows[setting.name] = [*play(options), *bounces, measure.energy_made(options, 30), slide(options)]
    rng = np.random.default_rng(5)
    costs = cost(worlds, [measure.drawn(number, rng) for number in range(12)])
    for name, row in rows.items():
        table.add_row(name, f"{costs[name] / costs['v1']:.2f}", *row)
    Console(width=220).print(table)


if __name__ == "__main__":
    main()
