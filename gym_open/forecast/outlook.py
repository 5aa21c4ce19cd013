"""The first line that a run prints, and a warning if the disk is too small."""

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gym_open import artefacts, progress
from gym_open.config import Config
from gym_open.errors import ArtefactError
from gym_open.forecast.work import Work, about
from gym_open.hardware import usable_cores


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedStage:
    """A stage that may have to run."""

    name: str
    folder: Path
    """Folder of its artefact."""
    config: Config
    needs: tuple["PlannedStage", ...] = ()
    """Stages whose artefacts it reads."""
    work: Work


def to_do(stages: Sequence[PlannedStage]) -> list[PlannedStage]:
    """The stages whose artefacts are missing, or seem to be made from other inputs.

    This reads only small records. Each stage itself checks whether its artefact is whole.
    """
    left: list[PlannedStage] = []
    for stage in stages:
        if any(needed in left for needed in stage.needs) or not _seems_made(stage):
            left.append(stage)
    return left


def _seems_made(stage: PlannedStage) -> bool:
    try:
        made = artefacts.lineage(stage.folder)
        config = msgspec.json.decode(msgspec.json.encode(stage.config))  # as on disk: lists instead of tuples
        return made.code == artefacts.code_version(made.kind) and artefacts.config_of(stage.folder) == config
    except ArtefactError:
        return False


def found(stages: Sequence[PlannedStage], root: Path) -> str:
    """The hardware that stages in the workspace `root` run on, as far as it affects how long they take."""
    with progress.doing("loading PyTorch"):
        import torch

        from gym_open.precision import resolve

    ways = [how for stage in stages for how in stage.work.images if how.learn]
    device = "no GPU in use"
    if any(how.device == "cuda" for how in ways):
        device = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU found"
    precisions = " and ".join(sorted({resolve(how.precision, how.device) for how in ways}))
    cores, free = usable_cores(), size(shutil.disk_usage(root).free)
    load = os.getloadavg()[0]
    busy = f" (busy: load {load:.0f})" if load >= cores + 1 else ""
    return f"{cores} core{'s' * (cores > 1)}{busy}, {device}, {precisions}, {free} free"


def expected(left: Sequence[PlannedStage]) -> str:
    """How long these stages will take here, in words. The measurement takes about two seconds."""
    works = [stage.work for stage in left]
    with progress.doing("getting ready", progress.COMPILES):
        from gym_open.forecast import speed

        speed.get_ready(works)
    with progress.doing("measuring this machine"):
        return about(speed.seconds(works))


def too_full(root: Path, needed: int) -> str:
    """A warning if fewer than `needed` bytes are free for the workspace `root`, else an empty text."""
    free = shutil.disk_usage(root).free
    if free >= needed:
        return ""
    return f"{size(free)} free on the disk of {root}, and this run writes about {size(needed)}: make room"


def size(count: float) -> str:
    """Bytes in words: 61 GB, 0.4 GB, 23 MB."""
    if count < 1e8:
        return f"{count / 1e6:.0f} MB"
    return f"{count / 1e9:.{0 if count >= 9.95e9 else 1}f} GB"
