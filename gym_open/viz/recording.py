"""The front door: which view shows what a person points at."""

from collections.abc import Sequence
from pathlib import Path

from gym_open import artefacts
from gym_open.errors import ArtefactError, UsageError
from gym_open.viz import viewers
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View

LOG, BENCHMARK = "log", "benchmark"
_PLAY = frozenset({LOG, "release"})
_PLAYED = frozenset({"scores", "policy"})
_LEARNED = frozenset({"encoder", "policy", "probe", "report", BENCHMARK})
_LOOKED_AT = "a log (a folder or one .mcap), release, encoder, policy, probe, scores, report, or a benchmark's folder"


def open_view(config: VizConfig, sources: Sequence[Path], choice: Choice) -> View:
    """What there is to see in the sources; it is read when the view is filled, or already here if it is small.

    Args:
        config: how much of it to show.
        sources: one log, release, encoder or policy; or several that can be seen together: scores, policies on one
            puzzle, or anything that has curves.
        choice: what of it.

    Raises:
        ArtefactError: if a source is missing, damaged, or nothing that can be looked at.
        UsageError: if the sources cannot be seen together, or what was picked is not part of them.
    """
    if not sources:
        raise UsageError(f"nothing to look at was given; give {_LOOKED_AT}")
    kinds = {source: kind_of(source) for source in sources}
    found = set(kinds.values())
    alone = len(sources) == 1
    if choice.puzzle is not None or found == {"scores"}:
        if others := [source for source, kind in kinds.items() if kind not in _PLAYED]:
            raise UsageError(f"--puzzle shows scores and policies; {others[0]} is of kind {kinds[others[0]]!r}")
        from gym_open.viz import puzzles

        return puzzles.view(config, sources, choice)
    if alone and (found == {"encoder"} or (choice.release is not None and found <= {"policy", LOG})):
        from gym_open.viz import features

        return features.view(config, sources[0], choice)
    if alone and found <= _PLAY:
        from gym_open.viz import play

        return play.view(config, sources[0], choice)
    if found <= _LEARNED:
        from gym_open.viz import curves

        return curves.view(config, sources, choice)
    told = ", ".join(sorted(kinds[source] for source in sources))
    raise UsageError(
        f"{len(sources)} sources ({told}) are not seen together; give one log or release, or scores alone, or models, "
        "probes and reports, or scores and policies with --puzzle TASK/NUMBER"
    )


def kind_of(source: Path) -> str:
    """Kind of the artefact at `source`; `log` also for one log file and for what a killed explorer left.

    Raises:
        ArtefactError: if there is nothing, or nothing that can be looked at.
    """
    if not source.exists():
        raise ArtefactError(f"{source}: no such file or folder; give {_LOOKED_AT}")
    if source.suffix == ".mcap" and source.is_file():
        return LOG
    if (source / artefacts.LINEAGE).is_file():
        kind = _kind_told(source)
        if kind in _PLAY | _PLAYED | _LEARNED:
            return kind
        what = {"recording": "rerun", "figure": "open"}.get(kind)
        file = next((file.name for ending in ("rrd", "png") for file in source.glob(f"*.{ending}")), "its file")
        remedy = f"it is a picture already: {what} {source / file}" if what else f"give {_LOOKED_AT}"
        raise ArtefactError(f"{source}: nothing to draw in an artefact of kind {kind!r}; {remedy}")
    if _holds_logs(source):
        return LOG
    if (source / "jobs").is_dir():
        return BENCHMARK
    raise ArtefactError(f"{source}: not made by gym-open, or not a whole artefact; give {_LOOKED_AT}")


def _kind_told(source: Path) -> str:
    """What the artefact says it is; logs may be damaged in any way, and are looked at all the same."""
    try:
        return artefacts.lineage(source).kind
    except ArtefactError:
        if _holds_logs(source):
            return LOG
        raise


def _holds_logs(source: Path) -> bool:
    return source.is_dir() and any(source.glob("*.mcap"))


def visualize(config: VizConfig, source: Path, save: Path) -> Path:
    """Write a recording of all of `source` to `save`, as `open_view` and `viewers.save` do, and return its path."""
    return viewers.save(open_view(config, [source], Choice()), save)
