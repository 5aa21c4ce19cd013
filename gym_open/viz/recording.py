"""`visualize(config, source, save)`: a log, a release or a learning curve as a Rerun recording, without a screen."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rerun as rr

from gym_open import artefacts
from gym_open.errors import ArtefactError, UsageError
from gym_open.viz import blueprints
from gym_open.viz.config import VizConfig
from gym_open.viz.spans import Stream, streams_of_log, streams_of_release
from gym_open.viz.trajectory import BLUE, log_stream

APPLICATION = "gym-open"
CURVE, SCORES = "curve.json", "scores.json"


class Curve(msgspec.Struct, frozen=True):
    """A learning curve as the training stages write it; the first column is what the others are drawn over."""

    columns: list[str]
    rows: list[list[float | None]]


def visualize(config: VizConfig, source: Path, save: Path) -> Path:
    """Write a recording of `source` to `save` and return its path.

    Args:
        config: how much of it to show.
        source: a log, release, encoder, policy or scores artefact, or one log file (`.mcap`).
        save: the recording, `*.rrd`; it appears whole or not at all.

    Raises:
        ArtefactError: if `source` is missing, damaged, or holds nothing to draw.
        UsageError: if `save` does not end in `.rrd`.
    """
    if save.suffix != ".rrd":
        raise UsageError(f"{save}: a recording's name must end in .rrd, got {save.suffix or 'no ending'!r}")
    kind = "log file" if source.suffix == ".mcap" and source.is_file() else _kind(source)
    if kind in {"log", "log file"}:
        return _trajectory(config, source, streams_of_log(source), save)
    if kind == "release":
        return _trajectory(config, source, streams_of_release(source), save)
    if (curve := _curve(source)) is not None:
        return _curves(source, curve, save)
    raise ArtefactError(
        f"{source}: nothing to draw in an artefact of kind {kind!r}; give a log, a release, or one with {CURVE}"
    )


def _kind(source: Path) -> str:
    artefacts.verify(source)
    return artefacts.lineage(source).kind


def _trajectory(config: VizConfig, source: Path, streams: Sequence[Stream], save: Path) -> Path:
    def fill(rec: rr.RecordingStream) -> None:
        for stream in streams:
            log_stream(rec, stream, config)

    return _write(source, save, fill, blueprints.trajectory(streams, config))


def _curve(source: Path) -> Curve | None:
    try:
        if (source / CURVE).is_file():
            return msgspec.json.decode((source / CURVE).read_bytes(), type=Curve)
        if (source / SCORES).is_file():
            scores = msgspec.json.decode((source / SCORES).read_bytes())["mean_return_within"]
            return Curve(["actions", "mean_return_within"], [[i + 1, score] for i, score in enumerate(scores)])
    except (msgspec.DecodeError, KeyError) as error:
        raise ArtefactError(f"{source}: its curve is not readable: {error}; build it again") from None
    return None


def _curves(source: Path, curve: Curve, save: Path) -> Path:
    timeline, *names = curve.columns

    def fill(rec: rr.RecordingStream) -> None:
        for i, name in enumerate(names, start=1):
            known = [(row[0], row[i]) for row in curve.rows if row[i] is not None]
            points = np.array(known, dtype=np.float64).reshape(-1, 2)
            at = [rr.TimeColumn(timeline, sequence=points[:, 0].astype(np.int64))]
            rec.send_columns(f"curve/{name}", at, rr.Scalars.columns(scalars=points[:, 1]))
            rec.log(f"curve/{name}", rr.SeriesLines(names=name.replace("_", " "), colors=BLUE), static=True)

    return _write(source, save, fill, blueprints.curves(names, timeline))


def _write(source: Path, save: Path, fill: Callable[[rr.RecordingStream], None], layout: Any) -> Path:
    """Fill a recording under a temporary name, then rename it."""
    save.parent.mkdir(parents=True, exist_ok=True)
    beside = save.with_name(f".{save.name}.tmp")
    try:
        with rr.RecordingStream(APPLICATION, recording_id=save.stem) as rec:
            rec.save(beside, default_blueprint=layout)
            rec.log("about/config", _document(source, artefacts.CONFIG), static=True)
            rec.log("about/lineage", _document(source, artefacts.LINEAGE), static=True)
            fill(rec)
            rec.flush()
            rec.disconnect()
        beside.replace(save)
    finally:
        beside.unlink(missing_ok=True)
    return save


def _document(source: Path, name: str) -> rr.TextDocument:
    folder = source.parent if source.is_file() else source
    path = folder / name
    text = path.read_text(encoding="utf-8") if path.is_file() else "not part of an artefact"
    return rr.TextDocument(f"# {name} of {folder.name}\n```json\n{text}\n```", media_type=rr.MediaType.MARKDOWN)
