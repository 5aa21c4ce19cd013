"""The screen of a log or release, with one tab per stream; data that was not recorded has no view."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from gym_open.viz.streams.images import DEPTH, IMAGE, SEGMENTATION
from gym_open.viz.streams.model import ACTION, CONTACTS, ENTROPY, LOSS, PART, REWARD, VALUE, ShownStream
from gym_open.viz.streams.series import series_entity


def blueprint(streams: Sequence[ShownStream]) -> rrb.Blueprint:
    """Images and the table on the left, curves in the middle, texts on the right."""
    tabs = [_stream(item) for item in streams]
    return rrb.Blueprint(
        tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs, name="streams"),
        rrb.TimePanel(state="collapsed", timeline="step", fps=25.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _stream(stream: ShownStream) -> rrb.Horizontal:
    return rrb.Horizontal(
        _images(stream),
        rrb.Vertical(*_curves(stream)),
        _words(stream),
        column_shares=[5 if stream.depth or stream.segmentation else 4, 4, 3],
        name=stream.name.replace("_", " "),
    )


def _images(stream: ShownStream) -> rrb.Vertical:
    name = f"/{stream.name}"
    images = [rrb.Spatial2DView(origin=f"{name}/{IMAGE}", name="observation")]
    if stream.depth:
        images.append(rrb.Spatial2DView(origin=f"{name}/{DEPTH}", name="depth (m)"))
    if stream.segmentation:
        images.append(rrb.Spatial2DView(origin=f"{name}/{SEGMENTATION}", name="segmentation"))
    mapping = rrb.TensorScalarMapping(colormap="viridis", mag_filter="nearest", gamma=0.5)
    coverage = rrb.TensorView(
        origin=f"{name}/coverage", name="coverage", scalar_mapping=mapping, view_fit="FillKeepAspectRatio"
    )
    table = rrb.Spatial3DView(origin=f"{name}/table", name="table")
    if len(images) == 1:
        return rrb.Vertical(rrb.Horizontal(*images, coverage, column_shares=[3, 2]), table, row_shares=[2, 3])
    return rrb.Vertical(
        rrb.Horizontal(*images), rrb.Horizontal(table, coverage, column_shares=[3, 1]), row_shares=[2, 3]
    )


def _curves(stream: ShownStream) -> list[rrb.TimeSeriesView]:
    """One plot per group of series, if at least one series of the group is known."""
    name = f"/{stream.name}"
    parts = [PART + part for part in stream.reward_parts]
    known = {
        series: series_entity(name, series)
        for series in [REWARD, *parts, LOSS, ENTROPY, VALUE]
        if series in stream.known
    }
    reward = [known[series] for series in (REWARD, *parts) if series in known]
    views: list[rrb.TimeSeriesView] = []
    if reward:
        views.append(_plot("intrinsic reward and its parts", *reward))
    if LOSS in known:
        title = "world-model loss" if stream.threshold is None else "world-model loss, and the threshold"
        views.append(_plot(title, known[LOSS], f"{name}/threshold"))
    worlds = [segment.world for segment in stream.shown_segments()] + [
        switch.to_world for switch in stream.shown_switches() if switch.to_world >= 0
    ]
    views.append(
        _plot(
            "curriculum: world of the pool, switches",
            f"{name}/world",
            f"{name}/switches/**",
            span=(min(worlds, default=0) - 0.7, max(worlds, default=0) + 0.7),
        )
    )
    if stream.with_losses():
        views.append(_plot("loss of each world, at every switch", f"{name}/world_loss", legend=stream.worlds <= 3))
    if policy := [known[series] for series in (ENTROPY, VALUE) if series in known]:
        views.append(_plot("policy: entropy, value", *policy))
    views.append(_plot("action, contacts", series_entity(name, ACTION), series_entity(name, CONTACTS)))
    return views


def _words(stream: ShownStream) -> rrb.Vertical:
    name = f"/{stream.name}"
    events = rrb.TextLogView(origin=f"{name}/events", name="events")
    documents = rrb.Tabs(
        rrb.TextDocumentView(origin=f"{name}/segments", contents=f"{name}/segments", name="segments"),
        rrb.TextDocumentView(origin=f"{name}/about/settings", name="settings"),
        rrb.TextDocumentView(origin="/about/lineage", name="lineage"),
    )
    if not stream.with_losses():
        return rrb.Vertical(events, documents)
    bars = rrb.BarChartView(origin=f"{name}/world_losses", name="loss of each world at the last switch")
    return rrb.Vertical(events, bars, documents, row_shares=[3, 2, 4])


def _plot(
    title: str, *entities: str, legend: bool = True, span: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """A plot of the entities; `span` is the range of the vertical axis, by default that of the data."""
    corner = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend)
    axis = rrb.ScalarAxis(range=span) if span else None  # Rerun warns about an axis without a range
    return rrb.TimeSeriesView(contents=list(entities), name=title, plot_legend=corner, axis_y=axis)
