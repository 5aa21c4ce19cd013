"""Layout of curves on the screen."""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from gym_open.terminal import printable
from gym_open.viz.curves.drawing import TIMELINE, path

Span = tuple[float, float] | None


def blueprint(
    tasks: Mapping[str, Mapping[str, Span]], encoders: Mapping[str, Sequence[str]], figures: Sequence[str],
    documents: Mapping[str, str],
) -> rrb.Blueprint:  # fmt: skip
    """Lay out a tab per task, then one for encoders, one for probes, and one per document.

    Args:
        tasks: plots of each task (`score`, `return`, `training`) with the range of their y-axis, None to leave it to
            Rerun, and `about` if there is a document.
        encoders: columns of the curves, by world model.
        figures: entities of the figures of probes.
        documents: entities of further documents, by title.
    """
    tabs: list[rrb.Container | rrb.View] = [_task(task, kinds) for task, kinds in tasks.items()]
    models = [_encoders(model, columns) for model, columns in encoders.items()]
    tabs += [rrb.Tabs(*models, name="encoders")] if models else []
    tabs += [rrb.Spatial2DView(origin=entity, name="probes of encoders") for entity in figures]
    tabs += [rrb.TextDocumentView(origin=entity, name=title) for title, entity in documents.items()]
    return rrb.Blueprint(
        rrb.Tabs(*tabs),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _task(task: str, kinds: Mapping[str, Span]) -> rrb.Container:
    """Lay out the plots side by side, with the document as the fourth part or below them."""
    titles = {
        "score": "A-Success against steps of fine-tuning",
        "return": "mean return within a number of actions",
        "training": "mean return of training episodes against steps of fine-tuning",
    }
    plots = [_plot(title, path(kind, task), kinds[kind]) for kind, title in titles.items() if kind in kinds]
    about = rrb.TextDocumentView(origin=path("about", "task", task), name="scores")
    if "about" not in kinds:
        return rrb.Grid(*plots, name=printable(task))
    if len(plots) % 2:
        return rrb.Grid(*plots, about, grid_columns=2, name=printable(task))
    return rrb.Vertical(rrb.Horizontal(*plots), about, row_shares=[3, 2], name=printable(task))


def _encoders(model: str, columns: Sequence[str]) -> rrb.Grid:
    views = [
        _plot(f"{column.replace('_', ' ')} against updates", path("encoder", model, column), None) for column in columns
    ]
    return rrb.Grid(*views, name=printable(model))


def _plot(title: str, entity: str, span: Span) -> rrb.TimeSeriesView:
    axis = rrb.ScalarAxis(range=span) if span else None  # an empty range makes Rerun warn
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=True)
    return rrb.TimeSeriesView(origin=entity, name=printable(title), plot_legend=legend, axis_y=axis)
