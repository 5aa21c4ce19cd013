"""All curves, scores, probes and reports below some folders, checked while they are read."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec

from gym_open import artefacts, progress
from gym_open.errors import ArtefactError
from gym_open.markdown import cell
from gym_open.results.names import one_line
from gym_open.results.records import CURVE, ProbeRecord, TrainingCurve, read_curve, read_probe
from gym_open.results.rows import Resampling, RowSummary, rows_of, summarise_row
from gym_open.results.runs import ScoredRun, artefact_folders, distinct, read_run

_REPORT = "table.json"
_READ = frozenset({CURVE, _REPORT, artefacts.CONFIG, artefacts.LINEAGE})
"""Files of a model or report whose bytes are checked: only these are read."""
_SKIPPED = ("log", "release", "compact", "recording", "figure")
_MAX_TARGETS, _MAX_PROBES = 24, 120
"""Targets that are drawn of one probe, and probes that are drawn."""


class TrainedModel(msgspec.Struct, frozen=True):
    """The training of a policy or of an encoder."""

    kind: str
    """`policy` or `encoder`."""
    group: str
    """Curves of one group can be compared: the task of a policy, the world model of an encoder."""
    name: str
    """The agent of a policy, the folder of an encoder."""
    seed: int | None
    curve: TrainingCurve


class ReportTable(msgspec.Struct, frozen=True):
    """A report's name and its `table.json`, of which only what is drawn is checked."""

    name: str
    table: dict[str, Any]


class CurveSources(msgspec.Struct, frozen=True):
    """All that there is to draw."""

    models: list[TrainedModel] = []
    runs: list[ScoredRun] = []
    probes: list[ProbeRecord] = []
    reports: list[ReportTable] = []
    left_out: list[str] = []
    """What was found but not used, and why, in Markdown."""


def find(sources: Sequence[Path]) -> CurveSources:
    """Read everything that can be drawn at or below the sources; other folders are searched.

    A damaged artefact is an error if it is itself a source; below a source it is listed in `left_out`. Hidden folders
    (unfinished artefacts) and artefacts that a newer one has set aside (NAME-1 next to NAME) are skipped.

    Raises:
        ArtefactError: if a source is damaged, or there is nothing to draw.
    """
    found = CurveSources()
    folders = list(dict.fromkeys(path for source in sources for path in _artefacts(source)))
    given = {source.resolve() for source in sources}
    with progress.bar("read curves", len(folders)) as bar:
        for folder in folders:
            try:
                _take(folder, found, given=folder in given)
            except ArtefactError as error:
                if folder in given:
                    raise
                found.left_out.append(f"`{cell(folder.name)}`: {cell(error, 400)}")
            bar.advance()
    kept, _, doubles = distinct(found.runs)
    found.runs[:] = kept
    found.left_out.extend(
        f"`{cell(run.folder.name)}`: other scores of the same run as `{cell(first.folder.name)}`"
        for run, first in doubles
    )
    if not (found.models or found.runs or found.probes or found.reports):
        names = ", ".join(map(str, sources))
        why = f" ({len(found.left_out)} artefacts are damaged or of another version)" if found.left_out else ""
        raise ArtefactError(
            f"{names}: nothing to draw here{why}; give encoders, policies, scores, probes, a report, or a folder that "
            "holds some, such as a benchmark's"
        )
    return found


def _artefacts(source: Path) -> Iterator[Path]:
    if not source.is_dir():
        raise ArtefactError(f"{source}: no such folder; give an artefact, or a folder that holds some")
    return artefact_folders(source)


def _is_set_aside(folder: Path) -> bool:
    name, _, number = folder.name.rpartition("-")
    return number.isdecimal() and (folder.parent / name / artefacts.MANIFEST).is_file()


def _take(folder: Path, found: CurveSources, *, given: bool) -> None:
    lineage = artefacts.lineage(folder)
    if lineage.kind == "scores":  # `distinct` knows which of them are set aside
        found.runs.append(read_run(folder))
        return
    if lineage.kind in _SKIPPED or (_is_set_aside(folder) and not given):
        return
    facts = lineage.facts
    if lineage.kind == "probe":
        _take_probe(read_probe(folder), found)
        return
    artefacts.verify(folder, hashed=_READ.__contains__)
    if lineage.kind == "policy":
        name, seed = one_line(str(facts.get("agent", folder.name))), facts.get("seed")
        found.models.append(TrainedModel("policy", str(facts.get("task")), name, seed, _curve(folder)))
    elif lineage.kind == "encoder":
        model = str(facts.get("world_model"))
        found.models.append(TrainedModel("encoder", model, folder.name, None, _curve(folder)))
    elif lineage.kind == "report":
        found.reports.append(_report(folder))


def _curve(folder: Path) -> TrainingCurve:
    if (curve := read_curve(folder)) is None:
        raise ArtefactError(f"{folder / CURVE}: missing; make the artefact again")
    return curve


def _report(folder: Path) -> ReportTable:
    path = folder / _REPORT
    try:
        return ReportTable(folder.name, msgspec.json.decode(path.read_bytes(), type=dict[str, Any]))
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; make the report again") from None


def _take_probe(probe: ProbeRecord, found: CurveSources) -> None:
    name = cell(probe.folder.name)
    if len(found.probes) >= _MAX_PROBES:
        found.left_out.append(f"`{name}`: only {_MAX_PROBES} probes are drawn")
        return
    if (more := len(probe.targets) - _MAX_TARGETS) > 0:
        found.left_out.append(f"`{name}`: {more:,} of its targets, since only {_MAX_TARGETS} are drawn")
    targets = dict(islice(probe.targets.items(), _MAX_TARGETS))
    found.probes.append(msgspec.structs.replace(probe, targets=targets))


def summaries(runs: Sequence[ScoredRun]) -> tuple[list[RowSummary], list[str]]:
    """Summarise runs as `gym-open report` does by default, each split by itself.

    Returns:
        A summary per agent and task, whose `task` also names the split if it is not `test`; and a line for each seed
        that has no score at the largest training length.
    """
    made, left_behind = list[RowSummary](), list[str]()
    for split in dict.fromkeys(run.record.split for run in runs):
        for row in rows_of([run for run in runs if run.record.split == split]):
            summary = summarise_row(row, Resampling())
            task = row.task if split == "test" else f"{row.task}, {split}"
            made.append(msgspec.structs.replace(summary, task=task))
            left_behind.extend(row.left_behind())
    return made, left_behind


def summaries_of_report(report: ReportTable) -> list[RowSummary]:
    """Return the summaries in a report's `table.json`.

    Raises:
        ArtefactError: if it is not as `gym-open report` writes it.
    """
    try:
        return msgspec.convert(report.table["results"]["cells"], list[RowSummary])
    except (msgspec.ValidationError, KeyError, TypeError) as error:
        raise ArtefactError(
            f"{report.name}: table.json: not a report's table: {error}; make the report again"
        ) from None
