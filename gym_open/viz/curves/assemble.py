"""The view of all curves below some folders: what is found, drawn and laid out on the screen."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from gym_open.markdown import cell
from gym_open.results.names import is_trained
from gym_open.results.records import IntervalCurve
from gym_open.results.rows import RowSummary
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.curves import documents, drawing, figure, jobs, layout
from gym_open.viz.curves.layout import Span
from gym_open.viz.curves.sources import CurveSources, TrainedModel, find, summaries, summaries_of_report
from gym_open.viz.view import View, log_document, log_figure

_PROBES = 12
"""Probes in one figure."""


def view(config: VizConfig, sources: Sequence[Path], choice: Choice) -> View:  # noqa: ARG001  (as every view)
    """Show everything below some folders that is a curve, agents together; each agent has one colour everywhere.

    A folder that is no artefact is searched, so the folder of an unfinished grid opens too, with the state of its jobs.

    Args:
        config: not used: curves are always whole.
        sources: encoder, policy, scores, probe and report artefacts, or folders that hold some.
        choice: must be empty.

    Raises:
        ArtefactError: if a source is damaged, or there is nothing to draw.
        UsageError: if something was picked.
    """
    choice.refuse_others("curves", ())
    found = find(sources)
    rows, left_behind = summaries(found.runs)
    found.left_out.extend(cell(line, 400) for line in left_behind)
    if not rows and found.reports:
        rows = summaries_of_report(found.reports[0])
    policies = [model for model in found.models if model.kind == "policy" and drawing.RETURN in model.curve.columns]
    encoders = [model for model in found.models if model.kind == "encoder"]
    tasks = _plots(rows, policies)
    texts = _documents(sources, found)
    probes = [found.probes[i : i + _PROBES] for i in range(0, len(found.probes), _PROBES)]
    figures = {drawing.path("probes", str(i)): some for i, some in enumerate(probes)}

    def fill(rec: rr.RecordingStream) -> None:
        styles = drawing.styles([row.agent for row in rows] + [model.name for model in policies])
        drawing.log_scores(rec, rows, styles, _last_step(rows, policies))
        drawing.log_policies(rec, policies, styles)
        drawing.log_encoders(rec, encoders, drawing.styles(model.name for model in encoders))
        for task in (task for task, plots in tasks.items() if "about" in plots):
            text = documents.scores_document(task, [row for row in rows if row.task == task])
            log_document(rec, drawing.path("about", "task", task), text)
        for entity, some in figures.items():
            log_figure(rec, entity, figure.draw_probes(some))
        for title, text in texts.items():
            log_document(rec, drawing.path("about", title), text)

    titles = {title: drawing.path("about", title) for title in texts}
    names = ", ".join(source.resolve().name for source in sources[:3]) + (" …" if len(sources) > 3 else "")
    return View(f"curves of {names}", fill, layout.blueprint(tasks, _columns(encoders), list(figures), titles))


def _documents(sources: Sequence[Path], found: CurveSources) -> dict[str, str]:
    """Return the documents that belong to no task, by title."""
    states = {source.resolve().name: listed for source in sources if (listed := jobs.jobs_of(source))}
    return {
        **{f"jobs of {name}": jobs.document(listed) for name, listed in states.items()},
        **{f"report {i + 1}": documents.report_document(report) for i, report in enumerate(found.reports)},
        "what was found": documents.found_document(found),
    }


def _columns(encoders: Sequence[TrainedModel]) -> dict[str, list[str]]:
    """Return the columns of the curves of each world model."""
    columns: dict[str, list[str]] = {}
    for model in encoders:
        own = columns.setdefault(model.group, [])
        own.extend(name for name in model.curve.columns[1:] if name not in own)
    return columns


def _last_step(rows: Sequence[RowSummary], policies: Sequence[TrainedModel]) -> int:
    steps = [int(row[0] or 0) for model in policies for row in model.curve.rows]
    return max(steps + [row.trained for row in rows] + [1])


def _plots(rows: Sequence[RowSummary], policies: Sequence[TrainedModel]) -> Mapping[str, Mapping[str, Span]]:
    """Return the plots of each task, with the range of the y-axis; None leaves the range to Rerun."""
    tasks: dict[str, dict[str, Span]] = {}
    for task in dict.fromkeys(row.task for row in rows):
        own = [row for row in rows if row.task == task]
        plots: dict[str, Span] = {"return": _range([row.returns for row in own], 1.05), "about": None}
        if any(is_trained(row.agent) for row in own):  # the others have no steps to draw over
            plots["score"] = _range([row.learning for row in own], 1.25)
        tasks[task] = plots
    for task in dict.fromkeys(model.group for model in policies):
        returns = [model.curve.known(drawing.RETURN)[1] for model in policies if model.group == task]
        low, high = (float(end(np.concatenate(returns), initial=0.0)) for end in (np.min, np.max))
        tasks.setdefault(task, {})["training"] = (low, 1.05 * (high or 1.0))
    return tasks


def _range(curves: Sequence[IntervalCurve], above: float) -> tuple[float, float]:
    """Return a range from 0 or the least value to somewhat above the greatest, since the legend needs room."""
    high = max(value for curve in curves for value in curve.high)
    return min(0.0, *(value for curve in curves for value in curve.low)), max(high, 0.1) * above
