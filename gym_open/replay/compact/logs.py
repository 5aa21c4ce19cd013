"""Pack a log as its actions, and restore its files in every byte."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.artefacts import canonical_json
from gym_open.config import Config
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import sha256_file
from gym_open.formats.compact.files import NumberWriter, write_rows
from gym_open.formats.compact.logs import (
    ACTIONS,
    EVENTS,
    FORMAT,
    HEADS,
    INFO,
    LOG,
    LOSSES,
    METRICS,
    EventRow,
    HeadRow,
    PackedLog,
    PackedLogInfo,
    column_path,
    open_packed_log,
)
from gym_open.formats.logs.logfile import LogFile, open_file
from gym_open.formats.logs.reader import log_files
from gym_open.formats.logs.schemas import DEPTH, SEGMENTATION, SegmentStart, StepMetrics, StepRecord, Switch
from gym_open.formats.logs.segments import decode_record, groups
from gym_open.replay.compact.log_streams import restore_files


class PackedLogConfig(Config, frozen=True):
    """Configuration of a packed log: the log determines all of it."""

    format: str = FORMAT


def pack_log(log: Path, out: Path, *, replace: bool = False) -> artefacts.Outcome:
    """Pack the log artefact `log` as `out`, and restore it once to check every byte.

    Raises:
        ArtefactError: if the log is damaged, or its bytes do not follow from its actions.
        UsageError: if `out` was made from other inputs and `replace` is false.
    """

    def work(folder: Path) -> Mapping[str, Any]:
        for path in [*folder.iterdir()]:
            if path.name != artefacts.SCRATCH:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        for name in [*artefacts.manifest(log), artefacts.MANIFEST]:
            if not name.endswith(".mcap"):
                target = folder / LOG / name
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(log / name, target)
        steps, losses = _write_streams(log, folder)
        info = PackedLogInfo(FORMAT, artefacts.digest(log), steps, losses)
        (folder / INFO).write_bytes(canonical_json(info))
        trial = folder / artefacts.SCRATCH / "trial"
        shutil.rmtree(trial, ignore_errors=True)
        trial.mkdir()
        restore_files(PackedLog(folder, "", info), trial)
        _check(log, trial)
        shutil.rmtree(trial)
        return {"steps": steps, "log": info.log}

    return artefacts.build(out, kind="packed-log", config=PackedLogConfig(), parents=[log], work=work, replace=replace)


def restore_log(root: Path, out: Path) -> bool:
    """Restore the log that was packed at `root`, records included, at `out`. Return whether it was made now.

    Raises:
        ArtefactError: if the packed log is damaged or was changed, or other packages write other bytes.
        UsageError: if something else is at `out`.
    """
    packed = open_packed_log(root)
    if out.exists():
        if not (out / artefacts.MANIFEST).is_file() or artefacts.digest(out) != packed.info.log:
            raise UsageError(f"{out}: exists and is not this log; give another --out")
        artefacts.verify(out, "log")
        return False

    def work(folder: Path) -> None:
        for path in [*folder.glob("*.mcap")]:
            path.unlink()
        restore_files(packed, folder)
        shutil.copytree(root / LOG, folder, dirs_exist_ok=True)
        _check(root / LOG, folder)

    artefacts.remake(out, kind="log", parents=[root], work=work)
    return True


def _check(log: Path, made: Path) -> None:
    """Raises ArtefactError if a file is not the one that the manifest of `log` lists."""
    for name, entry in artefacts.manifest(log).items():
        if name.endswith(".mcap") and (not (made / name).is_file() or sha256_file(made / name) != entry.sha256):
            raise ArtefactError(
                f"{log / name}: its actions do not give its bytes: it was changed, or this version simulates another "
                "world, or another version of zstandard packed it; use the packages in its lineage"
            )


def _write_streams(log: Path, folder: Path) -> tuple[int, int]:
    """Write what is stored of every stream; return the numbers of steps and of losses."""
    heads, events = list[HeadRow](), list[EventRow]()
    files = [[open_file(path) for path in parts] for parts in log_files(log)]
    names = (*METRICS, *(f"part.{i}" for i in range(len(files[0][0].head.reward_parts))))
    losses = 0
    with ExitStack() as opened, progress.bar("packing", len(files)) as bar:
        actions = opened.enter_context(NumberWriter(folder / ACTIONS, np.uint8))
        columns = [opened.enter_context(NumberWriter(folder / column_path(name), np.float64)) for name in names]
        of_worlds = opened.enter_context(NumberWriter(folder / LOSSES, np.float64))
        for parts in files:
            rows, taken, own = list[EventRow](), list[StepRecord](), 0
            for record in _records(parts):
                if isinstance(record, StepRecord):
                    taken.append(msgspec.structs.replace(record, object_state=_NOTHING, image=_NOTHING, contacts=()))
                    own += 1
                elif isinstance(record, Switch):
                    of_worlds.add(np.array(record.world_losses, np.float64))
                    losses += len(record.world_losses)
                    bare = msgspec.structs.replace(record, world_losses=[])
                    rows.append(EventRow(parts[0].head.stream, own, switch=bare))
                elif isinstance(record, SegmentStart):
                    rows.append(EventRow(parts[0].head.stream, own, keyframe=True))
                else:
                    rows.append(EventRow(parts[0].head.stream, own, stuck=record))
            actions.add(np.array([step.action for step in taken], np.uint8))
            table = np.array([_metrics(step.metrics) for step in taken]).reshape(own, len(names))
            for i, column in enumerate(columns):
                column.add(table[:, i])
            heads.append(_head_row(parts, own))
            events += rows
            bar.advance(1)
    write_rows(folder / HEADS, heads)
    write_rows(folder / EVENTS, events)
    return sum(head.steps for head in heads), losses


_NOTHING = np.empty(0)


def _metrics(metrics: StepMetrics) -> tuple[float, ...]:
    return (*(getattr(metrics, name) for name in METRICS), *metrics.reward_parts)


def _records(parts: Sequence[LogFile]) -> Iterator[Any]:
    messages = (message for part in parts for message in part.messages())
    puzzles = parts[0].head.puzzles
    return (decode_record(group, puzzles) for group in groups(messages))


def _head_row(parts: Sequence[LogFile], steps: int) -> HeadRow:
    head = parts[0].head
    chunks, starts, total = list[int](), list[int](), 0
    for part in parts:
        starts.append(total)
        for place in part.contents.chunks:
            total += sum(place.counts.values())
            chunks.append(total)
    return HeadRow(
        stream=head.stream, steps=steps, config=msgspec.json.encode(head.config, order="sorted").decode(),
        puzzles=[puzzle.to_json().decode() for puzzle in head.puzzles], provenance=head.provenance,
        model_xml=head.model_xml, reward_parts=head.reward_parts, keyframe_every=head.keyframe_every,
        depth=any(part.count(DEPTH) for part in parts), segmentation=any(part.count(SEGMENTATION) for part in parts),
        chunks=chunks, parts=starts,
    )  # fmt: skip
