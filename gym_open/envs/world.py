"""One world: a puzzle's layout on a compiled model, changed by the agent's actions and observed by a camera."""

import functools
from typing import Any

import mujoco
import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.observation.scene import Drawing, Scene
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics import model as m
from gym_open.envs.physics import scenery
from gym_open.envs.physics.sleep import AWAKE, set_asleep
from gym_open.envs.physics.stepper import StepOutcome, Stepper
from gym_open.envs.puzzles import GOALS, STACK_HEIGHT, Puzzle, PuzzleError
from gym_open.errors import ArtefactError

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION

_EMPTY = "the world is empty: load a puzzle first"

GOAL_INDEX = {name: i for i, name in enumerate(m.INVENTORY) if m.kind_of(name) in GOALS}


class World:
    """A simulated table: its own MuJoCo data, and a model that worlds with equal options share. `load` comes first.

    Images are 84 pixels high and wide, or the options' `image_size`.

    Raises:
        MeshError: if a mesh of the options cannot be used.
    """

    def __init__(self, options: WorldOptions | None = None) -> None:
        self.options = options or WorldOptions()
        self.inventory = m.inventory(self.options)
        """(N,) names of the movable bodies, in the order of their states."""
        self._of_kind: dict[str, list[int]] = {}
        for index, name in enumerate(self.inventory):
            self._of_kind.setdefault(m.kind_of(name), []).append(index)
        self.model = m.build_model(self.options)
        self.data = mujoco.MjData(self.model)
        self.present = np.zeros(len(self.inventory), bool)
        """(N,) whether each inventory object is on the table."""
        self._puzzle: Puzzle | None = None
        self._recolour_hits = False
        self.stepper = Stepper(self.model, self.data, self.inventory)
        self._scene = Scene(self.model, self.options.image_size)

    def __reduce__(self) -> tuple[Any, ...]:
        """Build a copy or unpickled world anew, because compiled code holds addresses of this world's memory."""
        state = None if self._puzzle is None else (self._puzzle, self._recolour_hits, self.save_state())
        return _rebuilt, (self.options, state)

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
        """Lay the puzzle out, at rest. If `recolour_hits`, a touched goal turns its hit colour.

        Raises:
            PuzzleError: if the puzzle has a mesh that this world's options lack, or more of it than they allow.
        """
        indices = self._chosen(puzzle)
        self._puzzle, self._recolour_hits = puzzle, recolour_hits
        self.stepper.load(c.cell_centre(puzzle.patch.row, puzzle.patch.column) if puzzle.patch else None)
        self.present[:] = False
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, _parked_state(self.model), _STATE)
        self._place_objects(puzzle, indices)
        self._place_pieces(puzzle)
        asleep = np.arange(len(self.inventory))
        for group in indices:  # bodies that touch sleep together: in MuJoCo each points to the next, in a ring
            asleep[group] = group[1:] + group[:1]
        asleep[0] = AWAKE
        self._wake_and_sleep(asleep)
        self._scene.load(self.data, self.present, recolour_hits=recolour_hits)

    def step(self, action: int) -> StepOutcome:
        """Take one step: the action moves the agent by one cell, then stops it. During action 0 no time passes.

        Raises:
            ValueError: if the action is not one of 0–8.
            PuzzleError: before the first `load`.
        """
        if not 0 <= action < c.N_ACTIONS:
            raise ValueError(f"action: expected 0 to {c.N_ACTIONS - 1}, got {action}")
        if self._puzzle is None:
            raise PuzzleError(_EMPTY)
        if action == 0:
            return self.stepper.advance(0)
        i, j = c.MOVES[action]
        return self.stepper.step((c.MOVE_SPEED * i, c.MOVE_SPEED * j), self.options.substeps)

    def advance(self, substeps: int) -> StepOutcome:
        """Simulate substeps without an action: nothing pushes or stops the agent.

        Raises:
            ValueError: if `substeps` is negative.
            PuzzleError: before the first `load`.
        """
        if substeps < 0:
            raise ValueError(f"substeps: expected 0 or more, got {substeps}")
        if self._puzzle is None:
            raise PuzzleError(_EMPTY)
        return self.stepper.advance(substeps)

    def observe(self, out: np.ndarray | None = None) -> np.ndarray:
        """The observation: (84, 84, 3) uint8 RGB, written to `out` if that is given."""
        image = self._scene.image(self.data.qpos, self.stepper.hit).rgb
        if out is None:
            return image.copy()
        out[...] = image
        return out

    @property
    def drawing(self) -> Drawing:
        """The input of compiled code that draws this world; valid until the next `load`."""
        return self._scene.drawing

    def segmentation(self) -> np.ndarray:
        """(84, 84) int32: id of the geom at each pixel."""
        return self._scene.image(self.data.qpos, self.stepper.hit).label.copy()

    def depth(self) -> np.ndarray:
        """(84, 84) float32: distance in metres along the viewing direction; infinite where there is nothing."""
        return self._scene.image(self.data.qpos, self.stepper.hit).depth.astype(np.float32)

    def normals(self) -> np.ndarray:
        """(84, 84, 3) float32: unit normal of the visible surface, in the world's frame; 0 where there is nothing."""
        return self._scene.image(self.data.qpos, self.stepper.hit, normals=True).normal.copy()

    def shown_colours(self) -> tuple[np.ndarray, np.ndarray]:
        """Geoms (n,) of the objects on the table, and their colours (n, 3), 0–255, at present."""
        return self._scene.shown_colours(self.stepper.hit)

    def object_state(self) -> np.ndarray:
        """(N, 13) float64: position, quaternion (scalar first), linear and angular velocity, in the world's frame."""
        return self.stepper.states()

    def save_state(self) -> np.ndarray:
        """(S,) float64: all that the world's future depends on, except the puzzle."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        hit = self.stepper.hit[list(GOAL_INDEX.values())].astype(float)
        return np.concatenate([state, self.data.tree_asleep.astype(float), hit])

    def restore_state(self, state: np.ndarray) -> None:
        """Restore, bit for bit, a state saved from a world with the same puzzle.

        Raises:
            ArtefactError: if the state is damaged, or has another size because it is of another version of the model.
        """
        size = mujoco.mj_stateSize(self.model, _STATE)
        n = len(self.inventory)
        expected = size + n + len(GOAL_INDEX)
        if state.shape != (expected,):
            found = f"expected {expected} numbers, got shape {state.shape}"
            raise ArtefactError(f"world state: {found}; another version of the world saved it; start a new run")
        asleep = state[size : size + n]
        if not ((asleep == np.round(asleep)) & (asleep >= AWAKE) & (asleep < n)).all():
            raise ArtefactError("world state: its sleep entries are not object indices; it is damaged; start a new run")
        sleepers = np.flatnonzero(asleep >= 0)
        if not np.array_equal(np.sort(asleep[sleepers]), sleepers):  # without a ring, MuJoCo ends the process
            raise ArtefactError(
                "world state: its sleeping objects do not point to one another in rings; it is damaged; start a new run"
            )
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state[:size], _STATE)
        self._wake_and_sleep(asleep.astype(np.int32), state[:size])
        self.stepper.hit[list(GOAL_INDEX.values())] = state[size + n :] > 0

    def _wake_and_sleep(self, asleep: np.ndarray, state: np.ndarray | None = None) -> None:
        """Compute all derived quantities, then put bodies to sleep: MuJoCo does not update bodies that sleep."""
        mujoco.mj_forward(self.model, self.data)
        if state is not None:  # mj_forward overwrote the warm start
            mujoco.mj_setState(self.model, self.data, state, _STATE)
        set_asleep(self.model, self.data, asleep)

    def _chosen(self, puzzle: Puzzle) -> list[list[int]]:
        """For each placement, the indices of its bodies: one body, or the light cubes of a stack."""
        used = dict.fromkeys(self._of_kind, 0)
        chosen: list[list[int]] = []
        for item in puzzle.objects:
            kind, count = ("light", STACK_HEIGHT) if item.kind == "stack" else (item.kind, 1)
            have, first = self._of_kind.get(kind, []), used.get(kind, 0)
            if first + count > len(have):
                raise PuzzleError(
                    f"puzzle: more objects of kind {kind!r} than this world's {len(have)}; "
                    "add the mesh, or increase its `count`, in WorldOptions.meshes"
                )
            chosen.append(have[first : first + count])
            used[kind] = first + count
        return chosen

    def _place_objects(self, puzzle: Puzzle, chosen: list[list[int]]) -> None:
        poses = self.data.qpos.reshape(-1, 7)
        for item, indices in zip(puzzle.objects, chosen, strict=True):
            for level, index in enumerate(indices):
                self.present[index] = True
                poses[index, :2] = c.cell_centre(item.row, item.column)
                poses[index, 2] += level * self.options.size("light")
                if item.turned:
                    poses[index, 3:] = np.sqrt(0.5), 0, 0, np.sqrt(0.5)

    def _place_pieces(self, puzzle: Puzzle) -> None:
        layout = {"pen": puzzle.pen, "ramp": puzzle.pen, "patch": puzzle.patch}
        for name in scenery.PIECES:
            piece = layout.get(name)
            place, turn = scenery.piece_at_rest(name), scenery.UNTURNED
            if piece is not None:
                place = (*c.cell_centre(piece.row, piece.column), 0.0)
            if name == "ramp" and puzzle.pen is not None:
                turn = scenery.RAMP_TURNS[puzzle.pen.ramp_side]
            if name == "lid" and any(item.kind == "stack" for item in puzzle.objects):
                place = (0.0, 0.0, self.options.size("light") * (STACK_HEIGHT - 1))
            mocap = self.model.body(name).mocapid[0]
            self.data.mocap_pos[mocap] = place
            self.data.mocap_quat[mocap] = turn


def _rebuilt(options: WorldOptions, state: tuple[Puzzle, bool, np.ndarray] | None) -> World:
    world = World(options)
    if state is not None:
        puzzle, recolour_hits, saved = state
        world.load(puzzle, recolour_hits=recolour_hits)
        world.restore_state(saved)
    return world


@functools.lru_cache(maxsize=64)
def _parked_state(model: mujoco.MjModel) -> np.ndarray:
    """Integration state of the model at time 0, after all parked objects have settled on the ground."""
    data = mujoco.MjData(model)
    for _ in range(500 * round(c.TIMESTEP_S / model.opt.timestep)):
        mujoco.mj_step(model, data)
    data.time = 0
    data.qvel[:] = 0
    data.qacc_warmstart[:] = 0
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return state
