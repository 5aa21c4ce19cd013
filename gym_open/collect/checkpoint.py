"""Checkpoints of exploration: with them and the logs' whole chunks, a killed run goes on as if it had not been."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import torch
from torch import Tensor

from gym_open.agents.explorer import Explorer
from gym_open.collect.pool import Pool
from gym_open.collect.stream import ExplorationStream, StreamPosition
from gym_open.collect.summary import RunRecord, WorldCounts
from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)

NAME = "state.safetensors"
_META = "meta"


class _Meta(msgspec.Struct):
    record: RunRecord
    places: list[StreamPosition]
    tallies: list[WorldCounts]
    messages: list[int]
    """Messages in each stream's log when the checkpoint was taken."""


class Saved(NamedTuple):
    """A checkpoint as it was read."""

    tensors: dict[str, Tensor]
    meta: _Meta

    @property
    def messages(self) -> list[int]:
        """How many messages of each stream's log belong to it."""
        return self.meta.messages


def save(path: Path, record: RunRecord, explorer: Explorer, pool: Pool, streams: Sequence[ExplorationStream]) -> None:
    """Write everything that the run's future depends on. The logs reach the disk first."""
    for stream in streams:
        stream.log.sync()
    meta = _Meta(
        record=record,
        places=[stream.place for stream in streams],
        tallies=pool.tallies,
        messages=[stream.log.messages for stream in streams],
    )
    live = {str(stream.index): torch.from_numpy(stream.save_state()) for stream in streams}
    optimizer = explorer.optimizer
    tensors = {
        **prefixed("explorer", explorer.tensors()),
        **prefixed("optimizer", optimizer_tensors(optimizer) if optimizer else {}),
        **prefixed("pool", pool.tensors()),
        **prefixed("live", live),
    }
    # A tensor, since the header that JSON would go into holds 100 MB at most, and the curve grows with every rollout.
    tensors[_META] = torch.frombuffer(bytearray(msgspec.msgpack.encode(meta)), dtype=torch.uint8)
    save_checkpoint(path, tensors, {})


def load(path: Path) -> Saved | None:
    """The checkpoint at `path`; None if none was taken yet.

    Raises:
        ArtefactError: if it is damaged.
    """
    if not path.is_file():
        return None
    tensors, _ = load_checkpoint(path)
    try:
        return Saved(tensors, msgspec.msgpack.decode(tensors[_META].numpy().tobytes(), type=_Meta))
    except (KeyError, msgspec.DecodeError) as error:
        raise ArtefactError(f"{path}: no checkpoint of a run ({error}); remove its folder to start over") from None


def restore(saved: Saved, explorer: Explorer, pool: Pool, streams: Sequence[ExplorationStream]) -> RunRecord:
    """Put the parts of a run that has not begun into the saved state, and return its record."""
    explorer.load_tensors(without_prefix("explorer", saved.tensors))
    if explorer.optimizer:
        load_optimizer(explorer.optimizer, without_prefix("optimizer", saved.tensors))
    pool.load_tensors(without_prefix("pool", saved.tensors))
    pool.tallies = saved.meta.tallies
    live = without_prefix("live", saved.tensors)
    for stream, place in zip(streams, saved.meta.places, strict=True):
        stream.place = place
        stream.load(live[str(stream.index)].numpy())
    return saved.meta.record
