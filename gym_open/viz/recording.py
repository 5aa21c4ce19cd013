"""The entry point of viz: find the view that shows a source."""

from collections.abc import Sequence
from pathlib import Path

from gym_open import artefacts
from gym_open.errors import ArtefactError, UsageError
from gym_open.viz import viewers
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View

LOG, BENCHMARK = "log", "benchmark"
_EXPLORED = frozenset({LOG, "release", "compact"})
_EVALUATED = frozenset({"scores", "policy"})
_LEARNED = frozenset({"encoder", "policy", "probe", "report", BENCHMARK})
_SOURCES = "a log (a folder or one .mcap), release, encoder, policy, probe, scores, report, or a benchmark's folder"


def open_view(config: VizConfig, sources: Sequence[Path], choice: Choice) -> View:
    """Choose the view of the sources; large sources are read only when the view fills a recording.

    Args:
        config: how much of a source to show.
        sources: one log, release, encoder or policy; or several sources that have a common view: scores, scores and
            policies on one puzzle, or sources with curves.
        choice: the part of the source.

    Raises:
        ArtefactError: if a source is missing, damaged, or of a kind without a view.
        UsageError: if the sources have no common view, or the selected part does not exist.
    """
    if not sources:
        raise UsageError(f"no source given; give {_SOURCES}")
    kinds = {source: kind_of(source) for source in sources}
    found = set(kinds.values())
    alone = len(sources) == 1
    if choice.puzzle is not None or found == {"scores"}:
        if others := [source for source, kind in kinds.items() if kind not in _EVALUATED]:
            raise UsageError(f"--puzzle shows scores and policies; {others[0]} is of kind {kinds[others[0]]!r}")
        from gym_open.viz import puzzles

        return puzzles.view(config, sources, choice)
    if alone and (found == {"encoder"} or (choice.release is not None and found <= {"policy", LOG})):
        from gym_open.viz import features

        return features.view(config, sources[0], choice)
    if alone and found <= _EXPLORED:
        from gym_open.viz import streams

        return streams.view(config, sources[0], choice)
    if found <= _LEARNED:
        from gym_open.viz import curves

        return curves.view(config, sources, choice)
    given = ", ".join(sorted(kinds[source] for source in sources))
    raise UsageError(
        f"{len(sources)} sources ({given}) have no common view; give one log or release, or only scores, or models, "
        "probes and reports, or scores and policies with --puzzle TASK/NUMBER"
    )


def kind_of(source: Path) -> str:
    """Kind of the artefact at `source`; `log` also for a single log file and for an unfinished log.

    Raises:
        ArtefactError: if `source` does not exist, or is of a kind without a view.
    """
    if not source.exists():
        raise ArtefactError(f"{source}: no such file or folder; give {_SOURCES}")
    if source.suffix == ".mcap" and source.is_file():
        return LOG
    if (source / artefacts.LINEAGE).is_file():
        kind = _kind_in_lineage(source)
        if kind in _EXPLORED | _EVALUATED | _LEARNED:
            return kind
        what = {"recording": "rerun", "figure": "open"}.get(kind)
        file = next((file.name for ending in ("rrd", "png") for file in source.glob(f"*.{ending}")), "its file")
        remedy = f"it can be opened directly: {what} {source / file}" if what else f"give {_SOURCES}"
        raise ArtefactError(f"{source}: there is no view of an artefact of kind {kind!r}; {remedy}")
    if _holds_logs(source):
        return LOG
    if (source / "jobs").is_dir():
        return BENCHMARK
    raise ArtefactError(f"{source}: not made by gym-open, or incomplete; give {_SOURCES}")


def _kind_in_lineage(source: Path) -> str:
    """The kind according to the lineage; a log with a damaged lineage is still a log."""
    try:
        return artefacts.lineage(source).kind
    except ArtefactError:
        if _holds_logs(source):
            return LOG
        raise


def _holds_logs(source: Path) -> bool:
    return source.is_dir() and any(source.glob("*.mcap"))


def visualize(config: VizConfig, source: Path, save: Path) -> Path:
    """Write a recording of all of `source` to the `.rrd` file `save`, and return its path."""
    return viewers.save(open_view(config, [source], Choice()), save)
