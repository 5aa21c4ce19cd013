"""Learning curves: the table `curve.json`, and on request event files for TensorBoard."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from gym_open.artefacts import canonical_json
from gym_open.files import write_atomically

CURVE = "curve.json"

Row = list[float | int | None]


def clean(values: Sequence[float]) -> Row:
    """Make values fit for JSON: not-a-number becomes None."""
    return [None if isinstance(value, float) and math.isnan(value) else value for value in values]


def save_curve(folder: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """Write `curve.json` into `folder`: `{"columns": [...], "rows": [[...], ...]}`.

    It holds no times of day, so that equal runs give equal bytes.
    """
    write_atomically(folder / CURVE, canonical_json({"columns": list(columns), "rows": list(rows)}))


class Board:
    """Writes scalars to event files in a folder, or nowhere.

    Event files hold times of day, so they never belong to an artefact.

    Args:
        folder: is created if it is missing; None writes nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._writer = None
        if folder is not None:
            from torch.utils.tensorboard.writer import SummaryWriter

            self._writer = SummaryWriter(str(folder))

    def row(self, step: int, values: Mapping[str, float | None]) -> None:
        """Write `values` by name at `step`. A value that is None or not a number is left out."""
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
