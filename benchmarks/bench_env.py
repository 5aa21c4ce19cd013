"""How fast the world is, as ratios to a bare loop of `mj_step` measured in the same run.

    .venv/bin/python benchmarks/bench_env.py

Every row takes the same actions on the same puzzles: fixed puzzles of all four tasks, as sandboxes, which never end.
Rows take turns, so that a busy machine slows all of them equally. A ratio is the median over rounds of the ratio within
a round. `mujoco.Renderer` is measured if OpenGL is available.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from rich.console import Console
from rich.table import Table

from gym_open.envs import constants as c
from gym_open.envs.env import OpenEnv
from gym_open.envs.look.backend import OpenGLError
from gym_open.envs.look.gl import open_renderer
from gym_open.envs.puzzles import TASKS, Puzzle
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.puzzles.sets import test_puzzles
from gym_open.envs.vector import OpenVectorEnv
from gym_open.envs.world import World

UNIT = "bare mj_step loop"
_MOST_PROCESSES = 16
Row = Callable[[list[Puzzle], np.ndarray], float]
"""Function that returns the seconds that actions (T, N) in N puzzles take, without laying out the puzzles."""


class Fixed(gymnasium.Wrapper[Any, np.int64, Any, np.int64]):
    """Always the same puzzle: gymnasium's vector environments give the same options to all their environments."""

    def __init__(self, puzzle: Puzzle) -> None:
        super().__init__(OpenEnv("sandbox"))
        self._puzzle = puzzle

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return self.env.reset(seed=seed, options={**(options or {}), "puzzle": self._puzzle})


def one_by_one(begin: Callable[[Puzzle], Any], step: Callable[[int], Any]) -> Row:
    def play(puzzles: list[Puzzle], actions: np.ndarray) -> float:
        seconds = 0.0
        for puzzle, column in zip(puzzles, actions.T.tolist(), strict=True):
            begin(puzzle)
            start = time.perf_counter()
            for action in column:
                step(action)
            seconds += time.perf_counter() - start
        return seconds

    return play


def in_turn(n: int) -> Row:
    """The bare loop over as many worlds as a vector environment has: together they do not fit in the cache."""
    worlds = [World() for _ in range(n)]
    steps = [bare_step(world) for world in worlds]

    def play(puzzles: list[Puzzle], actions: np.ndarray) -> float:
        for world, puzzle in zip(worlds, puzzles, strict=True):
            world.load(puzzle)
        start = time.perf_counter()
        for row in actions.tolist():
            for step, action in zip(steps, row, strict=True):
                step(action)
        return time.perf_counter() - start

    return play


def together(vector: VectorEnv[Any, Any, Any], options: Callable[[list[Puzzle]], dict[str, Any]]) -> Row:
    def play(puzzles: list[Puzzle], actions: np.ndarray) -> float:
        vector.reset(options=options(puzzles))
        start = time.perf_counter()
        for row in actions:
            vector.step(row)
        return time.perf_counter() - start

    return play


def bare_step(world: World) -> Callable[[int], None]:
    """Only the physics of a step: push, substeps, stop."""
    model, data = world.model, world.data

    def step(action: int) -> None:
        speed = data.qvel
        speed[0] += c.MOVE_SPEED * c.MOVES[action][0]
        speed[1] += c.MOVE_SPEED * c.MOVES[action][1]
        for _ in range(c.SUBSTEPS):
            mujoco.mj_step(model, data)
        speed[:6] = 0, 0, min(speed[2], 0.0), 0, 0, 0

    return step


def single_rows() -> dict[str, Row]:
    world, image = World(), np.empty((c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    env, as_dict = OpenEnv("sandbox"), OpenEnv("sandbox", observation="dict")

    def look(_: int) -> None:
        world.observe(image)

    def step_and_look(action: int) -> None:
        world.step(action)
        world.observe(image)

    rows = {
        UNIT: one_by_one(world.load, bare_step(world)),
        "World.step, no image": one_by_one(world.load, world.step),
        "World.step and image": one_by_one(world.load, step_and_look),
        "image alone": one_by_one(world.load, look),
        "env.step": one_by_one(lambda puzzle: env.reset(options={"puzzle": puzzle}), env.step),
        "env.step, dictionary": one_by_one(lambda puzzle: as_dict.reset(options={"puzzle": puzzle}), as_dict.step),
    }
    try:
        renderer = open_renderer(world.model, c.IMAGE_SIZE, c.IMAGE_SIZE)
    except OpenGLError as error:
        Console(stderr=True).print(f"mujoco.Renderer is not measured: {error}")
        return rows
    for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
        renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0

    def step_and_render(action: int) -> None:
        world.step(action)
        renderer.update_scene(world.data, camera="observation")
        renderer.render(out=image)

    rows["World.step and mujoco.Renderer"] = one_by_one(world.load, step_and_render)
    return rows


def vector_rows(puzzles: list[Puzzle]) -> dict[str, Row]:
    n = len(puzzles)
    each = [(lambda puzzle=puzzle: Fixed(puzzle)) for puzzle in puzzles]
    rows: dict[str, Row] = {f"{UNIT}, {n} worlds in turn": in_turn(n)}
    for threads in (1, 2):
        vector = OpenVectorEnv(n, threads=threads, copy=False)
        rows[f"OpenVectorEnv, {n} worlds, threads: {threads}"] = together(vector, lambda given: {"puzzles": given})
    rows[f"gymnasium SyncVectorEnv, {n} worlds"] = together(SyncVectorEnv(each), lambda _: {})
    if n <= _MOST_PROCESSES:
        rows[f"gymnasium AsyncVectorEnv, {n} processes"] = together(AsyncVectorEnv(each), lambda _: {})
    return rows


def reset_seconds(puzzles: list[Puzzle]) -> dict[str, float]:
    """Seconds for laying out a puzzle, and for a whole reset, which also draws the puzzle at random."""
    world, env, rng = World(), OpenEnv("goal-seeking"), np.random.default_rng(0)
    env.reset(seed=0)
    calls: dict[str, Callable[[int], Any]] = {
        "World.load": lambda i: world.load(puzzles[i % len(puzzles)]),
        "drawing a puzzle": lambda _: sample_puzzle("goal-seeking", rng),
        "env.reset": lambda _: env.reset(),
    }
    found = {}
    for name, call in calls.items():
        times = []
        for i in range(50):
            start = time.perf_counter()
            call(i)
            times.append(time.perf_counter() - start)
        found[name] = statistics.median(times)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--worlds", type=int, nargs="+", default=[16])
    given = parser.parse_args()
    puzzles = [test_puzzles(TASKS[i % len(TASKS)])[i // len(TASKS)] for i in range(max(given.worlds))]
    puzzles = [Puzzle("sandbox", puzzle.objects, puzzle.pen, puzzle.patch) for puzzle in puzzles]
    rows = {name: (row, min(given.worlds)) for name, row in single_rows().items()}
    for n in given.worlds:
        rows |= {name: (row, n) for name, row in vector_rows(puzzles[:n]).items()}
    actions = np.random.default_rng(0).integers(1, c.N_ACTIONS, (given.steps, len(puzzles)))
    for row, n in rows.values():
        row(puzzles[:n], actions[:2, :n])  # compile
    seconds: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(given.rounds):
        for name, (row, n) in rows.items():
            seconds[name].append(row(puzzles[:n], actions[:, :n]) / (n * given.steps))

    table = Table("per step of one world", "÷ bare loop", "µs", "per second")
    for name, times in seconds.items():
        ratio = statistics.median(one / unit for one, unit in zip(times, seconds[UNIT], strict=True))
        median = statistics.median(times)
        table.add_row(name, f"{ratio:.2f}", f"{median * 1e6:.0f}", f"{1 / median:,.0f}")
    table.add_section()
    for name, median in reset_seconds(puzzles).items():
        ratio = median / statistics.median(seconds[UNIT])
        table.add_row(name, f"{ratio:.2f}", f"{median * 1e6:.0f}", f"{1 / median:,.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
