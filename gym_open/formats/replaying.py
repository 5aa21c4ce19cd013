"""Playing again what was recorded, a log or a release: from every stored state, the same actions in a fresh simulation.

A window is what lies between two keyframes. Each begins with the stored state, so that a difference in one does not
make the next ones differ. Contacts let differences grow: of 195 windows of random play that began one part in 10¹⁵ off,
as another processor's rounding may have it, 99% stayed within 10⁻³ for 64 steps, 79% for 128 and 40% for 256.

A window is *identical* if states, contacts and pictures are the same to the bit, and the integration state at its end
is that of the next keyframe; *within tolerance* if no number of a state or contact is off by more than the tolerance
and no picture in more than `STRAY_PIXELS` of its pixels; else it has *diverged*.
"""

from collections.abc import Callable
from typing import Literal

import msgspec
import mujoco
import numpy as np

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.tasks import rewarded
from gym_open.envs.world import World

_MOVING = mujoco.mjtState.mjSTATE_TIME | mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL
"""What a state begins with: numbers that play changes."""

Verdict = Literal["identical", "within tolerance", "diverged"]
VERDICTS: tuple[Verdict, ...] = ("identical", "within tolerance", "diverged")
"""From the best to the worst."""

STRAY_PIXELS = 0.01
"""Share of the pixels of one picture that may differ where states are within tolerance: edges of what is a hair off."""


class Window(msgspec.Struct):
    """What came of the steps between two keyframes."""

    stream: int
    segment: int
    first_step: int
    """The stream's number of its first step."""
    steps: int = 0
    state_error: dict[str, float] = {}
    """Of each object that is off: the greatest difference of a number of its state (m, m/s, rad/s; a quaternion's)."""
    contact_error: float = 0.0
    """Greatest difference of a number of a contact (N s, m); of one that is missing, its impulse."""
    contact_steps: int = 0
    """Steps whose contacts differ."""
    pixels: int = 0
    """Pixels that differ, of all pictures: of the image, and of depth and segmentation if they were recorded."""
    pictures: int = 0
    """Pictures in which any do."""
    first_different: int | None = None
    """How many steps the stream had taken when something was first not the same to the bit."""
    first_diverged: int | None = None
    """How many when something was first beyond tolerance."""

    @property
    def verdict(self) -> Verdict:
        """Identical to the bit; else whether all of it is within tolerance."""
        if self.first_different is None:
            return "identical"
        return "within tolerance" if self.first_diverged is None else "diverged"


class Moment(msgspec.Struct, frozen=True, eq=False):
    """What was recorded of one observation."""

    state: np.ndarray
    """(objects, 13), compared in its own type: float64 of a log, float32 of a release."""
    image: np.ndarray
    depth: np.ndarray | None = None
    segmentation: np.ndarray | None = None


class Player:
    """A world that follows what was recorded, and the window that it is in."""

    def __init__(self, tolerance: float) -> None:
        self.world = World()
        self._tolerance = tolerance
        self._window: Window | None = None

    def load(self, puzzle: Puzzle) -> None:
        """Lay out a puzzle: what follows happens in it."""
        self.world.load(puzzle, recolour_hits=rewarded(puzzle.task))

    @property
    def window(self) -> Window | None:
        """The window that is going on, if there is one."""
        return self._window

    def arrive(self, state: np.ndarray) -> None:
        """Hold the world against the state that was recorded of this moment, to the bit.

        Beyond tolerance are time (s), positions and velocities that are further off. The rest is the solver's first
        guess, counters of who falls asleep, and what never changes: off, they are not identical, no more.
        """
        if self._window is None:
            return
        found = self.world.save_state()
        if not np.array_equal(found, state):
            moving = slice(mujoco.mj_stateSize(self.world.model, _MOVING))
            near = found.shape == state.shape and bool((np.abs(found - state)[moving] <= self._tolerance).all())
            _note(self._window, diverged=not near)

    def begin(self, window: Window, state: np.ndarray, seen: Moment, names: tuple[str, ...]) -> None:
        """Begin a window in a recorded state of a puzzle that is loaded.

        Raises:
            ArtefactError: if the state is none of this version's world.
        """
        self.world.restore_state(state)
        self._window = window
        self._compare(window, seen, names, contact_error=0.0)

    def step(
        self, action: int, contact_error: Callable[[tuple[Contact, ...]], float | None], seen: Moment,
        names: tuple[str, ...],
    ) -> None:  # fmt: skip
        """Take an action and compare what comes of it.

        Args:
            action: 0 to 8.
            contact_error: how far contacts are from those recorded (N s, m); None if they are the same.
            seen: the observation after it, as recorded.
            names: of the objects whose states it has.
        """
        window = self._window
        assert window is not None, "play begins with a keyframe"
        outcome = self.world.step(action)
        window.steps += 1
        error = contact_error(outcome.contacts)
        if error is not None:
            window.contact_steps += 1
            window.contact_error = max(window.contact_error, error)
            _note(window, diverged=False)
        self._compare(window, seen, names, contact_error=error or 0.0)

    def see(self, seen: Moment, names: tuple[str, ...]) -> None:
        """Compare this moment once more, as it was recorded a second time: where one episode goes on in the next."""
        if self._window is not None:
            self._compare(self._window, seen, names, contact_error=0.0)

    def finish(self) -> Window | None:
        """End the window that was going on, and give it."""
        window, self._window = self._window, None
        return window

    def _compare(self, window: Window, seen: Moment, names: tuple[str, ...], *, contact_error: float) -> None:
        """Hold the world against what was recorded."""
        world = self.world
        state = world.object_state().astype(seen.state.dtype)
        beyond = contact_error > self._tolerance
        same = state.tobytes() == seen.state.tobytes()
        if not same:
            errors = np.nan_to_num(np.abs(state.astype(np.float64) - seen.state).max(axis=1), nan=np.inf)
            beyond |= bool(errors.max() > self._tolerance)
            for k in np.flatnonzero(errors):
                window.state_error[names[k]] = max(window.state_error.get(names[k], 0.0), float(errors[k]))
        pairs = [(world.observe(), seen.image)]
        pairs += [(world.depth(), seen.depth)] if seen.depth is not None else []
        pairs += [(world.segmentation(), seen.segmentation)] if seen.segmentation is not None else []
        for shown, picture in pairs:
            if wrong := _different(shown, picture):
                same = False
                beyond |= wrong > STRAY_PIXELS * shown.shape[0] * shown.shape[1]
                window.pixels += wrong
                window.pictures += 1
        if not same or beyond:
            _note(window, diverged=beyond)


def _note(window: Window, *, diverged: bool) -> None:
    step = window.first_step + window.steps
    if window.first_different is None:
        window.first_different = step
    if diverged and window.first_diverged is None:
        window.first_diverged = step


def _different(one: np.ndarray, other: np.ndarray) -> int:
    """Pixels in which two pictures differ."""
    if np.array_equal(one, other):
        return 0
    unlike = one != other
    return int((unlike.any(axis=2) if unlike.ndim == 3 else unlike).sum())
