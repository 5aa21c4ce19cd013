"""Makes the conformance pair: `small.mcap`, a log with a message of every kind, and `small.json`, its contents.

    python tests/formats/logs/conformance/make.py

The log is made up, so that it changes with the format alone and not with physics. The JSON is read from it by other
libraries than ours: mcap and mcap-ros2-support. In it bytes are their SHA-256, and what JSON has no number for is
"NaN", "Infinity" or "-Infinity".
"""

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Placement, Puzzle, arranged
from gym_open.formats.logs.schemas import LogHead, SegmentStart, StepMetrics, StepRecord, Stuck, Switch
from gym_open.formats.logs.writer import LogWriter

NAMES = ("agent", "yellow_0", "heavy_0")
POOL = tuple(
    Puzzle(task="sandbox", objects=arranged([Placement("agent", 3, column), Placement("yellow", 9, 4)]))
    for column in (1, 2)
)
HEAD = LogHead(
    stream=0,
    config={"seed": 7, "steps": 5},
    puzzles=POOL,
    provenance={"code": "0", "seed": "7"},
    model_xml='<mujoco model="none"/>',
    reward_parts=("forward", "inverse"),
    keyframe_every=2,
)


def _state(step: int) -> np.ndarray:
    return step + np.arange(39.0).reshape(3, 13) / 64


def _seen(step: int) -> dict[str, np.ndarray]:
    depth = np.full((84, 84), np.inf, np.float32)
    depth[20:] = 2 + step / 16
    segmentation = np.where(np.isinf(depth), -1, step).astype(np.int32)
    image = np.full((84, 84, 3), 90, np.uint8)
    image[20:, :, 1] = 40 * step
    return {"image": image, "depth": depth, "segmentation": segmentation}


def _start(index: int, first_step: int, segment_step: int, *, continued: bool) -> SegmentStart:
    step = first_step + segment_step
    return SegmentStart(
        index=index, first_step=first_step, world=index, puzzle=POOL[index], continued=continued, object_names=NAMES,
        object_state=_state(step), integration_state=np.linspace(0, step, 7), segment_step=segment_step, **_seen(step),
    )  # fmt: skip


def _step(step: int, segment: int, segment_step: int) -> StepRecord:
    contact = Contact("agent", "heavy_0", (0.5, -1.25, 0.05), (0.0, 1.0, 0.0), 0.125)
    wall = Contact("heavy_0", "wall_east", (2.0, 0.1, 0.05), (1.0, 0.0, 0.0), 2.5)
    return StepRecord(
        step=step, segment=segment, segment_step=segment_step, action=(step + 3) % 9, object_state=_state(step + 1),
        contacts=(contact, wall)[: step % 3],
        metrics=StepMetrics(step / 10, math.nan if step < 1 else 1e-3, math.log(9), -step / 3, (step / 7, -0.5)),
        **_seen(step + 1),
    )  # fmt: skip


def write(folder: Path) -> Path:
    """Write the log: a segment of 3 steps with a keyframe in it, then one of 2 steps that ends with the budget."""
    with LogWriter(folder, HEAD) as log:
        log.switch(Switch(0, -1, 0, "start", [math.inf, math.inf]))
        log.segment(_start(0, 0, 0, continued=False))
        log.step(_step(0, 0, 0))
        log.step(_step(1, 0, 1))
        log.stuck(Stuck(2, 0, "corner", "heavy_0", True, (1.9, -1.9, 0.05)))
        log.segment(_start(0, 0, 2, continued=False))
        log.step(_step(2, 0, 2))
        log.switch(Switch(3, 0, 1, "learned", [5e-4, math.inf]))
        log.segment(_start(1, 3, 0, continued=True))
        log.step(_step(3, 1, 0))
        log.step(_step(4, 1, 1))
        log.switch(Switch(5, 1, -1, "budget", [math.nan, 0.25]))
    (path,) = folder.glob("stream-*.mcap")
    return path


def plain(value: Any) -> Any:
    """A value of a ROS 2 message in JSON form."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, bytes):
        return {"bytes": len(value), "sha256": hashlib.sha256(value).hexdigest()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    names = getattr(value, "__slots__", None)
    return value if names is None else {name: plain(getattr(value, name)) for name in names}


def describe(path: Path) -> dict[str, Any]:
    """Contents of a log, read by the mcap package and its ROS 2 decoder."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        messages = [
            {"topic": channel.topic, "type": schema.name, "time": message.log_time, "fields": plain(fields)}
            for schema, channel, message, fields in reader.iter_decoded_messages(log_time_order=False)
            if schema is not None
        ]
        return {
            "attachments": {one.name: plain(one.data) for one in reader.iter_attachments()},
            "metadata": {one.name: one.metadata for one in reader.iter_metadata()},
            "messages": messages,
        }


if __name__ == "__main__":
    here = Path(__file__).parent
    write(here).rename(here / "small.mcap")
    found = describe(here / "small.mcap")
    messages = ",\n".join(json.dumps(message) for message in found.pop("messages"))
    (here / "small.json").write_text(f'{json.dumps(found, indent=1)[:-2]},\n "messages": [\n{messages}\n]\n}}\n')
