"""How fast the world is, as ratios to a bare loop of `mj_step` measured in the same run.

    .venv/bin/python benchmarks/bench_env.py

Every row plays the same 200 actions on the same puzzle of each task; rounds take turns, so that a busy machine slows
all rows alike, and the median round counts. `mujoco.Renderer` is measured where OpenGL is found.
"""

import argparse
import ctypes
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def find_gl() -> bool:
    """Choose an OpenGL backend before MuJoCo is imported; a backend that is missing would make the import die."""
    for backend, libraries in (("egl", ("libEGL.so.1", "libOpenGL.so.0")), ("osmesa", ("libOSMesa.so.8",))):
        try:
            for library in libraries:
                ctypes.CDLL(library)
        except OSError:
            continue
        os.environ["MUJOCO_GL"] = backend
        return True
    return False


GL = find_gl()

import mujoco  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from gym_open.envs import constants as c  # noqa: E402
from gym_open.envs.env import OpenEnv  # noqa: E402
from gym_open.envs.generators import sample_puzzle  # noqa: E402
from gym_open.envs.puzzle_sets import test_puzzles  # noqa: E402
from gym_open.envs.puzzles import TASKS, Puzzle  # noqa: E402
from gym_open.envs.world import World  # noqa: E402

Play = Callable[[Puzzle, list[int]], float]


def timed(begin: Callable[[Puzzle], Any], step: Callable[[int], Any]) -> Play:
    """Seconds that all the actions take, loading the puzzle not counted."""

    def play(puzzle: Puzzle, actions: list[int]) -> float:
        begin(puzzle)
        start = time.perf_counter()
        for action in actions:
            step(action)
        return time.perf_counter() - start

    return play


def bare_loop(world: World) -> Callable[[int], None]:
    """The physics of a step and nothing else: push, substeps, stop."""
    model, data = world.model, world.data

    def step(action: int) -> None:
        speed = data.qvel
        speed[0] += c.MOVE_SPEED * c.MOVES[action][0]
        speed[1] += c.MOVE_SPEED * c.MOVES[action][1]
        for _ in range(c.SUBSTEPS):
            mujoco.mj_step(model, data)
        speed[:6] = 0, 0, min(speed[2], 0.0), 0, 0, 0

    return step


def rows() -> dict[str, Play]:
    """What is measured, by name; the first is the unit."""
    world, env = World(), OpenEnv("sandbox")
    picture = np.empty((c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    bare = bare_loop(world)

    def as_sandbox(puzzle: Puzzle) -> None:  # which never ends
        env.reset(options={"puzzle": Puzzle("sandbox", puzzle.objects, puzzle.pen, puzzle.patch)})

    def step_and_look(action: int) -> None:
        world.step(action)
        world.observe(picture)

    plays = {
        "bare mj_step loop": timed(world.load, bare),
        "World.step, no picture": timed(world.load, world.step),
        "World.step and picture": timed(world.load, step_and_look),
        "Gymnasium env.step (with picture)": timed(as_sandbox, env.step),
        "ray caster alone": timed(world.load, lambda _: world.observe(picture)),
    }
    if GL:
        renderer = mujoco.Renderer(world.model, c.IMAGE_SIZE, c.IMAGE_SIZE)
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
            renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0

        def render(_: int) -> None:
            renderer.update_scene(world.data, camera="observation")
            renderer.render(out=picture)

        plays["mujoco.Renderer alone"] = timed(world.load, render)
    return plays


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    actions = np.random.default_rng(0).integers(1, c.N_ACTIONS, 200).tolist()
    puzzles = [test_puzzles(task)[0] for task in TASKS]
    plays = rows()
    for play in plays.values():
        play(puzzles[0], actions[:5])  # compile
    seconds: dict[str, list[float]] = {name: [] for name in plays}
    for _ in range(rounds):
        for name, play in plays.items():
            seconds[name].append(sum(play(puzzle, actions) for puzzle in puzzles) / len(puzzles) / len(actions))
    world, rng = World(), np.random.default_rng(0)
    drawn = [sample_puzzle("sandbox", rng) for _ in range(50)]
    start = time.perf_counter()
    for puzzle in drawn:
        world.load(puzzle)
    reset = (time.perf_counter() - start) / len(drawn)

    unit = statistics.median(seconds["bare mj_step loop"])
    table = Table("", "time ÷ bare loop", "µs", "a second", title=f"{c.SUBSTEPS} substeps of {c.TIMESTEP_S} s a step")
    for name, times in seconds.items():
        median = statistics.median(times)
        table.add_row(name, f"{median / unit:.2f}", f"{median * 1e6:.0f}", f"{1 / median:,.0f}")
    table.add_row("World.load", f"{reset / unit:.2f}", f"{reset * 1e6:.0f}", f"{1 / reset:,.0f}")
    console = Console()
    console.print(table)
    if not GL:
        console.print(
            "mujoco.Renderer not measured: no OpenGL (Debian: apt-get install libegl1 libopengl0 libgl1-mesa-dri)"
        )


if __name__ == "__main__":
    main()
