"""A stream: one world at a time, played in and logged."""

import msgspec
import numpy as np

from gym_open.collect.config import LogConfig
from gym_open.collect.pool import Pool
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.stuck import Watch, position
from gym_open.envs.world import World
from gym_open.formats.logs import LogWriter, SegmentStart, StepMetrics, StepRecord, Switch
from gym_open.formats.logs.schemas import Stuck


class StreamPosition(msgspec.Struct):
    """Where a stream is in its log and in the pool; plain data, for a checkpoint."""

    world: int = -1
    """Index in the pool; −1 before the start and after the end."""
    segment: int = -1
    segment_step: int = 0
    """Steps taken in this segment."""
    step: int = 0
    """Steps taken in all."""
    continued: bool = False
    """Whether the world had been left before."""
    decided: int = 0
    """Step of the segment at which the curriculum last let the stream stay."""
    loss_at_entry: float = float("inf")
    """Loss of the world as it decided when the stream went there."""
    recent: list[float] = msgspec.field(default_factory=list)
    """Losses measured since then, for the smoothed one."""
    watch: Watch | None = None
    """None while the stream is in no world."""


class PlayedStep(msgspec.Struct, frozen=True, eq=False):
    """What a stream logs of one step."""

    keyframe: SegmentStart | None
    """The keyframe before the step, if one is due."""
    step: StepRecord
    """Without the explorer's metrics, which are known after the rollout."""
    stuck: list[Stuck]
    """What the step made stuck or free again."""


class ExplorationStream:
    """Plays in one world of the pool at a time and logs it. `play` moves on, `record` writes what was played."""

    def __init__(self, index: int, pool: Pool, log: LogWriter, config: LogConfig) -> None:
        self.index = index
        self.place = StreamPosition()
        self.log = log
        self._pool = pool
        self._config = config
        self._world = World()

    def play(self, action: int, image: np.ndarray) -> PlayedStep:
        """Take one action and draw what comes of it into `image`."""
        place = self.place
        due = place.segment_step > 0 and place.segment_step % self._config.keyframe_every == 0
        keyframe = self._moment() if due else None
        outcome = self._world.step(action)
        self._world.observe(image)
        states = self._world.object_state()
        place.step += 1
        place.segment_step += 1
        stuck = self._count(states, outcome.contacts, pushed=action != 0)
        step = StepRecord(
            step=place.step - 1, segment=place.segment, segment_step=place.segment_step - 1, action=action,
            object_state=states, contacts=outcome.contacts, image=image, depth=self._depth(),
            segmentation=self._segmentation(),
        )  # fmt: skip
        return PlayedStep(keyframe, step, stuck)

    def _count(self, states: np.ndarray, contacts: tuple[Contact, ...], *, pushed: bool) -> list[Stuck]:
        watch, tally = self.place.watch, self._pool.tallies[self.place.world]
        assert watch is not None
        stuck = watch.push(states, self.place.step) if pushed else []
        tally.step(position(states), contacts)
        tally.stuck_step(stuck, agent=watch.agent, corner=bool(watch.wedged))
        return stuck

    def _depth(self) -> np.ndarray | None:
        return self._world.depth() if self._config.depth else None

    def _segmentation(self) -> np.ndarray | None:
        return self._world.segmentation() if self._config.segmentation else None

    def _moment(self) -> SegmentStart:
        """The world as it stands, from which its segment can be replayed."""
        place = self.place
        return SegmentStart(
            index=place.segment, first_step=place.step - place.segment_step, segment_step=place.segment_step,
            world=place.world, puzzle=self._pool.puzzles[place.world], continued=place.continued,
            object_names=INVENTORY, object_state=self._world.object_state(),
            integration_state=self._world.save_state(), image=self._world.observe(),
            depth=self._depth(), segmentation=self._segmentation(),
        )  # fmt: skip

    def look(self, image: np.ndarray) -> None:
        """Draw the world as it stands into `image`."""
        self._world.observe(image)

    def record(self, played: PlayedStep, metrics: StepMetrics) -> None:
        """Log one step with what the explorer computed for it."""
        if played.keyframe is not None:
            self.log.segment(played.keyframe)
        self.log.step(msgspec.structs.replace(played.step, metrics=metrics))
        for turn in played.stuck:
            self.log.stuck(turn)

    def switch(self, switch: Switch) -> None:
        """Leave the world as it is and go on in another one (or none), as that was left; log it."""
        place = self.place
        if place.watch is not None:
            for turn in place.watch.leave(self._world.object_state(), place.step):
                self.log.stuck(turn)
        self.log.switch(switch)
        if place.world >= 0:
            self._pool.left[place.world] = self._world.save_state()
        self.place = StreamPosition(world=switch.to_world, segment=place.segment, step=place.step)
        if switch.to_world >= 0:
            self.place.segment += 1
            self.place.loss_at_entry = switch.world_losses[switch.to_world]
            self._enter()

    def _enter(self) -> None:
        place = self.place
        left = self._pool.left.pop(place.world, None)
        place.continued = left is not None
        self.load(left)
        place.watch = Watch(place.segment, position(self._world.object_state()))
        self._pool.tallies[place.world].visits += 1
        self.log.segment(self._moment())

    def load(self, state: np.ndarray | None) -> None:
        """Set the simulation to the place's world, in `state` or as its puzzle has it."""
        self._world.load(self._pool.puzzles[self.place.world])
        if state is not None:
            self._world.restore_state(state)

    def save_state(self) -> np.ndarray:
        """Integration state of the world being played in."""
        return self._world.save_state()
