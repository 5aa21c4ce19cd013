"""Playing a log again: from every keyframe, the logged actions in a fresh simulation, compared with what was logged.

A window is what lies between two keyframes. Each begins with the logged state, so that a difference in one does not
make the next ones differ. Contacts let differences grow: of 195 windows of random play that began one part in 10¹⁵ off,
as another processor's rounding may have it, 99% stayed within 10⁻³ for 64 steps, 79% for 128 and 40% for 256.
"""

from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec
import numpy as np

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import model_xml
from gym_open.envs.tasks import rewarded
from gym_open.envs.world import World
from gym_open.errors import ArtefactError
from gym_open.formats.logs.reader import Log
from gym_open.formats.logs.schemas import LogError, Segment

Verdict = Literal["identical", "within tolerance", "diverged"]

_PIECE = 256
"""Steps of the log that are in memory at a time."""
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


def same_model(log: Log) -> bool:
    """Whether the model in the log is the one that this version builds for the default world."""
    return log.model_xml == model_xml()


def replay(log: Log, tolerance: float) -> Iterator[Window]:
    """Play a log again, window by window, each with what differs in it.

    A window is *identical* if states, contacts and pictures are the same to the bit, and the integration state at its
    end is that of the next keyframe; *within tolerance* if no number of a state or contact is off by more than
    `tolerance` and no picture in more than `STRAY_PIXELS` of its pixels; else it has *diverged*.

    Args:
        log: opened by `open_log`.
        tolerance: how far a number may be off, in its unit.

    Raises:
        LogError: if the log is damaged, or has another model's objects.
        ArtefactError: if a state is none of this version's world.
    """
    player = _Player(log, tolerance)
    for piece in log.segments(_PIECE):
        yield from player.play(piece)
    yield from player.finish()


class _Player:
    """A world that follows the log, and the window that it is in."""

    def __init__(self, log: Log, tolerance: float) -> None:
        self._log, self._tolerance = log, tolerance
        self._world = World()
        self._window: Window | None = None

    def play(self, piece: Segment) -> Iterator[Window]:
        """Play a piece of a segment; every window that ends in it is yielded."""
        if piece.object_names != self._world.inventory:
            raise LogError(
                f"{self._log.path}: expected the {len(self._world.inventory)} objects of this version's world, got "
                f"{', '.join(piece.object_names)}; replay it with the version that its provenance names"
            )
        frames = {frame.segment_step - piece.segment_step: frame for frame in piece.keyframes}
        for i in range(len(piece.actions) + 1):
            if i in frames:
                yield from self._restart(piece, i, frames[i].integration_state)
            if i < len(piece.actions):
                self._step(piece, i)
        if piece.ended is not None:
            yield from self.finish()

    def finish(self) -> Iterator[Window]:
        """The window that was going on, if there is one."""
        if self._window is not None:
            yield self._window
            self._window = None

    def _restart(self, piece: Segment, i: int, state: np.ndarray) -> Iterator[Window]:
        """End a window at observation `i` of the piece, and begin the next one in the logged state."""
        step = piece.first_step + i
        if self._window is None:
            self._world.load(piece.puzzle, recolour_hits=rewarded(piece.puzzle.task))
        elif not np.array_equal(self._world.save_state(), state):
            _note(self._window, step, diverged=False)
        yield from self.finish()
        try:
            self._world.restore_state(state)
        except ArtefactError as error:
            raise ArtefactError(
                f"{self._log.path}: keyframe before step {step}: {error}; replay it with the version in its provenance"
            ) from None
        self._window = Window(piece.stream, piece.index, step)
        self._compare(self._window, piece, i, contact_error=0.0)

    def _step(self, piece: Segment, i: int) -> None:
        """Take the piece's action `i` and compare what comes of it."""
        assert self._window is not None, "a log begins with a keyframe, or its reader refuses it"
        window = self._window
        outcome = self._world.step(int(piece.actions[i]))
        error = 0.0
        if outcome.contacts != piece.contacts[i]:
            error = contact_error(outcome.contacts, piece.contacts[i])
            window.contact_steps += 1
            window.contact_error = max(window.contact_error, error)
            _note(window, piece.first_step + i + 1, diverged=False)
        window.steps += 1
        self._compare(window, piece, i + 1, contact_error=error)

    def _compare(self, window: Window, piece: Segment, i: int, *, contact_error: float) -> None:
        """Hold the world against observation `i` of the piece."""
        world, logged = self._world, piece.object_state[i]
        state = world.object_state()
        beyond = contact_error > self._tolerance
        same = state.tobytes() == logged.tobytes()
        if not same:
            errors = np.nan_to_num(np.abs(state - logged).max(axis=1), nan=np.inf)
            beyond |= bool(errors.max() > self._tolerance)
            for k in np.flatnonzero(errors):
                name = piece.object_names[k]
                window.state_error[name] = max(window.state_error.get(name, 0.0), float(errors[k]))
        pairs = [(world.observe(), piece.images)]
        pairs += [(world.depth(), piece.depth)] if piece.depth is not None else []
        pairs += [(world.segmentation(), piece.segmentation)] if piece.segmentation is not None else []
        for shown, pictures in pairs:
            if wrong := _different(shown, pictures[i]):
                same = False
                beyond |= wrong > STRAY_PIXELS * shown.shape[0] * shown.shape[1]
                window.pixels += wrong
                window.pictures += 1
        if not same or beyond:
            _note(window, piece.first_step + i, diverged=beyond)


def _note(window: Window, step: int, *, diverged: bool) -> None:
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


def contact_error(one: Sequence[Contact], other: Sequence[Contact]) -> float:
    """How far two steps' contacts are apart (N s, m).

    The greatest difference of impulse, position or normal of a contact that is in both; the impulse of one that is not.
    """
    first, second = ({(contact.a, contact.b): contact for contact in contacts} for contacts in (one, other))
    errors = [contact.impulse for pair, contact in (first | second).items() if (pair in first) != (pair in second)]
    for pair in first.keys() & second.keys():
        a, b = (np.array([c.impulse, *c.position, *c.normal]) for c in (first[pair], second[pair]))
        errors.append(float(np.abs(a - b).max()))
    return max(errors, default=0.0)
