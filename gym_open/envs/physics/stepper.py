"""One step, or some substeps, as one compiled call without the interpreter lock.

Each world has a *board*: a record of plain numbers that compiled code reads and writes. The boards of many worlds can
be in one array, so that one call can step any of them (`fleet.py`).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import mujoco
import numpy as np
from numba.np.numpy_support import carray

from gym_open.envs import constants as c
from gym_open.envs.jit import compiled
from gym_open.envs.physics.contacts import Contact, contacts_of, thing_names, things_of
from gym_open.envs.physics.model import kind_of
from gym_open.envs.physics.native import Layout, address, call2, call3, layout, pointer
from gym_open.envs.puzzles import GOALS

_PAIRS = 256
"""Largest number of pairs of things in contact during one step: far more than ever occur."""


class StepOutcome(msgspec.Struct, frozen=True):
    """Events during a step."""

    hits: tuple[str, ...]
    """Goals that the agent touched for the first time, checked at every substep."""
    in_danger: bool
    """Whether the agent was inside the danger patch at any substep."""
    contacts: tuple[Contact, ...]
    """All contacts except those with the table top."""


def new_boards(count: int, objects: int) -> np.ndarray:
    """Boards (count,) of worlds with `objects` movable objects each."""
    kind = [
        ("model", np.int64),  # address of mjModel
        ("data", np.int64),  # address of mjData
        ("qpos", np.int64),  # address of mjData's qpos
        ("qvel", np.int64),  # and of its qvel
        ("danger", np.float64, 2),  # centre of the danger patch; NaN if there is none
        ("counts", np.int32, 3),  # of the step: pairs in contact, new hits, whether in danger
        ("hit_order", np.int32, objects),  # goals hit for the first time in the step, in order
        ("hit", np.uint8, objects),  # 1: this goal was hit after the puzzle was loaded
        ("pairs", np.int32, (_PAIRS, 2)),  # things in contact, in order of the first contact
        ("sums", np.float64, (_PAIRS, 8)),  # per pair: impulse, mean position, normal, weight
        ("states", np.float64, (objects, 13)),  # `World.object_state`
    ]
    return np.zeros(count, np.dtype(kind, align=True))


class StepConstants(NamedTuple):
    """Constants of all worlds of one model, as an argument of compiled code."""

    layout: Layout
    timestep: float
    danger_half: float
    """The agent is in danger while its centre is within ± this distance of the patch's centre."""
    things: np.ndarray
    """(ngeom,) int32: result of `things_of`."""
    goals: np.ndarray
    """(ngeom,) int32: for each thing, the object's index if it is a goal, else −1."""
    agent: int
    """Id of the agent's thing."""


@compiled
def simulate(  # noqa: PLR0917  # compiled code takes arguments by position
    boards: np.ndarray, index: int, push_x: float, push_y: float, substeps: int, stop: bool, constants: StepConstants
) -> None:
    """Push the agent, simulate substeps, and stop the agent. A falling agent keeps falling, so that it cannot fly.

    Args:
        boards: boards of all worlds.
        index: index of the world to step.
        push_x: change of the agent's velocity along x in m/s.
        push_y: the same along y.
        substeps: number of substeps.
        stop: whether the agent is stopped after the last substep.
        constants: constants of the worlds' model.
    """
    board = boards[index]
    agent = carray(pointer(board.qvel), 6, np.float64)
    agent[0] += push_x
    agent[1] += push_y
    touches, hits = 0, 0
    danger = substeps == 0 and _in_danger(board, constants.danger_half)
    for _ in range(substeps):
        call2(constants.layout.mj_step, board.model, board.data)
        before = touches
        touches = _add_contacts(board, touches, constants)
        for slot in range(before, touches):
            hits = _add_hit(board, slot, hits, constants)
        danger = danger or _in_danger(board, constants.danger_half)
    _average(board.sums, touches)
    board.counts[0], board.counts[1], board.counts[2] = touches, hits, danger
    if stop:
        down = min(agent[2], 0.0)
        agent[:] = 0.0
        agent[2] = down


@compiled
def read_states(boards: np.ndarray, index: int, constants: StepConstants) -> None:
    """Write the board's `states`: position, quaternion, linear and angular velocity in the world's frame."""
    board = boards[index]
    states = board.states
    n, start = len(states), np.int64(states.ctypes.data)
    poses = carray(pointer(board.qpos), (n, 7), np.float64)
    speeds = carray(pointer(board.qvel), (n, 6), np.float64)
    for i in range(n):
        states[i, :7] = poses[i]
        states[i, 7:] = speeds[i]
        if speeds[i, 3] != 0 or speeds[i, 4] != 0 or speeds[i, 5] != 0:  # in MuJoCo it is in the body's frame
            out, speed, turn = start + 8 * (13 * i + 10), board.qvel + 8 * (6 * i + 3), board.qpos + 8 * (7 * i + 3)
            call3(constants.layout.mju_rotVecQuat, out, speed, turn)


@compiled
def _in_danger(board: Any, half: float) -> bool:
    agent = carray(pointer(board.qpos), 2, np.float64)
    return abs(agent[0] - board.danger[0]) <= half and abs(agent[1] - board.danger[1]) <= half


@compiled
def _add_hit(board: Any, slot: int, hits: int, constants: StepConstants) -> int:
    """If a new pair is the agent and a goal that was not hit before, add the hit; return the number of hits."""
    a, b = board.pairs[slot, 0], board.pairs[slot, 1]
    if constants.agent not in (a, b):
        return hits
    goal = constants.goals[b if a == constants.agent else a]
    if goal < 0 or board.hit[goal]:
        return hits
    board.hit[goal] = 1
    board.hit_order[hits] = goal
    return hits + 1


@compiled
def _add_contacts(board: Any, count: int, constants: StepConstants) -> int:
    """Add the contacts of the last substep to pairs and sums; return the number of pairs."""
    at, pairs, sums = constants.layout, board.pairs, board.sums
    touching = carray(pointer(board.data + at.ncon), 1, np.int32)[0]
    contacts = carray(pointer(board.data + at.contact), 1, np.int64)[0]
    forces = carray(pointer(board.data + at.efc_force), 1, np.int64)[0]
    for i in range(touching):
        contact = contacts + i * at.contact_size
        geoms = carray(pointer(contact + at.geom), 2, np.int32)
        a, b = constants.things[geoms[0]], constants.things[geoms[1]]
        if a < 0 or b < 0:  # the ground
            continue
        slot = 0
        while slot < count and (pairs[slot, 0] != a or pairs[slot, 1] != b):
            slot += 1
        if slot == len(pairs):
            continue
        if slot == count:
            pairs[slot, 0], pairs[slot, 1] = a, b
            sums[slot] = 0.0
            count += 1
        row = carray(pointer(contact + at.efc_address), 1, np.int32)[0]
        force = carray(pointer(forces + 8 * row), 1, np.float64)[0] if row >= 0 else 0.0
        impulse = force * constants.timestep
        weight = impulse + 1e-12
        position = carray(pointer(contact + at.pos), 3, np.float64)
        normal = carray(pointer(contact + at.frame), 3, np.float64)
        sums[slot, 0] += impulse
        for k in range(3):
            sums[slot, 1 + k] += weight * position[k]
            sums[slot, 4 + k] += weight * normal[k]
        sums[slot, 7] += weight
    return count


@compiled
def _average(sums: np.ndarray, count: int) -> None:
    """Turn the weighted sums into mean positions and unit normals."""
    for slot in range(count):
        i, j, k = sums[slot, 4], sums[slot, 5], sums[slot, 6]
        length = np.sqrt(i * i + j * j + k * k)
        if length == 0.0:
            length = 1.0
        for axis in range(3):
            sums[slot, 1 + axis] /= sums[slot, 7]
            sums[slot, 4 + axis] /= length


class Stepper:
    """Steps one world through its board."""

    hit: np.ndarray
    """(n_objects,) bool: goals hit after `load`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, objects: Sequence[str]) -> None:
        """Bind a board to a world's memory.

        Args:
            model: the world's model.
            data: the world's data.
            objects: names of the movable bodies, in the order of their joints; their kinds determine the goals.
        """
        self._objects, self._names = tuple(objects), thing_names(model)
        self._bound = model, data  # kept alive while their addresses are used
        self.constants = _constants(model, objects)
        boards = new_boards(1, len(objects))
        board = boards[0]
        board["model"], board["data"] = model._address, data._address  # noqa: SLF001
        board["qpos"], board["qvel"] = address(data.qpos), address(data.qvel)
        self.move(boards, 0)
        self.load(None)

    @property
    def board(self) -> np.ndarray:
        """The board (a record). Copy it; do not change it."""
        return self._boards[self._index]

    @property
    def place(self) -> tuple[np.ndarray, int]:
        """The boards that hold this world's board, and its index: arguments of `simulate`."""
        return self._boards, self._index

    def move(self, boards: np.ndarray, index: int) -> None:
        """Use another board, which must hold the same values."""
        self._boards, self._index = boards, index
        board = boards[index]
        self.hit = board["hit"].view(np.bool_)
        self._danger, self._counts, self._hit_order = board["danger"], board["counts"], board["hit_order"]
        self._pairs, self._sums, self._states = board["pairs"], board["sums"], board["states"]

    def load(self, danger: tuple[float, float] | None) -> None:
        """Start a puzzle: no goal is hit; `danger` is the centre of its danger patch, if it has one."""
        self.hit[:] = False
        self._danger[:] = np.nan if danger is None else danger

    def step(self, push: tuple[float, float], substeps: int) -> StepOutcome:
        """Change the agent's velocity by `push` (m/s), simulate substeps, and stop the agent."""
        simulate(self._boards, self._index, push[0], push[1], substeps, True, self.constants)
        return self.outcome()

    def advance(self, substeps: int) -> StepOutcome:
        """Simulate zero or more substeps; nothing pushes or stops the agent."""
        simulate(self._boards, self._index, 0.0, 0.0, substeps, False, self.constants)
        return self.outcome()

    def outcome(self) -> StepOutcome:
        """The events of the last step, as Python objects."""
        touches, new_hits, danger = self._counts.tolist()
        hits = tuple(self._objects[i] for i in self._hit_order[:new_hits].tolist()) if new_hits else ()
        contacts = contacts_of(self._names, self._pairs[:touches], self._sums[:touches]) if touches else ()
        return StepOutcome(hits, bool(danger), contacts)

    def states(self) -> np.ndarray:
        """(n_objects, 13) float64: position, quaternion, linear and angular velocity, in the world's frame."""
        read_states(self._boards, self._index, self.constants)
        return self._states.copy()


def _constants(model: mujoco.MjModel, objects: Sequence[str]) -> StepConstants:
    goals = np.full(model.ngeom, -1, np.int32)
    for number, name in enumerate(objects):
        if kind_of(name) in GOALS:
            goals[model.body(name).geomadr[0]] = number
    agent = int(model.body("agent").geomadr[0])
    return StepConstants(layout(), float(model.opt.timestep), c.DANGER_HALF, things_of(model), goals, agent)
