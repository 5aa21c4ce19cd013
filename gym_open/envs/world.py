"""One world: a puzzle's layout on the fixed model, moved by the agent's actions and seen by its camera."""

import functools

import msgspec
import mujoco
import numpy as np

from gym_open.envs import constants as c
from gym_open.envs import model as m
from gym_open.envs.contacts import Contact, ContactSum
from gym_open.envs.puzzles import GOALS, SIDES, Puzzle, PuzzleError
from gym_open.envs.scene import Scene
from gym_open.envs.sleep import AWAKE, set_asleep
from gym_open.errors import ArtefactError

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION

_EMPTY = "the world is empty: load a puzzle first"

N = len(m.INVENTORY)
GOAL_INDEX = {name: i for i, name in enumerate(m.INVENTORY) if m.kind_of(name) in GOALS}


class StepOutcome(msgspec.Struct, frozen=True):
    """What happened during a step."""

    hits: tuple[str, ...]
    """Goals that the agent touched for the first time, looked for at every substep."""
    in_danger: bool
    """Whether the agent was inside the danger patch at any substep."""
    contacts: tuple[Contact, ...]
    """What touched what, contacts with the table top left out."""


class World:
    """MuJoCo data of its own over the shared model. Nothing happens before `load`."""

    def __init__(self) -> None:
        self.model = m.fixed_model()
        self.data = mujoco.MjData(self.model)
        self.present = np.zeros(N, bool)
        """(N,) which inventory objects are on the table."""
        self._puzzle: Puzzle | None = None
        self._contacts = ContactSum(self.model)
        self._scene = Scene()
        self._hit: set[str] = set()
        self._danger: tuple[float, float] | None = None
        self._goal_of_geom = {self.model.geom(name).id: name for name in GOAL_INDEX}
        self._agent_geom = self.model.geom("agent").id

    @property
    def puzzle(self) -> Puzzle:
        """The puzzle that was loaded.

        Raises:
            PuzzleError: before the first `load`.
        """
        if self._puzzle is None:
            raise PuzzleError(_EMPTY)
        return self._puzzle

    def load(self, puzzle: Puzzle, *, recolour_hits: bool = False) -> None:
        """Lay the puzzle out, at rest; a goal turns its hit colour on a touch if `recolour_hits`."""
        self._puzzle = puzzle
        self._danger = c.cell_centre(puzzle.patch.row, puzzle.patch.column) if puzzle.patch else None
        self._hit = set()
        self.present[:] = False
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, _parked_state(), _STATE)
        poses = self.data.qpos.reshape(N, 7)
        free = {kind: [i for i, name in enumerate(m.INVENTORY) if m.kind_of(name) == kind] for kind in c.CAPACITY}
        for item in puzzle.objects:
            index = free[item.kind].pop(0)
            self.present[index] = True
            poses[index, :2] = c.cell_centre(item.row, item.column)
        self._place_pieces(puzzle)
        asleep = np.arange(N)
        asleep[0] = AWAKE
        self._wake_and_sleep(asleep)
        self._scene.load(puzzle, self.present, recolour_hits=recolour_hits)

    def step(self, action: int) -> StepOutcome:
        """Take one action: a move of one cell, after which the agent stands still; 0 lets no time pass.

        Raises:
            ValueError: if the action is none of 0–8.
            PuzzleError: before the first `load`.
        """
        if not 0 <= action < c.N_ACTIONS:
            raise ValueError(f"action: expected 0 to {c.N_ACTIONS - 1}, got {action}")
        if self._puzzle is None:
            raise PuzzleError(_EMPTY)
        if action == 0:
            return StepOutcome((), self._in_danger(), ())
        data, contacts = self.data, self._contacts
        contacts.clear()
        danger = False
        speed = data.qvel
        speed[0] += c.MOVE_SPEED * c.MOVES[action][0]
        speed[1] += c.MOVE_SPEED * c.MOVES[action][1]
        for _ in range(c.SUBSTEPS):
            mujoco.mj_step(self.model, data)
            contacts.add(data)
            danger = danger or self._in_danger()
        # Standing still, but falling on: the agent cannot fly.
        speed[:6] = 0, 0, min(speed[2], 0.0), 0, 0, 0
        hits = self._new_hits()
        return StepOutcome(hits, danger, contacts.contacts())

    def observe(self, out: np.ndarray | None = None) -> np.ndarray:
        """What the camera sees: (84, 84, 3) uint8 RGB, written to `out` if that is given."""
        image = self._scene.picture(self.data.qpos, self._hit).rgb
        if out is None:
            return image.copy()
        out[...] = image
        return out

    def segmentation(self) -> np.ndarray:
        """(84, 84) int32: id of the geom that each pixel shows."""
        return self._scene.picture(self.data.qpos, self._hit).label.copy()

    def object_state(self) -> np.ndarray:
        """(N, 13) float64: position, quaternion (scalar first), linear and angular velocity, in the world's frame."""
        state = np.empty((N, 13))
        poses, speeds = self.data.qpos.reshape(N, 7), self.data.qvel.reshape(N, 6)
        state[:, :7] = poses
        state[:, 7:] = speeds
        for i in speeds[:, 3:].any(axis=1).nonzero()[0]:  # MuJoCo keeps it in the body's own frame
            mujoco.mju_rotVecQuat(state[i, 10:], speeds[i, 3:], poses[i, 3:])
        return state

    def save_state(self) -> np.ndarray:
        """(S,) float64: everything that the future depends on, besides the puzzle."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        hit = [float(name in self._hit) for name in GOAL_INDEX]
        return np.concatenate([state, self.data.tree_asleep.astype(float), hit])

    def restore_state(self, state: np.ndarray) -> None:
        """Go back, bit for bit, to a state saved from a world with the same puzzle.

        Raises:
            ArtefactError: if the state has another size: it comes from another version of the model.
        """
        size = mujoco.mj_stateSize(self.model, _STATE)
        expected = size + N + len(GOAL_INDEX)
        if state.shape != (expected,):
            found = f"expected {expected} numbers, got shape {state.shape}"
            raise ArtefactError(f"world state: {found}; it was saved by another version of the world, start anew")
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state[:size], _STATE)
        self._wake_and_sleep(state[size : size + N].astype(np.int32), state[:size])
        self._hit = {name for name, hit in zip(GOAL_INDEX, state[size + N :], strict=True) if hit}

    def _wake_and_sleep(self, asleep: np.ndarray, state: np.ndarray | None = None) -> None:
        """Compute every body's derived quantities, which MuJoCo leaves alone while it sleeps; then let them sleep."""
        mujoco.mj_forward(self.model, self.data)
        if state is not None:  # mj_forward overwrote the warm start
            mujoco.mj_setState(self.model, self.data, state, _STATE)
        set_asleep(self.model, self.data, asleep)

    def _place_pieces(self, puzzle: Puzzle) -> None:
        for index, (name, piece) in enumerate((("pen", puzzle.pen), ("ramp", puzzle.pen), ("patch", puzzle.patch))):
            mocap = self.model.body(name).mocapid[0]
            place: tuple[float, ...] = m.piece_parking(index)
            angle = 0.0
            if piece is not None:
                place = (*c.cell_centre(piece.row, piece.column), 0.0)
            if name == "ramp" and puzzle.pen is not None:
                i, j = SIDES[puzzle.pen.ramp_side]
                angle = np.arctan2(-i, j)
            self.data.mocap_pos[mocap] = place
            self.data.mocap_quat[mocap] = np.cos(angle / 2), 0, 0, np.sin(angle / 2)

    def _in_danger(self) -> bool:
        if self._danger is None:
            return False
        x, y = self._danger
        agent = self.data.qpos
        return bool(abs(agent[0] - x) <= c.DANGER_HALF and abs(agent[1] - y) <= c.DANGER_HALF)

    def _new_hits(self) -> tuple[str, ...]:
        hits: list[str] = []
        for a, b in self._contacts.pairs.tolist():
            if self._agent_geom in (a, b):
                name = self._goal_of_geom.get(b if a == self._agent_geom else a)
                if name and name not in self._hit:
                    self._hit.add(name)
                    hits.append(name)
        return tuple(hits)


@functools.cache
def _parked_state() -> np.ndarray:
    """Integration state of the model with all objects parked and settled on the ground, at time 0."""
    model = m.fixed_model()
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    data.time = 0
    data.qvel[:] = 0
    data.qacc_warmstart[:] = 0
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return state
