"""What all views share: the record `View`, colours, timelines, columns, and static documents and figures."""

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
    """What Rerun is to show; `viewers` saves it to a file, opens a window or serves a page."""

    title: str
    """Name of the recording in Rerun's list."""
    fill: Callable[[rr.RecordingStream], None]
    """Reads the source and writes the recording, in the order in which the screen needs it."""
    blueprint: rrb.Blueprint
    """Layout of the screen."""


def log_document(rec: rr.RecordingStream, entity: str, text: str) -> None:
    """Log a Markdown document that does not change with time."""
    rec.log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def log_figure(rec: rr.RecordingStream, entity: str, png: bytes) -> None:
    """Log a PNG figure that does not change with time."""
    rec.log(entity, rr.EncodedImage(contents=png, media_type="image/png"), static=True)


def times(steps: Sequence[int] | np.ndarray) -> list[rr.TimeColumn]:
    """Columns of both timelines, `step` and `sim_time`, for these steps."""
    row = np.asarray(steps, dtype=np.int64)
    return [rr.TimeColumn("step", sequence=row), rr.TimeColumn("sim_time", duration=row * CONTROL_DT_S)]


class _JoinedBatches:
    """Batches of one component, joined."""

    def __init__(self, batches: Sequence[rr.DescribedComponentBatch]) -> None:
        self.batches = batches

    def as_arrow_array(self) -> "pa.Array":
        import pyarrow as pa

        return pa.concat_arrays([batch.as_arrow_array() for batch in self.batches])


def tensors(rows: Sequence[rr.Tensor | rr.BarChart]) -> list[rr.ComponentColumn]:
    """A column of one or more tensors or bar charts; their own method `columns` takes only one (Rerun 0.41)."""
    batches = [row.as_component_batches()[0] for row in rows]
    return [rr.ComponentColumn(batches[0].component_descriptor(), _JoinedBatches(batches))]
