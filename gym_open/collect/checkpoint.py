"""Checkpoints of exploration: a killed run resumes from one and from the logs, and ends with the same bytes."""

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
    load_optimizer,
    load_resumable,
    optimizer_tensors,
    prefixed,
    save_resumable,
    without_prefix,
)

NAME = "state.safetensors"
_META = "meta"


class _Meta(msgspec.Struct):
    record: RunRecord
    positions: list[StreamPosition]
    counts: list[WorldCounts]
    messages: list[int]
    """Messages in each stream's log when the checkpoint was taken."""


class Saved(NamedTuple):
    """A checkpoint that was read."""

    tensors: dict[str, Tensor]
    meta: _Meta

    @property
    def messages(self) -> list[int]:
        """Number of messages in each stream's log that belong to the checkpoint."""
        return self.meta.messages


def save(path: Path, record: RunRecord, explorer: Explorer, pool: Pool, streams: Sequence[ExplorationStream]) -> None:
    """Write everything that the run's future depends on. The logs reach the disk first."""
    for stream in streams:
        stream.log.sync()
    meta = _Meta(
        record=record,
        positions=[stream.position for stream in streams],
        counts=pool.counts,
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
    # A tensor: the header, which would hold JSON, is limited to 100 MB, and the curve grows with every rollout.
    tensors[_META] = torch.frombuffer(bytearray(msgspec.msgpack.encode(meta)), dtype=torch.uint8)
    save_resumable(path, tensors, {})


def load(path: Path) -> Saved | None:
    """Read the newest whole checkpoint at `path`. None if there is none.

    Raises:
        ArtefactError: if another version wrote it.
    """
    found = load_resumable(path)
    if found is None:
        return None
    tensors, _ = found
    try:
        return Saved(tensors, msgspec.msgpack.decode(tensors[_META].numpy().tobytes(), type=_Meta))
    except (KeyError, msgspec.DecodeError) as error:
        raise ArtefactError(f"{path}: not a checkpoint of a run ({error}); remove its folder to start over") from None


def restore(saved: Saved, explorer: Explorer, pool: Pool, streams: Sequence[ExplorationStream]) -> RunRecord:
    """Put the parts of a run that has not begun into the saved state, and return its record."""
    explorer.load_tensors(without_prefix("explorer", saved.tensors))
    if explorer.optimizer:
        load_optimizer(explorer.optimizer, without_prefix("optimizer", saved.tensors))
    pool.load_tensors(without_prefix("pool", saved.tensors))
    pool.counts = saved.meta.counts
    live = without_prefix("live", saved.tensors)
    for stream, position in zip(streams, saved.meta.positions, strict=True):
        stream.position = position
        stream.load(live[str(stream.index)].numpy())
    return saved.meta.record
