"""Rerun's columns: both timelines, and archetypes of which the library itself sends no more than one at a time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

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
