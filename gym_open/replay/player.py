"""The player that logs and releases share: from every stored state, it takes the recorded actions in a new simulation.

A window is the steps between two keyframes. Each window begins with the stored state, so a difference in one window
does not spread to the next. Contacts make differences grow. Of 195 windows of random actions that began with a relative
difference of 10⁻¹⁵ (the rounding of another processor), 99% stayed within 10⁻³ for 64 steps, 79% for 128 and 40% for
256.

A window is *identical* if states, contacts and images are the same to the bit and the integration state at its end is
that of the next keyframe. It is *within tolerance* if no number of a state or contact differs by more than the
tolerance and no image differs in more than `STRAY_PIXELS` of its pixels. Otherwise it has *diverged*.
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
"""The first numbers of a state: those that change as the simulation runs."""

Verdict = Literal["identical", "within tolerance", "diverged"]
VERDICTS: tuple[Verdict, ...] = ("identical", "within tolerance", "diverged")
"""From the best to the worst."""

STRAY_PIXELS = 0.01
"""Share of the pixels of one image that may differ where states are within tolerance: a small offset moves edges."""


class ReplayWindow(msgspec.Struct):
    """The result of replaying the steps between two keyframes."""

    stream: int
    segment: int
    first_step: int
    """Number of the window's first step in its stream."""
    steps: int = 0
    state_error: dict[str, float] = {}
    """For each object that differs: the greatest difference of a number of its state (m, m/s, rad/s; quaternions)."""
    contact_error: float = 0.0
    """Greatest difference of a number of a contact (N s, m); for a missing contact, its impulse."""
    contact_steps: int = 0
    """Steps whose contacts differ."""
    pixels: int = 0
    """Pixels that differ, over all images: the observation, and depth and segmentation if they were recorded."""
    images: int = 0
    """Images with at least one such pixel."""
    first_different: int | None = None
    """Steps that the stream had taken when something first differed in any bit."""
    first_diverged: int | None = None
    """Steps that the stream had taken when something first exceeded the tolerance."""

    @property
    def verdict(self) -> Verdict:
        """Identical, within tolerance, or diverged: see the module's docstring."""
        if self.first_different is None:
            return "identical"
        return "within tolerance" if self.first_diverged is None else "diverged"


class RecordedObservation(msgspec.Struct, frozen=True, eq=False):
    """What was recorded at one moment."""

    state: np.ndarray
    """(objects, 13), compared in its own type: float64 in a log, float32 in a release."""
    image: np.ndarray
    depth: np.ndarray | None = None
    segmentation: np.ndarray | None = None


class Player:
    """A world that follows a recording, and the window that it currently replays."""

    def __init__(self, tolerance: float) -> None:
        self.world = World()
        self._tolerance = tolerance
        self._window: ReplayWindow | None = None

    def load(self, puzzle: Puzzle) -> None:
        """Load a puzzle; the following steps happen in it."""
        self.world.load(puzzle, recolour_hits=rewarded(puzzle.task))

    @property
    def window(self) -> ReplayWindow | None:
        """The current window; None before the first keyframe."""
        return self._window

    def check_state(self, state: np.ndarray) -> None:
        """Compare the world's integration state with the one that was recorded at this moment.

        The window has diverged if time (s), a position or a velocity differs by more than the tolerance. The other
        numbers are the solver's first guess, sleep counters and constants. A difference there only means that the
        window is not identical.
        """
        if self._window is None:
            return
        found = self.world.save_state()
        if not np.array_equal(found, state):
            moving = slice(mujoco.mj_stateSize(self.world.model, _MOVING))
            near = found.shape == state.shape and bool((np.abs(found - state)[moving] <= self._tolerance).all())
            _note(self._window, diverged=not near)

    def begin(
        self, window: ReplayWindow, state: np.ndarray, recorded: RecordedObservation, names: tuple[str, ...]
    ) -> None:
        """Begin a window from a recorded state of the loaded puzzle.

        Raises:
            ArtefactError: if the state does not fit this version's world.
        """
        self.world.restore_state(state)
        self._window = window
        self._compare(window, recorded, names, contact_error=0.0)

    def step(
        self, action: int, contact_error: Callable[[tuple[Contact, ...]], float | None], recorded: RecordedObservation,
        names: tuple[str, ...],
    ) -> None:  # fmt: skip
        """Take an action and compare the result with the recording.

        Args:
            action: 0 to 8.
            contact_error: how far contacts are from the recorded ones (N s, m); None if they are the same.
            recorded: the observation after the action.
            names: of the objects in the recorded state.
        """
        window = self._window
        assert window is not None, "a replay begins at a keyframe"
        outcome = self.world.step(action)
        window.steps += 1
        error = contact_error(outcome.contacts)
        if error is not None:
            window.contact_steps += 1
            window.contact_error = max(window.contact_error, error)
            _note(window, diverged=False)
        self._compare(window, recorded, names, contact_error=error or 0.0)

    def compare(self, recorded: RecordedObservation, names: tuple[str, ...]) -> None:
        """Compare the present moment with another recording of it, such as the next episode's first frame."""
        if self._window is not None:
            self._compare(self._window, recorded, names, contact_error=0.0)

    def finish(self) -> ReplayWindow | None:
        """End the current window and return it."""
        window, self._window = self._window, None
        return window

    def _compare(
        self, window: ReplayWindow, recorded: RecordedObservation, names: tuple[str, ...], *, contact_error: float
    ) -> None:
        """Compare the world with the recording and note the differences."""
        world = self.world
        state = world.object_state().astype(recorded.state.dtype)
        beyond = contact_error > self._tolerance
        same = state.tobytes() == recorded.state.tobytes()
        if not same:
            errors = np.nan_to_num(np.abs(state.astype(np.float64) - recorded.state).max(axis=1), nan=np.inf)
            beyond |= bool(errors.max() > self._tolerance)
            for k in np.flatnonzero(errors):
                window.state_error[names[k]] = max(window.state_error.get(names[k], 0.0), float(errors[k]))
        pairs = [(world.observe(), recorded.image)]
        pairs += [(world.depth(), recorded.depth)] if recorded.depth is not None else []
        pairs += [(world.segmentation(), recorded.segmentation)] if recorded.segmentation is not None else []
        for found, expected in pairs:
            if wrong := _different_pixels(found, expected):
                same = False
                beyond |= wrong > STRAY_PIXELS * found.shape[0] * found.shape[1]
                window.pixels += wrong
                window.images += 1
        if not same or beyond:
            _note(window, diverged=beyond)


def _note(window: ReplayWindow, *, diverged: bool) -> None:
    step = window.first_step + window.steps
    if window.first_different is None:
        window.first_different = step
    if diverged and window.first_diverged is None:
        window.first_diverged = step


def _different_pixels(one: np.ndarray, other: np.ndarray) -> int:
    """Number of pixels in which two images differ."""
    if np.array_equal(one, other):
        return 0
    unlike = one != other
    return int((unlike.any(axis=2) if unlike.ndim == 3 else unlike).sum())
