"""Records of numbers that reports and figures share, and the files `curve.json` and `probe.json` that hold some.

The constructors refuse numbers that cannot be true or cannot be drawn, since the files may come from anyone.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts
from gym_open.artefacts import Lineage
from gym_open.errors import ArtefactError

CURVE, PROBE = "curve.json", "probe.json"
_MAX_STEPS = 2**53
"""No training has more steps; above this number, floating-point numbers cannot separate two steps."""
_HUGE, _HUGE_ESTIMATE = 1e100, 1e6
"""No loss or return, and no score, is this large; it could not be drawn either."""


def check_steps(steps: Sequence[float | None]) -> None:
    """Check numbers of steps: each from 0 to 2**53 and greater than the one before.

    Raises:
        ValueError: if they are not.
    """
    known = [step for step in steps if step is not None]
    if len(known) < len(steps):
        raise ValueError("a row has no step")
    if not all(0 <= step <= _MAX_STEPS for step in known):
        raise ValueError(f"steps from 0 to {_MAX_STEPS} expected, got {min(known)} to {max(known)}")
    if any(after <= before for before, after in pairwise(known)):
        raise ValueError("each step must be greater than the one before")


def check_values(values: Iterable[float], most: float = _HUGE) -> None:
    """Check that values are finite and between −`most` and `most`.

    Raises:
        ValueError: if one is not.
    """
    if strange := [value for value in values if not abs(value) < most]:
        raise ValueError(f"numbers within ±{most:g} expected, got {strange[0]!r}")


class Estimate(msgspec.Struct, frozen=True):
    """A number and its interval; both ends are None if a single run allows no interval."""

    value: float
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        known = [number for number in (self.value, self.low, self.high) if number is not None]
        check_values(known, _HUGE_ESTIMATE)


class IntervalCurve(msgspec.Struct, frozen=True):
    """A curve and its interval, point by point."""

    x: list[int]
    value: list[float]
    low: list[float]
    high: list[float]

    def __post_init__(self) -> None:
        if len({len(self.x), len(self.value), len(self.low), len(self.high)}) != 1 or not self.x:
            raise ValueError("`x`, `value`, `low` and `high` must have the same length, at least one")
        check_steps(self.x)
        check_values([*self.value, *self.low, *self.high])


class TrainingCurve(msgspec.Struct, frozen=True):
    """The table in `curve.json`, as the training stages write it; the first column is the x-axis of all others."""

    columns: list[str]
    rows: list[list[float | None]]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows) or not self.columns:
            raise ValueError(f"rows of {len(self.columns)} numbers expected, one for each column")
        if len(set(self.columns)) != len(self.columns):
            raise ValueError("two columns have the same name")
        check_steps([row[0] for row in self.rows])
        check_values([value for row in self.rows for value in row[1:] if value is not None])

    def known(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the points where a column has a number: the first column (n,), and the column itself (n,)."""
        i = self.columns.index(name)
        points = np.array([(row[0], row[i]) for row in self.rows if row[i] is not None], dtype=np.float64)
        return points.reshape(-1, 2)[:, 0], points.reshape(-1, 2)[:, 1]


def read_curve(folder: Path) -> TrainingCurve | None:
    """Read the training curve of an encoder or policy; return None if the folder has none.

    Raises:
        ArtefactError: if the file is not as the training stages write it.
    """
    path = folder / CURVE
    return _read(path, TrainingCurve, "make the artefact again") if path.is_file() else None


class ProbeTarget(msgspec.Struct, frozen=True):
    """What a probe found for one target."""

    measure: str
    guess: float
    """Score of a guess without the image."""
    scores: dict[str, Estimate]
    """By kind of features: `trained`, `untrained`, and perhaps `pixels`."""
    gain: Estimate
    """`trained` minus `untrained`."""

    def __post_init__(self) -> None:
        check_values([self.guess], _HUGE_ESTIMATE)


class ProbeRecord(msgspec.Struct, frozen=True):
    """One probe artefact."""

    folder: Path
    digest: str
    lineage: Lineage
    targets: dict[str, ProbeTarget]


class _ProbeFile(msgspec.Struct, frozen=True):
    targets: dict[str, ProbeTarget]


def read_probe(folder: Path) -> ProbeRecord:
    """Check every byte of a probe artefact, and read it.

    Raises:
        ArtefactError: if it is damaged, or its record is not as `gym-open train probe` writes it.
    """
    digest = artefacts.verify(folder, "probe")
    record = _read(folder / PROBE, _ProbeFile, "probe the encoder again")
    return ProbeRecord(folder, digest, artefacts.lineage(folder), record.targets)


def _read(path: Path, kind: Any, remedy: str) -> Any:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; {remedy}") from None
