"""What all views share: the `View` itself, colours, timelines and columns, and documents and figures without a time."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from gym_open import plots
from gym_open.envs.constants import CONTROL_DT_S

if TYPE_CHECKING:
    import pyarrow as pa

BLUE, SKY, ORANGE, VERMILION, GREEN, PURPLE, YELLOW = map(
    plots.rgb,
    (plots.BLUE, plots.SKY, plots.ORANGE, plots.VERMILION, plots.GREEN, plots.PURPLE, plots.YELLOW),
)
GREY = (150, 150, 150)
"""Visible on Rerun's dark and light backgrounds."""


class View(NamedTuple):
    """Something to look at in Rerun, not yet read: `viewers` saves it, opens it or serves it."""

    title: str
    """What the recording is called in Rerun's list of recordings."""
    fill: Callable[[rr.RecordingStream], None]
    """Writes everything, in the order in which it is wanted on the screen."""
    blueprint: rrb.Blueprint


def log_document(rec: rr.RecordingStream, entity: str, text: str) -> None:
    """Markdown that is the same at any time."""
    rec.log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def log_figure(rec: rr.RecordingStream, entity: str, png: bytes) -> None:
    """A PNG file that is the same at any time."""
    rec.log(entity, rr.EncodedImage(contents=png, media_type="image/png"), static=True)


def times(steps: Sequence[int] | np.ndarray) -> list[rr.TimeColumn]:
    """Both timelines, `step` and `sim_time`, at these steps."""
    row = np.asarray(steps, dtype=np.int64)
    return [rr.TimeColumn("step", sequence=row), rr.TimeColumn("sim_time", duration=row * CONTROL_DT_S)]


class _Rows:
    """Batches of one component, as one."""

    def __init__(self, batches: Sequence[rr.DescribedComponentBatch]) -> None:
        self.batches = batches

    def as_arrow_array(self) -> "pa.Array":
        import pyarrow as pa

        return pa.concat_arrays([batch.as_arrow_array() for batch in self.batches])


def tensors(rows: Sequence[rr.Tensor | rr.BarChart]) -> list[rr.ComponentColumn]:
    """The column of one or more tensors or bar charts: their own `columns` takes no more than one (Rerun 0.41)."""
    batches = [row.as_component_batches()[0] for row in rows]
    return [rr.ComponentColumn(batches[0].component_descriptor(), _Rows(batches))]
