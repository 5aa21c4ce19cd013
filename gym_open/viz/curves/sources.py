"""Everything below some folders that is a curve, a score, a probe or a report: read, and checked on the way."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.envs.puzzles import PuzzleError
from gym_open.envs.puzzles.sets import locate
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError
from gym_open.formats.scores import EPISODES, RECORD, Scores, read_episodes, read_scores
from gym_open.replay.episodes import puzzle_of
from gym_open.viz.documents import cell

CURVE, PROBE, REPORT, CONFIG = "curve.json", "probe.json", "table.json", artefacts.CONFIG
_READ = frozenset({CURVE, PROBE, REPORT, CONFIG, artefacts.LINEAGE, RECORD, EPISODES})
"""Files whose bytes are checked: those that are read."""
_SKIPPED = ("log", "release", "recording", "figure")
MAX_STEPS = 2**53
"""Steps beyond this are of no training, and not told apart as floating-point numbers."""
_MAX_TARGETS, _MAX_PROBES = 24, 120
"""Drawn of one probe; and drawn of them."""
_HUGE, _HUGE_SCORE = 1e100, 1e6
"""What no loss or return, and no score of a probe, can be; it could not be drawn, either."""
T = TypeVar("T")


def check_steps(steps: Sequence[float | None]) -> None:
    """Raises ValueError unless they can be drawn over: numbers from 0 to `MAX_STEPS`, each greater than the last."""
    known = [step for step in steps if step is not None]
    if len(known) < len(steps):
        raise ValueError("a row has no step")
    if not all(0 <= step <= MAX_STEPS for step in known):
        raise ValueError(f"steps from 0 to {MAX_STEPS} expected, got {min(known)} to {max(known)}")
    if any(after <= before for before, after in pairwise(known)):
        raise ValueError("each step must be greater than the one before")


def check_values(values: Iterable[float], most: float = _HUGE) -> None:
    """Raises ValueError if a value is not finite, or not less than `most` either way."""
    if strange := [value for value in values if not abs(value) < most]:
        raise ValueError(f"numbers within ±{most:g} expected, got {strange[0]!r}")


class Curve(msgspec.Struct, frozen=True):
    """A table of numbers as the training stages write it; the first column is what the others are drawn over."""

    columns: list[str]
    rows: list[list[float | None]]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows) or not self.columns:
            raise ValueError(f"rows of {len(self.columns)} numbers expected, one for each column")
        if len(set(self.columns)) != len(self.columns):
            raise ValueError("two columns of one name")
        check_steps([row[0] for row in self.rows])
        check_values([value for row in self.rows for value in row[1:] if value is not None])

    def known(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Where a column has a number: the first column (n,), and its own (n,)."""
        i = self.columns.index(name)
        points = np.array([(row[0], row[i]) for row in self.rows if row[i] is not None], dtype=np.float64)
        return points.reshape(-1, 2)[:, 0], points.reshape(-1, 2)[:, 1]


class Learned(msgspec.Struct, frozen=True):
    """The training of a policy or of an encoder."""

    kind: str
    """`policy` or `encoder`."""
    group: str
    """What its curve may be compared with: the task of a policy, the world model of an encoder."""
    name: str
    """The agent; of an encoder, its folder."""
    seed: int | None
    curve: Curve


class Scored(msgspec.Struct, frozen=True):
    """One run on the fixed puzzles."""

    record: Scores
    run: str
    """What tells it from other runs of its agent: seed, or player."""
    values: np.ndarray
    """A-Success of each puzzle, (puzzles,)."""
    returns: np.ndarray
    """Return of each within 1…N actions, (puzzles, N)."""
    puzzles: tuple[str, ...]
    """Their ids."""


class Score(msgspec.Struct, frozen=True):
    """A number and its interval of level 95%; None where a single run allows none."""

    value: float
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        known = [number for number in (self.value, self.low, self.high) if number is not None]
        check_values(known, _HUGE_SCORE)


class Target(msgspec.Struct, frozen=True):
    """What one probe found of one target."""

    measure: str
    guess: float
    """Without looking at the picture."""
    scores: dict[str, Score]
    """By kind of features: `trained`, `untrained`, perhaps `pixels`."""
    gain: Score
    """`trained` less `untrained`."""

    def __post_init__(self) -> None:
        check_values([self.guess], _HUGE_SCORE)


class Probed(msgspec.Struct, frozen=True):
    """A probe of one encoder."""

    name: str
    targets: dict[str, Target]


class Report(msgspec.Struct, frozen=True):
    """A report's name, and `table.json`, of which only what is asked for is looked at."""

    name: str
    table: dict[str, Any]


class Found(msgspec.Struct, frozen=True):
    """All that there is to draw."""

    learned: list[Learned] = []
    scored: list[Scored] = []
    probed: list[Probed] = []
    reports: list[Report] = []
    left_out: list[str] = []
    """What was found and not taken, and why, in Markdown."""


def find(sources: Sequence[Path]) -> Found:
    """Everything to draw at or below the sources; folders that are not artefacts are looked through.

    What is damaged is an error if it is a source itself, and else left out and told of. Hidden folders (unfinished
    artefacts) and what a newer artefact has set aside (NAME-1 beside NAME) are passed by.

    Raises:
        ArtefactError: if a source is damaged, or there is nothing to draw.
    """
    found = Found()
    folders = list(dict.fromkeys(path for source in sources for path in _artefacts(source)))
    given = {source.resolve() for source in sources}
    with progress.bar("read curves", len(folders)) as bar:
        for folder in folders:
            try:
                _take(folder, found)
            except ArtefactError as error:
                if folder in given:
                    raise
                found.left_out.append(f"`{cell(folder.name)}`: {cell(error, 400)}")
            bar.advance()
    if not (found.learned or found.scored or found.probed or found.reports):
        names = ", ".join(map(str, sources))
        why = f" ({len(found.left_out)} artefacts are damaged, or of another version)" if found.left_out else ""
        raise ArtefactError(
            f"{names}: nothing to draw here{why}; give encoders, policies, scores, probes, a report, or a folder that "
            "holds some, such as a benchmark's"
        )
    return found


def _artefacts(source: Path) -> Iterator[Path]:
    """Folders with a manifest, at or below the source; none below another, none hidden."""
    if not source.is_dir():
        raise ArtefactError(f"{source}: no such folder; give an artefact, or a folder that holds some")
    for folder, below, files in os.walk(source.resolve()):
        below[:] = [] if artefacts.MANIFEST in files else sorted(name for name in below if not name.startswith("."))
        path = Path(folder)
        if artefacts.MANIFEST in files and not (path != source.resolve() and _is_set_aside(path)):
            yield path


def _is_set_aside(folder: Path) -> bool:
    name, _, number = folder.name.rpartition("-")
    return number.isdecimal() and (folder.parent / name / artefacts.MANIFEST).is_file()


def _take(folder: Path, found: Found) -> None:
    lineage = artefacts.lineage(folder)
    if lineage.kind in _SKIPPED:
        return
    artefacts.verify(folder, hashed=_READ.__contains__)
    facts = lineage.facts
    if lineage.kind == "policy":
        name, seed = str(facts.get("agent", folder.name)), facts.get("seed")
        found.learned.append(Learned("policy", str(facts.get("task")), name, seed, _curve(folder)))
    elif lineage.kind == "encoder":
        found.learned.append(Learned("encoder", str(facts.get("world_model")), folder.name, None, _curve(folder)))
    elif lineage.kind == "scores":
        found.scored.append(_scored(folder, facts))
    elif lineage.kind == "probe":
        targets = _decode(folder / PROBE, lambda record: msgspec.convert(record["targets"], dict[str, Target]))
        _probed(Probed(folder.name, targets), found)
    elif lineage.kind == "report":
        found.reports.append(
            Report(folder.name, _decode(folder / REPORT, lambda table: msgspec.convert(table, dict[str, Any])))
        )


def _probed(probed: Probed, found: Found) -> None:
    name = cell(probed.name)
    if len(found.probed) >= _MAX_PROBES:
        found.left_out.append(f"`{name}`: only {_MAX_PROBES} probes are drawn")
        return
    if (more := len(probed.targets) - _MAX_TARGETS) > 0:
        found.left_out.append(f"`{name}`: {more:,} of its targets, since only {_MAX_TARGETS} are drawn")
    found.probed.append(Probed(probed.name, dict(islice(probed.targets.items(), _MAX_TARGETS))))


def read_curve(folder: Path) -> Curve | None:
    """The training curve of an encoder or policy, or None if there is none.

    Raises:
        ArtefactError: if it is not as the training stages write it.
    """
    return _curve(folder) if (folder / CURVE).is_file() else None


def _curve(folder: Path) -> Curve:
    return _decode(folder / CURVE, lambda record: msgspec.convert(record, Curve))


def _scored(folder: Path, facts: dict[str, Any]) -> Scored:
    record = read_scores(folder)
    episodes = sorted(read_episodes(folder), key=lambda row: row["puzzle"])
    try:
        _check_episodes(folder / EPISODES, record, episodes)
    except (PuzzleError, ValueError) as error:
        raise ArtefactError(f"{folder}: not scores as gym-open writes them: {error}; evaluate again") from None
    rewards = np.zeros((len(episodes), step_budget(record.task)))
    for i, row in enumerate(episodes):
        rewards[i, : len(row["rewards"])] = row["rewards"]
    values, run = np.array([row["a_success"] for row in episodes]), str(facts.get("player") or record.seed or 0)
    return Scored(record, run, values, np.cumsum(rewards, axis=1), tuple(row["puzzle"] for row in episodes))


def _check_episodes(file: Path, record: Scores, rows: list[dict[str, Any]]) -> None:
    """Raises if the rows are not of different puzzles of the record's set, each of which could have been played."""
    check_steps([record.trained])
    if len(record.mean_return_within) != (budget := step_budget(record.task)):
        raise ValueError(f"`mean_return_within`: {budget} numbers expected, got {len(record.mean_return_within)}")
    ids = [row["puzzle"] for row in rows]
    if not rows or len(set(ids)) < len(ids):
        raise ValueError("one episode for each puzzle expected, and at least one")
    for row in rows:
        if locate(row["puzzle"])[1] != record.split:
            raise ValueError(f"puzzle {row['puzzle']} is not of the split {record.split!r}")
        puzzle_of(file, record, row)
        check_values([row["a_success"], *row["rewards"]])


def _decode(path: Path, convert: Callable[[Any], T]) -> T:
    try:
        return convert(msgspec.json.decode(path.read_bytes()))
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError, KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; make the artefact again") from None
