"""How each kind of recording is laid out on the screen."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from gym_open.viz.config import VizConfig
from gym_open.viz.spans import Stream


def trajectory(streams: Sequence[Stream], config: VizConfig) -> rrb.Blueprint:
    """Log or release: a tab a stream, with picture and table on the left, series in the middle, words on the right."""
    tabs = [_stream(item, config) for item in streams]
    return rrb.Blueprint(
        tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs, name="streams"),
        rrb.TimePanel(state="collapsed", timeline="step", sequence_cursor=0, fps=25.0),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _stream(stream: Stream, config: VizConfig) -> rrb.Horizontal:
    name = f"/{stream.name}"
    pool = max((len(item.world_losses) for item in stream.switches), default=1)
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Spatial2DView(origin=f"{name}/observation", name="observation"),
            rrb.Spatial3DView(
                origin=f"{name}/table", name="table", overrides={f"{name}/table/trail": trail(config.trail_steps)}
            ),
            row_shares=[2, 3],
        ),
        rrb.Vertical(
            _plot("intrinsic reward", f"{name}/series/intrinsic_reward"),
            _plot("world-model loss, threshold", f"{name}/series/world_model_loss", f"{name}/threshold"),
            _plot("world of the pool, and switches", f"{name}/world", f"{name}/switches", span=(-1.5, pool + 0.5)),
            _plot("policy: entropy (nats), value", f"{name}/series/entropy", f"{name}/series/value"),
            _plot("action (0 = stay), contacts", f"{name}/series/action", f"{name}/series/contacts"),
        ),
        rrb.Vertical(
            rrb.TextLogView(origin=f"{name}/events", name="events"),
            rrb.Tabs(
                rrb.TextDocumentView(origin="/about/config", name="configuration"),
                rrb.TextDocumentView(origin="/about/lineage", name="lineage"),
            ),
        ),
        column_shares=[4, 4, 3],
        name=stream.name.replace("_", " "),
    )


def _plot(title: str, *entities: str, span: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    """A plot of the entities; `span` is the range of its scalar axis, else that of the data."""
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop, visible=len(entities) > 1)
    axis = rrb.ScalarAxis(range=span) if span else None  # an empty one makes Rerun warn
    return rrb.TimeSeriesView(contents=list(entities), name=title, plot_legend=legend, axis_y=axis)


def trail(steps: int) -> rrb.VisibleTimeRanges:
    """Show the points of the last `steps` steps together, on either timeline."""
    from gym_open.envs.constants import CONTROL_DT_S

    now, sooner = rrb.TimeRangeBoundary.cursor_relative, -steps * CONTROL_DT_S
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange("step", start=now(seq=-steps), end=now(seq=0)),
            rrb.VisibleTimeRange("sim_time", start=now(seconds=sooner), end=now(seconds=0.0)),
        ]
    )


def curves(names: Sequence[str], timeline: str) -> rrb.Blueprint:
    """Learning curves: a plot each."""
    views = [_plot(name.replace("_", " "), f"/curve/{name}") for name in names]
    about = rrb.TextDocumentView(origin="/about/config", name="configuration")
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Grid(*views), about, column_shares=[4, 1]),
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
