"""Files and rows of a packed log: `gym-open-packed-log/1`. See docs/compact-format.md."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from gym_open import artefacts
from gym_open.envs.stuck import Stuck
from gym_open.errors import ArtefactError
from gym_open.formats.compact.files import read_rows
from gym_open.formats.logs.schemas import Switch
from gym_open.formats.releases.info import read_json

FORMAT = "gym-open-packed-log/1"
INFO, HEADS, EVENTS, ACTIONS, LOSSES = (
    "packed-log.json", "heads.jsonl.zst", "events.jsonl.zst", "actions.zst", "world_losses.zst",
)  # fmt: skip
LOG = "log/"
"""Folder with all files of the log except its `.mcap` files, byte for byte."""
METRICS = ("intrinsic_reward", "world_model_loss", "policy_entropy", "value")

_Number = Annotated[int, Meta(ge=0, le=2**40)]


class PackedLogInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`packed-log.json`."""

    format: str
    log: str
    """Digest of the log artefact."""
    steps: _Number
    losses: _Number
    """Number of losses of worlds at all switches."""


class HeadRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A stream: what the head of its files says, and where its chunks and files end."""

    stream: _Number
    steps: _Number
    config: str
    puzzles: list[str]
    """The pool, each puzzle as JSON."""
    provenance: dict[str, str]
    model_xml: str
    reward_parts: tuple[str, ...]
    keyframe_every: Annotated[int, Meta(ge=1, le=2**31)]
    depth: bool
    segmentation: bool
    chunks: list[_Number]
    """Number of messages in the stream at the end of each chunk."""
    parts: list[_Number]
    """Number of messages before each file."""


class EventRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What happens in a stream when it has taken `step` steps: a keyframe, a switch, or a stuck object, in order."""

    stream: _Number
    step: _Number
    keyframe: bool = False
    switch: Switch | None = None
    """Without its losses, which are in a file of their own."""
    stuck: Stuck | None = None


class PackedLog:
    """A packed log on disk whose bytes were checked."""

    def __init__(self, root: Path, digest: str, info: PackedLogInfo) -> None:
        self.root, self.digest, self.info = root, digest, info
        self.heads = list(read_rows(root / HEADS, HeadRow))
        self.events = list(read_rows(root / EVENTS, EventRow))


def open_packed_log(root: Path) -> PackedLog:
    """Open the packed log at `root`.

    Raises:
        ArtefactError: if it is missing, damaged, or no packed log of this format.
    """
    digest = artefacts.verify(root, "packed-log")
    info = read_json(root / INFO, PackedLogInfo)
    if info.format != FORMAT:
        raise ArtefactError(f"{root / INFO}: format must be {FORMAT!r}, got {info.format!r}")
    if artefacts.digest(root / LOG) != info.log:
        raise ArtefactError(f"{root / INFO}: names another log than {LOG}; get the packed log again")
    opened = PackedLog(root, digest, info)
    if sum(head.steps for head in opened.heads) != info.steps:
        raise ArtefactError(f"{root / HEADS}: not the {info.steps:,} steps of {INFO}; get the packed log again")
    return opened


def column_path(name: str) -> str:
    """Name of the file with one value of the explorer per step."""
    return f"columns/{name}.zst"
