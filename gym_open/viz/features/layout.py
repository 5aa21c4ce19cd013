"""The screen of an encoder's features."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from gym_open.viz.features.drawing import COLOURINGS, TIMELINE

_MARKS = ("axes", "titles", "near", "here")


def blueprint(names: Sequence[str], *, curve: bool) -> rrb.Blueprint:
    """The image and its neighbours on the left, one tab per colouring on the right; more tabs for documents.

    Args:
        names: names of the encoders, one column each.
        curve: whether there is a training curve.
    """
    clouds = [
        rrb.Grid(
            *(_plane(name, colouring, key) for name in names),
            *(_space(name, colouring) for name in names),
            grid_columns=len(names),
            name=f"by {title}",
        )
        for colouring, (title, key) in COLOURINGS.items()
    ]
    shown = rrb.Vertical(
        rrb.Spatial2DView(origin="/shown", name="frame, and its neighbours in features"),
        rrb.TextDocumentView(origin="/shown/words", name="what they show"),
        row_shares=[3, 2],
    )
    tabs = [
        rrb.Horizontal(shown, rrb.Tabs(*clouds), column_shares=[2, 5], name="features"),
        rrb.TextDocumentView(origin="/about/features", name="in numbers"),
        rrb.Spatial2DView(origin="/about/variance", name="variance explained"),
    ]
    if curve:
        tabs.append(rrb.Spatial2DView(origin="/about/learning", name="training curves"))
    tabs.append(rrb.TextDocumentView(origin="/about/config", name="configuration"))
    tabs.append(rrb.TextDocumentView(origin="/about/lineage", name="lineage"))
    return rrb.Blueprint(
        rrb.Tabs(*tabs),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _contents(name: str, kind: str, colouring: str) -> list[str]:
    return [f"/{name}/{kind}/{part}" for part in (colouring, *_MARKS)]


def _plane(name: str, colouring: str, key: str) -> rrb.Spatial2DView:
    contents = _contents(name, "plane", colouring)
    return rrb.Spatial2DView(origin=f"/{name}/plane", contents=contents, name=f"{name}, PC 1 and 2: {key}")


def _space(name: str, colouring: str) -> rrb.Spatial3DView:
    contents, grid = _contents(name, "space", colouring), rrb.LineGrid3D(visible=False)
    return rrb.Spatial3DView(origin=f"/{name}/space", contents=contents, name=f"{name}, PC 1 to 3", line_grid=grid)
