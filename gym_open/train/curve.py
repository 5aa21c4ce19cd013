"""Learning curves: the table `curve.json`, and on request TensorBoard's event files, to watch a run as it learns."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from gym_open.artefacts import canonical_json
from gym_open.files import write_atomically

CURVE = "curve.json"

Row = list[float | int | None]


def clean(values: Sequence[float]) -> Row:
    """The values as JSON can hold them: not-a-number becomes null."""
    return [None if isinstance(value, float) and math.isnan(value) else value for value in values]


def save_curve(folder: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """Write `curve.json` into `folder`: `{"columns": [...], "rows": [[...], ...]}`.

    It holds no times of day, so that equal runs give equal bytes.
    """
    write_atomically(folder / CURVE, canonical_json({"columns": list(columns), "rows": list(rows)}))


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
