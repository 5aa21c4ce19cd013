"""Checkpoints of exploration: with them and the logs' whole chunks, a killed run goes on as if it had not been."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import torch
from torch import Tensor

from gym_open.collect.stream import Place
from gym_open.collect.summary import Record
from gym_open.collect.tally import Tally
from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)

if TYPE_CHECKING:
    from gym_open.collect.explore import Exploration

NAME = "state.safetensors"
_META = "meta"


class _Meta(msgspec.Struct):
    record: Record
    places: list[Place]
    tallies: list[Tally]
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


def save(path: Path, run: "Exploration") -> None:
    """Write all that the run's future depends on; the logs reach the disk first."""
    for stream in run.streams:
        stream.log.sync()
    meta = _Meta(
        record=run.record,
        places=[stream.place for stream in run.streams],
        tallies=run.pool.tallies,
        messages=[stream.log.messages for stream in run.streams],
    )
    live = {str(stream.index): torch.from_numpy(stream.save_state()) for stream in run.streams}
    optimizer = run.explorer.optimizer
    tensors = {
        **prefixed("explorer", run.explorer.tensors()),
        **prefixed("optimizer", optimizer_tensors(optimizer) if optimizer else {}),
        **prefixed("pool", run.pool.tensors()),
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


def restore(saved: Saved, run: "Exploration") -> None:
    """Put a run that has not begun where the saved one was."""
    run.record = saved.meta.record
    run.explorer.load_tensors(without_prefix("explorer", saved.tensors))
    if run.explorer.optimizer:
        load_optimizer(run.explorer.optimizer, without_prefix("optimizer", saved.tensors))
    run.pool.load_tensors(without_prefix("pool", saved.tensors))
    run.pool.tallies = saved.meta.tallies
    live = without_prefix("live", saved.tensors)
    for stream, place in zip(run.streams, saved.meta.places, strict=True):
        stream.place = place
        stream.load(live[str(stream.index)].numpy())
