"""`view(config, source, choice)`: a log, a release, or part of one, to look at."""

from pathlib import Path

import rerun as rr

from gym_open import artefacts
from gym_open.envs.constants import PITCH
from gym_open.errors import ArtefactError
from gym_open.formats.releases import open_release
from gym_open.formats.releases.reader import Release
from gym_open.viz import documents
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.play import logs, releases
from gym_open.viz.play.drawing import log_stream
from gym_open.viz.play.layout import blueprint
from gym_open.viz.play.streams import Stream, chosen
from gym_open.viz.view import View, log_document

_CACHED_GROUPS = 2
"""Row groups of a release whose pictures are in memory: each is read once, in order."""


def view(config: VizConfig, source: Path, choice: Choice) -> View:
    """What was played: every stream of it, or what was picked.

    Args:
        config: how much of it to show.
        source: a log (its folder, finished or not, whole or damaged, or one `.mcap`) or a release.
        choice: a stream; a segment or steps of the streams; of a release an episode.

    Raises:
        ArtefactError: if there is no log or release, or nothing of it is whole.
        UsageError: if what was picked is not there, or cannot be picked of it.
    """
    title, streams = open_streams(source, choice)
    record = _lineage(source)

    def fill(rec: rr.RecordingStream) -> None:
        told = {"kind": "not an artefact, or not a finished one", "file or folder": source.name}
        log_document(rec, "about/lineage", documents.lineage(f"Lineage of {title}", record, told))
        for stream in streams:
            document = documents.settings(f"{title}, stream {stream.number}", _facts(stream), stream.config)
            log_document(rec, f"{stream.name}/about/settings", document)
            log_stream(rec, stream, config)

    return View(title, fill, blueprint(streams))


def open_streams(source: Path, choice: Choice) -> tuple[str, list[Stream]]:
    """What it is called, and its streams or what was picked of them; raises what `view` does."""
    if _is_release(source):
        choice.refuse_others("a release", {"stream", "segment", "steps", "episode"})
        checked = open_release(source)
        release = Release(checked.root, checked.digest, checked.info, cached_groups=_CACHED_GROUPS)
        title = f"{release.name} {release.version}"
        streams = chosen(releases.open_streams(release), releases.narrowed(release, choice), source)
    else:
        choice.refuse_others("a log", {"stream", "segment", "steps"})
        title = source.name
        streams = chosen(logs.open_streams(source, choice.stream), choice, source)
    return title, streams


def _is_release(source: Path) -> bool:
    record = _lineage(source)
    return record is not None and record.kind == "release"


def _lineage(source: Path) -> artefacts.Lineage | None:
    """What an artefact says of itself; None of what is no artefact, or of a log that is damaged there."""
    try:
        return artefacts.lineage(source) if (source / artefacts.LINEAGE).is_file() else None
    except ArtefactError:
        return None  # a release would have been refused before: see `recording.kind_of`


def _facts(stream: Stream) -> dict[str, object]:
    facts: dict[str, object] = {"damaged": stream.damage} if stream.damage else {}
    return facts | {
        "steps shown": f"{stream.steps.start:,} to {stream.steps.stop - 1:,}",
        "segments shown": len(stream.shown_stays()),
        "worlds of the pool": stream.worlds,
        "coverage": f"steps in each cell, {100 * PITCH:.1f} cm wide",
        "threshold of the loss": "none" if stream.threshold is None else stream.threshold,
    }
