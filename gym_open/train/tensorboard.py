"""Event files for TensorBoard, for whoever wants to look on while something learns."""

import math
from collections.abc import Mapping
from pathlib import Path


class Board:
    """Scalars as they come, in event files of a folder; without a folder nothing is written.

    Event files hold times of day, so they never go into an artefact.

    Args:
        folder: made if it is missing; None for nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._writer = None
        if folder is not None:
            from torch.utils.tensorboard.writer import SummaryWriter

            self._writer = SummaryWriter(str(folder))

    def row(self, step: int, values: Mapping[str, float | None]) -> None:
        """Write `values` by name at `step`; what is None, or not a number, is left out."""
        if self._writer is None:
            return
        for name, value in values.items():
            if value is not None and not math.isnan(value):
                self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()
