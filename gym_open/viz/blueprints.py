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
        rrb.TimePanel(state="collapsed", timeline="step", playback_speed=1.0, fps=25.0),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _stream(stream: Stream, config: VizConfig) -> rrb.Horizontal:
    name = f"/{stream.name}"
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Spatial2DView(origin=f"{name}/observation", name="observation"),
            rrb.Spatial3DView(
                origin=f"{name}/table", name="table", overrides={f"{name}/table/trail": trail(config.trail_steps)}
            ),
            row_shares=[2, 3],
        ),
        rrb.Vertical(
            rrb.TimeSeriesView(origin=f"{name}/series/intrinsic_reward", name="intrinsic reward"),
            rrb.TimeSeriesView(
                contents=[f"{name}/series/world_model_loss", f"{name}/threshold"], name="world-model loss, threshold"
            ),
            rrb.TimeSeriesView(contents=[f"{name}/world", f"{name}/switches"], name="world of the pool, and switches"),
            rrb.TimeSeriesView(
                contents=[f"{name}/series/entropy", f"{name}/series/value"], name="policy: entropy (nats), value"
            ),
            rrb.TimeSeriesView(
                contents=[f"{name}/series/action", f"{name}/series/contacts"], name="action (0 = stay), contacts"
            ),
        ),
        rrb.Vertical(
            rrb.TextLogView(origin=f"{name}/events", name="events"),
            rrb.Tabs(
                rrb.TextDocumentView(origin="/about/config", name="configuration"),
                rrb.TextDocumentView(origin="/about/lineage", name="lineage"),
            ),
        ),
        column_shares=[4, 4, 2],
        name=stream.name.replace("_", " "),
    )


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
    views = [rrb.TimeSeriesView(origin=f"/curve/{name}", name=name.replace("_", " ")) for name in names]
    about = rrb.TextDocumentView(origin="/about/config", name="configuration")
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Grid(*views), about, column_shares=[4, 1]),
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
