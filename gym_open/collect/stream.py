"""A stream of exploration: it steps one world at a time and logs it."""

import msgspec
import numpy as np

from gym_open.collect.config import LogConfig
from gym_open.collect.pool import Pool
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.stuck import Watch
from gym_open.envs.stuck import position as position_of_agent
from gym_open.envs.world import World
from gym_open.formats.logs import LogWriter, SegmentStart, StepMetrics, StepRecord, Switch
from gym_open.formats.logs.schemas import Stuck


class StreamPosition(msgspec.Struct):
    """Where a stream is in its log and in the pool, as plain data for a checkpoint."""

    world: int = -1
    """Index in the pool. −1 before the start and after the end."""
    segment: int = -1
    segment_step: int = 0
    """Steps taken in this segment."""
    step: int = 0
    """Steps taken in all segments."""
    continued: bool = False
    """Whether the stream returned to a world that was left before."""
    decided: int = 0
    """Step of the segment at which the curriculum last decided to stay."""
    loss_at_entry: float = float("inf")
    """Loss of the world in the decision to enter it."""
    recent: list[float] = msgspec.field(default_factory=list)
    """Losses measured since then, for the smoothed loss."""
    watch: Watch | None = None
    """None while the stream is in no world."""


class LoggedStep(msgspec.Struct, frozen=True, eq=False):
    """What a stream logs of one step."""

    keyframe: SegmentStart | None
    """The keyframe before the step, if one is due."""
    step: StepRecord
    """Without the explorer's metrics, which are known after the rollout."""
    stuck: list[Stuck]
    """What the step made stuck or free again."""


class ExplorationStream:
    """Acts in one world of the pool at a time. `step` takes an action, and `record` writes a step to the log."""

    def __init__(self, index: int, pool: Pool, log: LogWriter, config: LogConfig) -> None:
        self.index = index
        self.position = StreamPosition()
        self.log = log
        self._pool = pool
        self._config = config
        self._world = World()

    def step(self, action: int, image: np.ndarray) -> LoggedStep:
        """Take one action and draw the next observation into `image`."""
        position = self.position
        due = position.segment_step > 0 and position.segment_step % self._config.keyframe_every == 0
        keyframe = self._keyframe() if due else None
        outcome = self._world.step(action)
        self._world.observe(image)
        states = self._world.object_state()
        position.step += 1
        position.segment_step += 1
        stuck = self._count(states, outcome.contacts, pushed=action != 0)
        step = StepRecord(
            step=position.step - 1, segment=position.segment, segment_step=position.segment_step - 1, action=action,
            object_state=states, contacts=outcome.contacts, image=image, depth=self._depth(),
            segmentation=self._segmentation(),
        )  # fmt: skip
        return LoggedStep(keyframe, step, stuck)

    def _count(self, states: np.ndarray, contacts: tuple[Contact, ...], *, pushed: bool) -> list[Stuck]:
        watch, count = self.position.watch, self._pool.counts[self.position.world]
        assert watch is not None
        stuck = watch.push(states, self.position.step) if pushed else []
        count.step(position_of_agent(states), contacts)
        count.stuck_step(stuck, agent=watch.agent, corner=bool(watch.wedged))
        return stuck

    def _depth(self) -> np.ndarray | None:
        return self._world.depth() if self._config.depth else None

    def _segmentation(self) -> np.ndarray | None:
        return self._world.segmentation() if self._config.segmentation else None

    def _keyframe(self) -> SegmentStart:
        """The full state of the world, from which its segment can be replayed."""
        position = self.position
        return SegmentStart(
            index=position.segment, first_step=position.step - position.segment_step,
            segment_step=position.segment_step, world=position.world, puzzle=self._pool.puzzles[position.world],
            continued=position.continued, object_names=INVENTORY, object_state=self._world.object_state(),
            integration_state=self._world.save_state(), image=self._world.observe(),
            depth=self._depth(), segmentation=self._segmentation(),
        )  # fmt: skip

    def look(self, image: np.ndarray) -> None:
        """Draw the current observation into `image`."""
        self._world.observe(image)

    def record(self, step: LoggedStep, metrics: StepMetrics) -> None:
        """Log one step together with the explorer's metrics."""
        if step.keyframe is not None:
            self.log.segment(step.keyframe)
        self.log.step(msgspec.structs.replace(step.step, metrics=metrics))
        for turn in step.stuck:
            self.log.stuck(turn)

    def switch(self, switch: Switch) -> None:
        """Leave the world in its present state, continue in another world (or none), and log the switch."""
        position = self.position
        if position.watch is not None:
            for turn in position.watch.leave(self._world.object_state(), position.step):
                self.log.stuck(turn)
        self.log.switch(switch)
        if position.world >= 0:
            self._pool.left[position.world] = self._world.save_state()
        self.position = StreamPosition(world=switch.to_world, segment=position.segment, step=position.step)
        if switch.to_world >= 0:
            self.position.segment += 1
            self.position.loss_at_entry = switch.world_losses[switch.to_world]
            self._enter()

    def _enter(self) -> None:
        position = self.position
        left = self._pool.left.pop(position.world, None)
        position.continued = left is not None
        self.load(left)
        position.watch = Watch(position.segment, position_of_agent(self._world.object_state()))
        self._pool.counts[position.world].visits += 1
        self.log.segment(self._keyframe())

    def load(self, state: np.ndarray | None) -> None:
        """Load the current world, in `state` or as its puzzle defines it."""
        self._world.load(self._pool.puzzles[self.position.world])
        if state is not None:
            self._world.restore_state(state)

    def save_state(self) -> np.ndarray:
        """Integration state of the current world."""
        return self._world.save_state()
