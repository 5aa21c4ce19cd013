"""A synthetic log: its records, for tests that write or read logs and compare."""

from pathlib import Path

import numpy as np
import pytest

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Placement, Puzzle, arranged
from gym_open.formats.logs.schemas import Ended, LogHead, Record, SegmentStart, StepMetrics, StepRecord, Stuck, Switch
from gym_open.formats.logs.writer import LogWriter

NAMES = ("agent", "yellow_0", "heavy_0")
POOL = tuple(
    Puzzle(task="sandbox", objects=arranged([Placement("agent", 3, column), Placement("yellow", 9, 4)]))
    for column in (1, 2, 6)
)
PLAN: list[tuple[int, int, bool, Ended]] = [
    (1, 4, False, "learned"),
    (0, 3, False, "learned"),
    (1, 2, True, "budget"),
]
"""World, steps, continued, reason of the end: three segments of one stream."""


class MadeUp:
    """A stream of 9 steps in 3 segments, with a keyframe every 2 steps."""

    names, pool, plan = NAMES, POOL, PLAN
    head = LogHead(
        stream=2,
        config={"seed": 7, "steps": 9},
        puzzles=POOL,
        provenance={"code": "0.1.0+abc", "seed": "7"},
        model_xml="<mujoco/>",
        reward_parts=("forward", "inverse"),
        keyframe_every=2,
    )

    def records(self, seed: int = 0, *, all_images: bool = False, steps: int = 1) -> list[Record]:
        """Records in order; with depth and segmentation if `all_images`; every segment is `steps` times as long."""
        rng = np.random.default_rng(seed)
        made: list[Record] = [Switch(0, -1, PLAN[0][0], "start", [np.inf] * 3)]
        step = 0
        for index, (world, length, continued, reason) in enumerate(PLAN):
            seen, state = _seen(rng, all_images), rng.normal(size=(len(NAMES), 13))
            for i in range(length * steps):
                if i % 2 == 0:
                    start = SegmentStart(index, step - i, world, POOL[world], continued, NAMES, state,
                                         rng.normal(size=31), segment_step=i, **seen)  # fmt: skip
                    made.append(start)
                contacts = tuple(
                    Contact("agent", f"yellow_{'k' * k}", (0.5, -1.25, 0.05), (0.0, 1.0, 0.0), k + 0.1)
                    for k in range(i % 4)
                )
                state, seen = rng.normal(size=(len(NAMES), 13)), _seen(rng, all_images)
                reward, loss, entropy, value, *parts = rng.normal(size=6).tolist()
                metrics = StepMetrics(reward, loss, entropy, value, tuple(parts))
                action = int(rng.integers(9))
                made.append(StepRecord(step, index, i, action, state, contacts, metrics=metrics, **seen))
                step += 1
                if i == 1:
                    made.append(Stuck(step, index, "corner", "heavy_0", index == 0, (1.9, -1.9, 0.05)))
            following = PLAN[index + 1][0] if index + 1 < len(PLAN) else -1
            made.append(Switch(step, world, following, reason, [0.25, 1.5, np.inf]))
        return made

    def write(self, folder: Path, records: list[Record] | None = None, *, roll_bytes: int = 2**28) -> list[Path]:
        """Write the records to a new log and return its files. A chunk ends at every switch."""
        with LogWriter(folder, self.head, roll_bytes=roll_bytes) as writer:
            for record in self.records() if records is None else records:
                self.put(writer, record)
        return sorted(folder.glob("stream-*.mcap"))

    def put(self, writer: LogWriter, record: Record) -> None:
        """Write one record."""
        if isinstance(record, SegmentStart):
            writer.segment(record)
        elif isinstance(record, StepRecord):
            writer.step(record)
        elif isinstance(record, Stuck):
            writer.stuck(record)
        else:
            writer.switch(record)
            writer.flush()


def _seen(rng: np.random.Generator, all_images: bool) -> dict[str, np.ndarray]:
    image = np.full((84, 84, 3), 90, np.uint8)
    image[20:30, 40:50] = rng.integers(0, 256, (10, 10, 3))
    if not all_images:
        return {"image": image}
    depth = np.full((84, 84), np.inf, np.float32)
    depth[20:30, 40:50] = rng.uniform(1, 5, (10, 10))
    return {"image": image, "depth": depth, "segmentation": np.where(np.isinf(depth), -1, 7).astype(np.int32)}


@pytest.fixture(scope="session")
def made_up() -> MadeUp:
    """Gives `records`, and `write` to a folder."""
    return MadeUp()
