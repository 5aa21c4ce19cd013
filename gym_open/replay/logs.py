"""Replay of a log: its segments, window by window, in a new simulation (see `replay.player`)."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import model_xml
from gym_open.errors import ArtefactError
from gym_open.formats.logs.reader import Log
from gym_open.formats.logs.schemas import LogError, Segment
from gym_open.replay.player import Player, RecordedObservation, ReplayWindow

_PIECE = 256
"""Steps of the log that are held in memory at a time."""


def same_model(log: Log) -> bool:
    """Whether the model in the log is the one that this version builds for the default world."""
    return log.model_xml == model_xml()


def replay(log: Log, tolerance: float) -> Iterator[ReplayWindow]:
    """Replay a log, window by window; each window says what differs.

    Args:
        log: opened by `open_log`.
        tolerance: how far a number may differ, in its unit.

    Raises:
        LogError: if the log is damaged, or has the objects of another model.
        ArtefactError: if a state does not fit this version's world.
    """
    player = Player(tolerance)
    for piece in log.segments(_PIECE):
        yield from _play(player, log, piece)
    if window := player.finish():
        yield window


def _play(player: Player, log: Log, piece: Segment) -> Iterator[ReplayWindow]:
    """Replay a piece of a segment and yield every window that ends in it."""
    inventory = player.world.inventory
    if piece.object_names != inventory:
        raise LogError(
            f"{log.path}: expected the {len(inventory)} objects of this version's world, got "
            f"{', '.join(piece.object_names)}; replay it with the version that its provenance names"
        )
    frames = {frame.segment_step - piece.segment_step: frame for frame in piece.keyframes}
    for i in range(len(piece.actions) + 1):
        if i in frames:
            yield from _restart(player, log, piece, i, frames[i].integration_state)
        if i < len(piece.actions):
            player.step(int(piece.actions[i]), _against(piece.contacts[i]), _recorded(piece, i + 1), inventory)
    if piece.ended is not None and (window := player.finish()):
        yield window


def _restart(player: Player, log: Log, piece: Segment, i: int, state: np.ndarray) -> Iterator[ReplayWindow]:
    """End a window at observation `i` of the piece, and begin the next one from the logged state."""
    step = piece.first_step + i
    if player.window is None:
        player.load(piece.puzzle)
    player.check_state(state)
    if window := player.finish():
        yield window
    try:
        player.begin(ReplayWindow(piece.stream, piece.index, step), state, _recorded(piece, i), piece.object_names)
    except ArtefactError as error:
        raise ArtefactError(
            f"{log.path}: keyframe before step {step}: {error}; replay it with the version in its provenance"
        ) from None


def _recorded(piece: Segment, i: int) -> RecordedObservation:
    """Observation `i` of the piece."""
    depth, segmentation = (None if images is None else images[i] for images in (piece.depth, piece.segmentation))
    return RecordedObservation(piece.object_state[i], piece.images[i], depth, segmentation)


def _against(logged: tuple[Contact, ...]) -> Callable[[tuple[Contact, ...]], float | None]:
    return lambda found: None if found == logged else contact_error(found, logged)


def contact_error(one: Sequence[Contact], other: Sequence[Contact]) -> float:
    """How far the contacts of two steps differ (N s, m).

    A contact in both counts with its greatest difference of impulse, position or normal. A contact in only one counts
    with its impulse.
    """
    first, second = ({(contact.a, contact.b): contact for contact in contacts} for contacts in (one, other))
    errors = [contact.impulse for pair, contact in (first | second).items() if (pair in first) != (pair in second)]
    for pair in first.keys() & second.keys():
        a, b = (np.array([c.impulse, *c.position, *c.normal]) for c in (first[pair], second[pair]))
        errors.append(float(np.abs(a - b).max()))
    return max(errors, default=0.0)
