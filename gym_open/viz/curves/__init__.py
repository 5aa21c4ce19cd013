"""Curves of any number of encoders and policies, of scores, probes and reports, and of a whole benchmark."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View

if TYPE_CHECKING:
    import rerun as rr

    from gym_open.viz.curves.layout import Span
    from gym_open.viz.curves.rows import Band, Row
    from gym_open.viz.curves.sources import Learned

_PROBES = 12
"""Probes in one figure."""


def view(config: VizConfig, sources: Sequence[Path], choice: Choice) -> View:  # noqa: ARG001  (as every view)
    """Everything below some folders that is a curve, agents side by side: each has one colour everywhere.

    A folder that is no artefact is looked through, so a benchmark's opens as far as it is, with the state of its jobs.

    Args:
        config: not asked: curves are always whole.
        sources: encoder, policy, scores, probe and report artefacts, or folders that hold some.
        choice: must be empty.

    Raises:
        ArtefactError: if a source is damaged, or there is nothing to draw.
        UsageError: if something was picked.
    """
    from gym_open.viz.curves import drawing, figure, jobs, layout, words
    from gym_open.viz.curves.rows import rows_of, rows_of_report
    from gym_open.viz.curves.sources import find
    from gym_open.viz.view import log_document, log_figure

    choice.refuse_others("curves", ())
    found = find(sources)
    rows = rows_of(found.scored) or [row for report in found.reports[:1] for row in rows_of_report(report)]
    policies = [one for one in found.learned if one.kind == "policy" and drawing.RETURN in one.curve.columns]
    encoders = [one for one in found.learned if one.kind == "encoder"]
    states = {source.resolve().name: listed for source in sources if (listed := jobs.jobs_of(source))}
    documents = {
        **{f"jobs of {name}": jobs.document(listed) for name, listed in states.items()},
        **{f"report {i + 1}": words.report_document(report) for i, report in enumerate(found.reports)},
        "what was found": words.found_document(found),
    }
    tasks = _tasks(rows, policies)
    columns = {
        model: list(dict.fromkeys(name for one in encoders if one.group == model for name in one.curve.columns[1:]))
        for model in dict.fromkeys(one.group for one in encoders)
    }
    probes = [found.probed[i : i + _PROBES] for i in range(0, len(found.probed), _PROBES)]
    figures = {drawing.path("probes", str(i)): some for i, some in enumerate(probes)}

    def fill(rec: "rr.RecordingStream") -> None:
        looks = drawing.styles([row.agent for row in rows] + [one.name for one in policies])
        last = max(
            [int(row[0] or 0) for one in policies for row in one.curve.rows] + [row.trained for row in rows] + [1]
        )
        drawing.log_scores(rec, rows, looks, last)
        drawing.log_policies(rec, policies, looks)
        drawing.log_encoders(rec, encoders, drawing.styles(one.name for one in encoders))
        for task, kinds in tasks.items():
            if "about" in kinds:
                text = words.scores_document(task, [row for row in rows if row.task == task])
                log_document(rec, drawing.path("about", "task", task), text)
        for entity, some in figures.items():
            log_figure(rec, entity, figure.draw_probes(some))
        for title, text in documents.items():
            log_document(rec, drawing.path("about", title), text)

    titles = {title: drawing.path("about", title) for title in documents}
    names = ", ".join(source.resolve().name for source in sources[:3]) + (" …" if len(sources) > 3 else "")
    return View(
        f"curves of {names}",
        fill,
        layout.blueprint(tasks, columns, list(figures), titles),
    )


def _tasks(rows: "Sequence[Row]", policies: "Sequence[Learned]") -> dict[str, dict[str, "Span"]]:
    """Which plots there are of each task, and the range of their numbers if it is not to be their own."""
    import numpy as np

    from gym_open.viz.curves.drawing import RETURN
    from gym_open.viz.curves.rows import standing

    kinds: dict[str, dict[str, Span]] = {}
    for task in dict.fromkeys(row.task for row in rows):
        own = [row for row in rows if row.task == task]
        plots: dict[str, Span] = {"return": _room([row.returns for row in own], 1.05), "about": None}
        if any(not standing(row.agent) for row in own):  # else there are no steps to draw over
            plots["score"] = _room([row.learning for row in own], 1.25)
        kinds[task] = plots
    for task in dict.fromkeys(one.group for one in policies):
        returns = [one.curve.known(RETURN)[1] for one in policies if one.group == task]
        low, high = (float(end(np.concatenate(returns), initial=0.0)) for end in (np.min, np.max))
        kinds.setdefault(task, {})["training"] = (low, 1.05 * (high or 1.0))
    return kinds


def _room(bands: "Sequence[Band]", above: float) -> tuple[float, float]:
    """From 0, or the least there is, to somewhat above the greatest: the legend needs room."""
    high = max(value for band in bands for value in band.high)
    return min(0.0, *(value for band in bands for value in band.low)), max(high, 0.1) * above
