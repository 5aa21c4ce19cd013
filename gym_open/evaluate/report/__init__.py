"""`gym-open report`: one page about many scores, with tables, figures, proofs and commands."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gym_open import artefacts
from gym_open.config import check, to_dict
from gym_open.evaluate.config import ReportConfig
from gym_open.evaluate.report.gather import ReportSources, gather
from gym_open.evaluate.report.treatment import check_treatments, unchecked
from gym_open.results.names import one_line
from gym_open.results.runs import ScoredRun

__all__ = ["ReportConfig", "write_report"]


class _ReportInputs(ReportConfig, frozen=True, kw_only=True):
    """Everything except scores that a report depends on."""

    configurations: tuple[str, ...]
    """SHA-256 of the configurations that were found, which the page shows."""


def write_report(config: ReportConfig, sources: Sequence[Path], out: Path) -> artefacts.Outcome:
    """Write a report about all scores below some folders: an artefact of kind `report`.

    Payload: `report.html` (one file, no script, no network), `report.md`, `figures/*.svg`, and `table.json` with every
    number of the page. Equal scores and configurations give equal bytes in any folder.

    Args:
        config: title, split, reference, intervals.
        sources: folders with scores and probes at any depth. Configurations are read from the policies, encoders,
            releases and logs below them, and in the workspace that the sources belong to.
        out: the report's folder.

    Raises:
        UsageError: if a source is no folder, or there are no scores of the split.
        ArtefactError: if an artefact is damaged or contradicts itself or another, or runs of one agent were made in
            different ways.
    """
    config = check(config, source="options")
    found = gather(sources, config.split)
    check_treatments(found.runs, found.configs)
    inputs = _ReportInputs(**to_dict(config), configurations=tuple(sorted(found.configs)))

    def work(folder: Path) -> Mapping[str, Any]:
        return _write(folder, config, found)

    return artefacts.build(out, kind="report", config=inputs, parents=found.folders, work=work)


def _write(folder: Path, config: ReportConfig, found: ReportSources) -> Mapping[str, Any]:
    from gym_open.evaluate.report import notes, page, provenance
    from gym_open.evaluate.report.figures import draw
    from gym_open.evaluate.report.numbers import evaluate_runs
    from gym_open.evaluate.report.probes import probe_tables

    results = evaluate_runs(found.runs, config)
    proven = provenance.proofs(found.runs, results.agents)
    settings, recipes = provenance.recipes(found.runs, results.agents, found.configs)
    content = page.ReportContent(
        title=one_line(config.title),
        config=to_dict(config),
        results=results,
        findings=list(notes.findings(results)),
        notes=list(notes.notes(results, found.runs, proven, unchecked(found.runs, found.configs))) + found.left_out,
        proofs=proven,
        probes=probe_tables(found.probes, found.runs),
        settings=settings,
        recipes=recipes,
        makers=_makers(found.runs),
    )
    figures = draw(results)
    (folder / "figures").mkdir(exist_ok=True)
    for figure in figures:
        (folder / "figures" / figure.name).write_bytes(figure.svg)
    (folder / "report.html").write_text(page.html(content, figures, config), encoding="utf-8")
    (folder / "report.md").write_text(page.markdown(content, figures, config), encoding="utf-8")
    (folder / "table.json").write_bytes(artefacts.canonical_json(content))
    return {"agents": results.agents, "tasks": results.tasks, "split": config.split, "scores": len(found.runs)}


def _makers(runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """List the code, packages and hardware that made the scores, with the number of scores for each."""
    counted: dict[bytes, dict[str, Any]] = {}
    for run in runs:
        made = {
            "code": one_line(run.lineage.code),
            "packages": {one_line(name): one_line(version) for name, version in run.lineage.packages.items()},
            "hardware": {one_line(name): one_line(str(value)) for name, value in run.record.hardware.items()}
            | ({"trained in": run.record.precision} if run.record.precision else {}),
        }
        counted.setdefault(msgspec.json.encode(made, order="sorted"), made | {"scores": 0})["scores"] += 1
    return [counted[key] for key in sorted(counted)]
