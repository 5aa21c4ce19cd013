"""Whoever changes a compact release and makes its manifest anew is caught: by a row, or by the simulation."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open import artefacts
from gym_open.datasets.compact import check
from gym_open.datasets.compact.restore import restore_release
from gym_open.datasets.verify import compact as verification
from gym_open.datasets.verify import verify_release
from gym_open.errors import ArtefactError
from gym_open.files import sha256_file
from gym_open.formats.compact import open_compact
from gym_open.formats.compact.files import NumberReader, NumberWriter, read_rows, write_rows
from gym_open.formats.compact.layout import (
    ACTIONS,
    EPISODES,
    INFO,
    LOSSES,
    RELEASE,
    STATES,
    STREAMS,
    SWITCHES,
    WORLDS,
    CompactInfo,
    EpisodeRow,
    StateRow,
    StreamRow,
    SwitchRow,
    WorldRow,
)

Change = Callable[[Path], None]


def seal(root: Path) -> None:
    names = {path.relative_to(root).as_posix(): path for path in root.rglob("*") if path.is_file()}
    names.pop(artefacts.MANIFEST)
    entries = {name: artefacts.Entry(sha256_file(path), path.stat().st_size) for name, path in names.items()}
    (root / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(entries))


def rows_changed(file: str, kind: Any, change: Callable[[list[Any]], list[Any]]) -> Change:
    def apply(root: Path) -> None:
        write_rows(root / file, change(list(read_rows(root / file, kind))))

    return apply


def numbers_changed(file: str, kind: type[np.generic], change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def apply(root: Path) -> None:
        compact = open_compact(root)
        total = sum(row.losses for row in compact.switches) if file == LOSSES else compact.info.steps
        with NumberReader(root / file, kind, total) as reader:
            values = change(reader.take(total).copy())
        with NumberWriter(root / file, kind) as writer:
            writer.add(values)

    return apply


def one(number: int, **fields: Any) -> Callable[[list[Any]], list[Any]]:
    return lambda rows: [msgspec.structs.replace(row, **fields) if i == number else row for i, row in enumerate(rows)]


def bumped(values: np.ndarray) -> np.ndarray:
    values[-1] += 1
    return values


def info_changed(**fields: Any) -> Change:
    def apply(root: Path) -> None:
        info = msgspec.json.decode((root / INFO).read_bytes(), type=CompactInfo)
        (root / INFO).write_bytes(artefacts.canonical_json(msgspec.structs.replace(info, **fields)))

    return apply


def other_world(rows: list[WorldRow]) -> list[WorldRow]:
    """Two layouts change places."""
    return [WorldRow(rows[1].puzzle, rows[0].places), WorldRow(rows[0].puzzle, rows[1].places), *rows[2:]]


def file_added(name: str, data: bytes) -> Change:
    def apply(root: Path) -> None:
        (root / name).parent.mkdir(exist_ok=True, parents=True)
        (root / name).write_bytes(data)

    return apply


CAUGHT_BY_ROWS = {
    "an episode less": rows_changed(EPISODES, EpisodeRow, lambda rows: rows[:-1]),
    "episodes out of order": rows_changed(EPISODES, EpisodeRow, lambda rows: rows[::-1]),
    "an episode twice": rows_changed(EPISODES, EpisodeRow, lambda rows: [rows[0], *rows[:-1]]),
    "no such stream": rows_changed(EPISODES, EpisodeRow, one(0, stream=99)),
    "no such world": rows_changed(EPISODES, EpisodeRow, one(0, world=99)),
    "too long": rows_changed(EPISODES, EpisodeRow, one(0, steps=13)),
    "a keyframe after the end": rows_changed(EPISODES, EpisodeRow, one(0, keyframes=[0, 13])),
    "keyframes out of order": rows_changed(EPISODES, EpisodeRow, one(0, keyframes=[8, 0])),
    "nothing before it": rows_changed(EPISODES, EpisodeRow, one(0, start="world")),
    "a state that is not there": rows_changed(EPISODES, EpisodeRow, one(0, start="state")),
    "a state too many": lambda root: write_rows(root / STATES, [StateRow([0.0])]),
    "an unknown batch": rows_changed(STREAMS, StreamRow, one(0, batch=3)),
    "no puzzle": rows_changed(WORLDS, WorldRow, one(0, puzzle="{}")),
    "another version": info_changed(version="9.0.0"),
    "another release": info_changed(release="0" * 64),
    "other columns": info_changed(columns=[]),
    "other steps": info_changed(steps=1),
    "another format": info_changed(format="gym-open-compact/9"),
    "a stranger's file": file_added("install.sh", b"#!"),
    "a stranger's document": file_added(f"{RELEASE}README.md", b"# other"),
    "a changed description": file_added(f"{RELEASE}meta/info.json", b"{}"),
}
CAUGHT_BY_SIMULATION = {
    "an action": numbers_changed(ACTIONS, np.uint8, lambda values: bumped(values) % 9),
    "no action": numbers_changed(ACTIONS, np.uint8, lambda values: np.full_like(values, 9)),
    "an intrinsic reward": numbers_changed("columns/reward.intrinsic.zst", np.float32, bumped),
    "a loss of a world": numbers_changed(LOSSES, np.float64, bumped),
    "a world": rows_changed(WORLDS, WorldRow, other_world),
    "a keyframe": rows_changed(EPISODES, EpisodeRow, one(0, keyframes=[0])),
    "a digest": rows_changed(EPISODES, EpisodeRow, one(3, digest="0" * 64)),
    "a reason": rows_changed(EPISODES, EpisodeRow, one(3, ended="budget")),
    "a split": rows_changed(EPISODES, EpisodeRow, one(0, continued=True)),
    "a start": rows_changed(EPISODES, EpisodeRow, lambda rows: one(
        next(i for i, row in enumerate(rows) if row.start == "world"), start="layout")(rows)),
    "a switch": rows_changed(SWITCHES, SwitchRow, one(1, reason="learned")),
    "a seed": rows_changed(STREAMS, StreamRow, one(0, seed="7")),
}  # fmt: skip


RESTORED = ("an action", "an intrinsic reward", "a world", "a switch")


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """A child takes seconds to start."""
    monkeypatch.setattr(verification, "_simulate_apart", lambda root: check.check_frames(open_compact(root)))


@pytest.mark.usefixtures("in_this_process")
def test_an_unchanged_copy_is_verified(copy: Path) -> None:
    seal(copy)
    report = verify_release(copy)
    assert report.problems == []
    assert report.verdict.startswith("verified: open/both 1.0.0")
    assert report.content == open_compact(copy).info.content


@pytest.mark.parametrize("name", CAUGHT_BY_ROWS)
@pytest.mark.usefixtures("in_this_process")
def test_rows_that_contradict_others_are_refused(copy: Path, name: str) -> None:
    CAUGHT_BY_ROWS[name](copy)
    seal(copy)
    with pytest.raises(ArtefactError):
        open_compact(copy)
    assert verify_release(copy).problems


@pytest.mark.parametrize("name", CAUGHT_BY_SIMULATION)
@pytest.mark.usefixtures("in_this_process")
def test_what_is_simulated_otherwise_is_refused(copy: Path, tmp_path: Path, name: str) -> None:
    CAUGHT_BY_SIMULATION[name](copy)
    seal(copy)
    report = verify_release(copy)
    assert [problem.what for problem in report.problems], name
    assert "NOT verified" in report.verdict
    if name in RESTORED:  # the others are caught by the same comparisons
        with pytest.raises(ArtefactError):
            restore_release(copy, tmp_path / "back", workers=1)
        assert not (tmp_path / "back").exists()


def test_a_child_simulates(copy: Path) -> None:
    CAUGHT_BY_SIMULATION["an action"](copy)
    seal(copy)
    (problem,) = verify_release(copy).problems
    assert "what is simulated is not what was packed" in problem.what


@pytest.mark.parametrize("name", ["actions.zst", "episodes.jsonl.zst", "columns/policy.value.zst", "release/LICENSE"])
def test_damage_is_named(copy: Path, name: str) -> None:
    data = bytearray((copy / name).read_bytes())
    data[len(data) // 2] ^= 64
    (copy / name).write_bytes(data)
    with pytest.raises(ArtefactError, match=name):
        open_compact(copy)
    shutil.rmtree(copy / "columns")
    assert verify_release(copy, replay=False).problems
