"""Checkpoints of exploration: with them and the logs' whole chunks, a killed run goes on as if it had not been."""

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import torch

from gym_open.collect.pool import Visits
from gym_open.collect.stream import Place
from gym_open.collect.summary import Record
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)
from gym_open.formats.log_container import whole_chunks

if TYPE_CHECKING:
    from gym_open.collect.explore import Exploration

NAME = "state.safetensors"


class _Meta(msgspec.Struct):
    record: Record
    places: list[Place]
    visits: list[Visits]
    messages: list[int]
    """Messages in each stream's log when the checkpoint was taken."""


def save(path: Path, run: "Exploration") -> None:
    """Write all that the run's future depends on; the logs reach the disk first."""
    for stream in run.streams:
        stream.log.sync()
    meta = _Meta(
        record=run.record,
        places=[stream.place for stream in run.streams],
        visits=run.pool.visits,
        messages=[stream.log.messages for stream in run.streams],
    )
    live = {str(stream.index): torch.from_numpy(stream.save_state()) for stream in run.streams}
    tensors = {
        **prefixed("explorer", run.explorer.tensors()),
        **prefixed("optimizer", optimizer_tensors(run.explorer.optimizer)),
        **prefixed("pool", run.pool.tensors()),
        **prefixed("live", live),
    }
    save_checkpoint(path, tensors, msgspec.to_builtins(meta))


def load(path: Path, run: "Exploration") -> list[int]:
    """Put a run that has not begun where the saved one was.

    Returns:
        How many messages of each stream's log belong to it.
    """
    tensors, raw = load_checkpoint(path)
    meta = msgspec.convert(raw, _Meta)
    run.record = meta.record
    run.explorer.load_tensors(without_prefix("explorer", tensors))
    load_optimizer(run.explorer.optimizer, without_prefix("optimizer", tensors))
    run.pool.load_tensors(without_prefix("pool", tensors))
    run.pool.visits = meta.visits
    live = without_prefix("live", tensors)
    for stream, place in zip(run.streams, meta.places, strict=True):
        stream.place = place
        stream.load(live[str(stream.index)].numpy())
    return meta.messages


def set_aside(log: Path, folder: Path) -> Path | None:
    """Move a killed writer's log into `folder`, so that a new one can be written and compared with it.

    If one is there already (the run was killed more than once), the longer of the two is kept: both begin alike.
    """
    aside = folder / log.name
    if log.is_file() and (not aside.is_file() or _messages(log) >= _messages(aside)):
        log.rename(aside)
    return aside if aside.is_file() else None


def _messages(log: Path) -> int:
    return sum(map(len, whole_chunks(log)))
