"""A stream: one world at a time, played in and logged."""

import msgspec
import numpy as np

from gym_open.collect.pool import Pool
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.world import World
from gym_open.formats.logs import LogWriter, SegmentStart, StepRecord, Switch


class Place(msgspec.Struct):
    """Where a stream is in its log and in the pool."""

    world: int = -1
    """Index in the pool; −1 before the start and after the end."""
    segment: int = -1
    segment_step: int = 0
    """Steps taken in this segment."""
    step: int = 0
    """Steps taken in all."""
    loss_at_entry: float = float("inf")
    """Loss of the world as it decided when the stream went there."""
    recent: list[float] = msgspec.field(default_factory=list)
    """Losses measured since then, for the smoothed one."""


class Played(msgspec.Struct, frozen=True, eq=False):
    """What a stream saw of one step that is not in the images."""

    action: int
    object_state: np.ndarray
    contacts: tuple[Contact, ...]


class Figures(msgspec.Struct, frozen=True):
    """What the explorer thought of one step."""

    intrinsic_reward: float
    world_model_loss: float
    policy_entropy: float
    value: float


class Stream:
    """Plays in one world of the pool at a time and logs it."""

    def __init__(self, index: int, pool: Pool, log: LogWriter) -> None:
        self.index = index
        self.place = Place()
        self.log = log
        self._pool = pool
        self._world = World()

    def play(self, action: int, image: np.ndarray) -> Played:
        """Take one action and draw what comes of it into `image`."""
        outcome = self._world.step(action)
        self._world.observe(image)
        return Played(action, self._world.object_state(), outcome.contacts)

    def look(self, image: np.ndarray) -> None:
        """Draw the world as it stands into `image`."""
        self._world.observe(image)

    def record(self, played: Played, figures: Figures, image: np.ndarray) -> None:
        """Log one step and the image after it, (84, 84, 3)."""
        place = self.place
        self.log.step(
            StepRecord(
                step=place.step, segment=place.segment, segment_step=place.segment_step, action=played.action,
                object_state=played.object_state, contacts=played.contacts, image=image,
                **msgspec.structs.asdict(figures),
            )
        )  # fmt: skip
        place.step += 1
        place.segment_step += 1
        self._pool.visits[place.world].steps += 1

    def switch(self, switch: Switch) -> None:
        """Leave the world as it is and go on in another one (or none), as that was left; log it."""
        place = self.place
        self.log.switch(switch)
        if place.world >= 0:
            self._pool.left[place.world] = self._world.save_state()
        self.place = Place(world=switch.to_world, segment=place.segment, step=place.step)
        if switch.to_world >= 0:
            self.place.segment += 1
            self.place.loss_at_entry = switch.world_losses[switch.to_world]
            self._enter()

    def _enter(self) -> None:
        pool, place = self._pool, self.place
        left = pool.left.pop(place.world, None)
        self.load(left)
        pool.visits[place.world].visits += 1
        self.log.segment(
            SegmentStart(
                index=place.segment, first_step=place.step, world=place.world, puzzle=pool.puzzles[place.world],
                continued=left is not None, object_names=INVENTORY, object_state=self._world.object_state(),
                integration_state=self._world.save_state(), image=self._world.observe(),
            )
        )  # fmt: skip

    def load(self, state: np.ndarray | None) -> None:
        """Set the simulation to the place's world, in `state` or as its puzzle has it."""
        self._world.load(self._pool.puzzles[self.place.world])
        if state is not None:
            self._world.restore_state(state)

    def save_state(self) -> np.ndarray:
        """Integration state of the world being played in."""
        return self._world.save_state()
