"""Simulate the streams of a packed log again, and write its `.mcap` files.

Streams of a log share their worlds. So all streams are simulated side by side: between two switches each on its own,
and the switches in the order of the exploration run, by step and then by stream.
"""

import struct
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import progress
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, GymOpenError
from gym_open.formats.compact.files import NumberReader
from gym_open.formats.compact.logs import ACTIONS, LOSSES, METRICS, EventRow, HeadRow, PackedLog, column_path
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.schemas import LogHead, SegmentStart, StepMetrics, StepRecord, Switch

_NEVER = 2**62
"""Size at which a file never ends by itself."""


def restore_files(packed: PackedLog, folder: Path) -> None:
    """Write the `.mcap` files of all streams.

    Raises:
        ArtefactError: if the rows cannot be simulated.
    """
    total = packed.info.steps
    with ExitStack() as opened, progress.bar("restoring", total) as bar:
        names = (*METRICS, *(f"part.{i}" for i in range(len(packed.heads[0].reward_parts))))
        actions = opened.enter_context(NumberReader(packed.root / ACTIONS, np.uint8, total)).take(total)
        readers = [opened.enter_context(NumberReader(packed.root / column_path(n), np.float64, total)) for n in names]
        columns = np.array([reader.take(total) for reader in readers])
        losses = opened.enter_context(NumberReader(packed.root / LOSSES, np.float64, packed.info.losses))
        values = losses.take(packed.info.losses)
        left: dict[int, np.ndarray] = {}
        streams: list[_Stream] = []
        first = at = 0
        for head in packed.heads:
            own = [event for event in packed.events if event.stream == head.stream]
            switches = sum(event.switch is not None for event in own)
            cut = slice(first, first + head.steps)
            of_worlds = values[at : at + switches * len(head.puzzles)].reshape(switches, len(head.puzzles))
            streams.append(_Stream(folder, head, own, actions[cut], columns[:, cut], of_worlds, left))
            first, at = cut.stop, at + of_worlds.size
        try:
            while any(not stream.done for stream in streams):
                stream = min((one for one in streams if not one.done), key=lambda one: (one.step, one.head.stream))
                before = stream.step
                stream.advance()
                bar.advance(stream.step - before)
        except (GymOpenError, LookupError, ValueError, OverflowError, struct.error) as error:
            raise ArtefactError(f"{packed.root}: cannot be simulated: {error}; get the packed log again") from error
        finally:
            for stream in streams:
                stream.close()


class _Stream:
    """Simulates one stream and writes its files."""

    def __init__(  # noqa: PLR0917
        self, folder: Path, head: HeadRow, events: list[EventRow], actions: np.ndarray, columns: np.ndarray,
        losses: np.ndarray, left: dict[int, np.ndarray],
    ) -> None:  # fmt: skip
        self.head, self._events, self._actions, self._columns = head, events, actions, columns
        self._losses, self._left = losses, left
        puzzles = tuple(Puzzle.from_json(text) for text in head.puzzles)
        self._puzzles = puzzles
        config = msgspec.json.decode(head.config, type=dict[str, Any])
        self._parts = LogParts(
            folder,
            LogHead(
                head.stream, config, puzzles, head.provenance, head.model_xml, head.reward_parts, head.keyframe_every
            ),
            _NEVER,
        )
        self._world = World()
        self._chunks, self._starts = set(head.chunks), set(head.parts[1:])
        self.step = self._event = self._switches = 0
        self._segment, self._segment_step, self._place, self._continued = -1, 0, -1, False

    @property
    def done(self) -> bool:
        """Whether nothing is left to do."""
        return self._event == len(self._events) and self.step == len(self._actions)

    def advance(self) -> None:
        """Do everything up to the next switch, that switch, and the keyframe of the world that it enters."""
        while not self.done:
            event = self._events[self._event] if self._event < len(self._events) else None
            if event is None or event.step != self.step:
                self._act()
                continue
            self._event += 1
            if event.switch is not None:
                self._switch(event.switch)
                if event.switch.to_world < 0:
                    return
            elif event.stuck is not None:
                self._put(event.stuck)
            elif event.keyframe:
                self._put(self._keyframe())
                if self._segment_step == 0:
                    return

    def _switch(self, switch: Switch) -> None:
        self._put(msgspec.structs.replace(switch, world_losses=self._losses[self._switches].tolist()))
        self._switches += 1
        if self._place >= 0:
            self._left[self._place] = self._world.save_state()
        self._place = switch.to_world
        if self._place >= 0:
            state = self._left.pop(self._place, None)
            self._world.load(self._puzzles[self._place])
            if state is not None:
                self._world.restore_state(state)
            self._segment, self._segment_step, self._continued = self._segment + 1, 0, state is not None

    def _keyframe(self) -> SegmentStart:
        world = self._world
        return SegmentStart(
            index=self._segment, first_step=self.step - self._segment_step, segment_step=self._segment_step,
            world=self._place, puzzle=self._puzzles[self._place], continued=self._continued,
            object_names=world.inventory, object_state=world.object_state(), integration_state=world.save_state(),
            image=world.observe(), depth=self._depth(), segmentation=self._segmentation(),
        )  # fmt: skip

    def _depth(self) -> np.ndarray | None:
        return self._world.depth() if self.head.depth else None

    def _segmentation(self) -> np.ndarray | None:
        return self._world.segmentation() if self.head.segmentation else None

    def _act(self) -> None:
        action, values = int(self._actions[self.step]), self._columns[:, self.step].tolist()
        contacts = self._world.step(action).contacts
        image = self._world.observe()
        record = StepRecord(
            step=self.step, segment=self._segment, segment_step=self._segment_step, action=action,
            object_state=self._world.object_state(), contacts=contacts, image=image,
            metrics=StepMetrics(values[0], values[1], values[2], values[3], tuple(values[4:])),
            depth=self._depth(), segmentation=self._segmentation(),
        )  # fmt: skip
        self.step += 1
        self._segment_step += 1
        self._put(record)

    def _put(self, record: Any) -> None:
        self._parts.add(record, ends=self._chunks, starts=self._starts)

    def close(self) -> None:
        """Complete the last file if the stream is done; leave it otherwise."""
        if self.done:
            self._parts.finish()
        else:
            self._parts.abandon()
