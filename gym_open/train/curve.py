"""Learning curves: `curve.json`, a table of numbers by name. No times of day: equal runs give equal bytes."""

import math
from collections.abc import Sequence
from pathlib import Path

from gym_open.artefacts import canonical_json
from gym_open.files import write_atomically

CURVE = "curve.json"

Row = list[float | int | None]


def clean(values: Sequence[float]) -> Row:
    """The values as JSON can hold them: not-a-number becomes null."""
    return [None if isinstance(value, float) and math.isnan(value) else value for value in values]


def save_curve(folder: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """Write `curve.json` into `folder`: `{"columns": [...], "rows": [[...], ...]}`."""
    write_atomically(folder / CURVE, canonical_json({"columns": list(columns), "rows": list(rows)}))
