"""Compare the compiled step with a plain loop of `mujoco.mj_step` over MuJoCo's own Python views."""

import math
import threading
import time
from typing import Any

import mujoco
import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.envs.physics import native
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.stepper import StepOutcome
from gym_open.envs.puzzles import TASKS, Task
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.world import World

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)


class PlainWorld:
    """A copy of a world that steps only in Python, one substep at a time."""

    def __init__(self, world: World) -> None:
        self.model = world.model
        self.data = mujoco.MjData(self.model)
        mujoco.mj_copyData(self.data, self.model, world.data)
        patch = world.puzzle.patch
        self.patch = c.cell_centre(patch.row, patch.column) if patch else None
        self.hit: set[str] = set()

    def step(self, action: int) -> StepOutcome:
        if action == 0:
            return StepOutcome((), self.in_danger(), ())
        for axis in (0, 1):
            self.data.qvel[axis] += c.MOVE_SPEED * c.MOVES[action][axis]
        outcome = self.advance(c.SUBSTEPS)
        self.data.qvel[[0, 1, 3, 4, 5]] = 0
        self.data.qvel[2] = min(self.data.qvel[2], 0)
        return outcome

    def advance(self, substeps: int) -> StepOutcome:
        sums: dict[tuple[str, str], list[float]] = {}
        danger = substeps == 0 and self.in_danger()
        for _ in range(substeps):
            mujoco.mj_step(self.model, self.data)
            for contact in self.data.contact:
                self.add(contact, sums)
            danger = danger or self.in_danger()
        hits = [a if b == "agent" else b for a, b in sums if "agent" in (a, b)]
        hits = [name for name in hits if name.startswith(("yellow", "green")) and name not in self.hit]
        self.hit.update(hits)
        return StepOutcome(tuple(hits), danger, tuple(contact_of(*pair, *sums[pair]) for pair in sums))

    def add(self, contact: Any, sums: dict[tuple[str, str], list[float]]) -> None:
        pair = self.model.geom(contact.geom1).name, self.model.geom(contact.geom2).name
        if "ground" in pair:
            return
        row = contact.efc_address
        impulse = float(self.data.efc_force[row]) * self.model.opt.timestep if row >= 0 else 0.0
        total = sums.setdefault(pair, [0.0] * 8)
        total[0] += impulse
        for k in range(3):
            total[1 + k] += (impulse + 1e-12) * float(contact.pos[k])
            total[4 + k] += (impulse + 1e-12) * float(contact.frame[k])
        total[7] += impulse + 1e-12

    def in_danger(self) -> bool:
        agent = self.data.qpos
        return self.patch is not None and all(abs(agent[k] - self.patch[k]) <= c.DANGER_HALF for k in (0, 1))

    def object_state(self) -> np.ndarray:
        states = np.hstack([self.data.qpos.reshape(-1, 7), self.data.qvel.reshape(-1, 6)])
        for row in states:
            mujoco.mju_rotVecQuat(row[10:], row[10:].copy(), row[3:7])
        return states


def contact_of(a: str, b: str, impulse: float, *sums: float) -> Contact:
    x, y, z, i, j, k, weight = sums
    length = math.sqrt(i * i + j * j + k * k)
    return Contact(a, b, (x / weight, y / weight, z / weight), (i / length, j / length, k / length), impulse)


def towards_yellow(world: World) -> int:
    x, y = world.data.qpos[7:9] - world.data.qpos[:2]
    return round(math.atan2(y, x) / (math.pi / 4)) % 8 + 1


@pytest.mark.parametrize("task", ALL_TASKS)
def test_a_step_is_a_plain_loop_bit_for_bit(task: Task) -> None:
    rng = np.random.default_rng(2)
    world = World()
    hits, contacts, danger = 0, 0, 0
    for _ in range(6):
        world.load(sample_puzzle(task, rng))
        plain = PlainWorld(world)
        for random in rng.integers(0, c.N_ACTIONS, 40).tolist():
            action = towards_yellow(world) if rng.random() < 0.5 else random
            outcome = world.step(action)
            assert outcome == plain.step(action)
            for name in ("qpos", "qvel", "qacc_warmstart", "tree_asleep", "time"):
                np.testing.assert_array_equal(getattr(world.data, name), getattr(plain.data, name))
            np.testing.assert_array_equal(world.object_state(), plain.object_state())
            hits, contacts = hits + len(outcome.hits), contacts + len(outcome.contacts)
            danger += outcome.in_danger
    # Otherwise there was little to compare.
    assert contacts > 50
    assert hits or task == "tool-use"
    assert danger or task != "avoidance"


def test_time_passes_without_an_action() -> None:
    world = World()
    world.load(sample_puzzle("preferences", np.random.default_rng(1)))
    world.data.qvel[6:8] = 1.5, 1  # the yellow sphere rolls into other objects
    plain = PlainWorld(world)
    for substeps in (1, 7, 0, 100):
        before = world.data.time
        assert world.advance(substeps) == plain.advance(substeps)
        np.testing.assert_array_equal(world.data.qpos, plain.data.qpos)
        np.testing.assert_array_equal(world.data.qvel, plain.data.qvel)
        assert world.data.time == pytest.approx(before + substeps * c.TIMESTEP_S)
    with pytest.raises(ValueError, match="expected 0 or more, got -1"):
        world.advance(-1)


@pytest.mark.skipif(not hasattr(time, "pthread_getcpuclockid"), reason="needs the clock of another thread")
def test_other_threads_run_while_time_passes() -> None:
    """Another thread runs when this thread has used some of its processor time, and not yet all."""
    world, over = World(), threading.Event()
    world.load(sample_puzzle("goal-seeking", np.random.default_rng(0)))
    ours, found = time.pthread_getcpuclockid(threading.get_ident()), list[float]()

    def look() -> None:
        while not over.wait(0.001):
            found.append(time.clock_gettime(ours))

    other = threading.Thread(target=look)
    other.start()
    try:
        while True:  # on a busy machine, the other thread may not run before this thread has finished
            start = time.thread_time()
            world.advance(20_000)
            end = time.thread_time()
            if any(start + 0.1 * (end - start) < moment < end - 0.1 * (end - start) for moment in found):
                break
    finally:
        over.set()
        other.join()


@pytest.mark.parametrize("field", [name for name in native.Layout._fields if "mj" not in name])
def test_a_wrong_offset_is_found(field: str) -> None:
    right = native.layout()
    wrong = right._replace(**{field: getattr(right, field) + 8})
    with pytest.raises(native.LayoutError, match=r"memory layout .* install the version of mujoco"):
        native.check(wrong)
