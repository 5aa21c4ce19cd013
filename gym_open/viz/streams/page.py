"""The view of a log, a release, or a part of one."""

from pathlib import Path

import rerun as rr

from gym_open import artefacts
from gym_open.envs.constants import PITCH
from gym_open.errors import ArtefactError
from gym_open.formats.releases.reader import Release
from gym_open.replay.compact import open_dataset
from gym_open.replay.compact.release import CompactRelease
from gym_open.viz import documents
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.streams import logs, releases
from gym_open.viz.streams.drawing import log_stream
from gym_open.viz.streams.layout import blueprint
from gym_open.viz.streams.model import ShownStream, chosen
from gym_open.viz.view import View, log_document

_CACHED_GROUPS = 2
"""Row groups of a release with their images in memory; each group is read once, in order."""


def view(config: VizConfig, source: Path, choice: Choice) -> View:
    """The view of all streams, or of the selected part.

    Args:
        config: how much to show.
        source: a log (its folder, also unfinished or damaged, or one `.mcap` file) or a release.
        choice: a stream; a segment or steps of the streams; or an episode of a release.

    Raises:
        ArtefactError: if there is no log or release, or it has no complete step.
        UsageError: if the selected part does not exist, or the choice does not apply to the source.
    """
    title, streams = open_streams(source, choice)
    record = _lineage(source)

    def fill(rec: rr.RecordingStream) -> None:
        facts = {"kind": "not an artefact, or an unfinished one", "file or folder": source.name}
        log_document(rec, "about/lineage", documents.lineage(f"Lineage of {title}", record, facts))
        for stream in streams:
            document = documents.settings(f"{title}, stream {stream.number}", _facts(stream), stream.config)
            log_document(rec, f"{stream.name}/about/settings", document)
            log_stream(rec, stream, config)

    return View(title, fill, blueprint(streams))


def open_streams(source: Path, choice: Choice) -> tuple[str, list[ShownStream]]:
    """Title of the source, and its streams or their selected part; raises the errors of `view`."""
    if _is_release(source):
        choice.refuse_others("a release", {"stream", "segment", "steps", "episode"})
        release = open_dataset(source)
        if not isinstance(release, CompactRelease):
            release = Release(release.root, release.digest, release.info, cached_groups=_CACHED_GROUPS)
        title = f"{release.name} {release.version}"
        streams = chosen(releases.open_streams(release), releases.narrowed(release, choice), source)
    else:
        choice.refuse_others("a log", {"stream", "segment", "steps"})
        title = source.name
        streams = chosen(logs.open_streams(source, choice.stream), choice, source)
    return title, streams


def _is_release(source: Path) -> bool:
    record = _lineage(source)
    return record is not None and record.kind in {"release", "compact"}


def _lineage(source: Path) -> artefacts.Lineage | None:
    """The lineage of an artefact; None without one, or if the lineage of a log is damaged."""
    try:
        return artefacts.lineage(source) if (source / artefacts.LINEAGE).is_file() else None
    except ArtefactError:
        return None  # `recording.kind_of` has already refused a damaged release


def _facts(stream: ShownStream) -> dict[str, object]:
    facts: dict[str, object] = {"damaged": stream.damage} if stream.damage else {}
    return facts | {
        "steps shown": f"{stream.steps.start:,} to {stream.steps.stop - 1:,}",
        "segments shown": len(stream.shown_segments()),
        "worlds of the pool": stream.worlds,
        "coverage": f"steps in each cell of {100 * PITCH:.1f} cm",
        "threshold of the loss": "none" if stream.threshold is None else stream.threshold,
    }
