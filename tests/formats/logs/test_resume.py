"""Killed writers: the files become those of an uninterrupted writer, however often and wherever it is killed."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gym_open.formats.logs import container as log_container
from gym_open.formats.logs.resume import resume_writer
from gym_open.formats.logs.schemas import LogError, Record, SegmentStart
from gym_open.formats.logs.writer import LogWriter

ROLLS = [1, 20_000, 2**28]
"""One file per keyframe, several files, one file."""


class Saved(NamedTuple):
    """A checkpoint: numbers of records and messages, and the sizes of the files."""

    records: int = 0
    messages: int = 0
    sizes: Mapping[str, int] = MappingProxyType({})


class Run:
    """A run that can be killed and resumed: rollouts of 7 records, and a checkpoint after every second rollout."""

    def __init__(self, folder: Path, made_up: Any, records: list[Record], roll_bytes: int) -> None:
        self.folder, self.aside = folder, folder / "aside"
        self.made_up, self.records, self.roll_bytes = made_up, records, roll_bytes
        self.saved = Saved()

    def open(self) -> LogWriter:
        return resume_writer(
            self.folder, self.aside, self.made_up.head, self.saved.messages, roll_bytes=self.roll_bytes
        )

    def play(self, writer: LogWriter, until: int) -> None:
        for i in range(self.saved.records, until):
            self.made_up.put(writer, self.records[i])
            if i % 7 == 6:
                writer.flush()
            if i % 14 == 13:
                writer.sync()
                sizes = {path.name: path.stat().st_size for path in self.files()}
                self.saved = Saved(i + 1, writer.messages, sizes)

    def kill(self, at: int, left: float) -> None:
        """Run up to record `at`; the last file keeps only the share `left` of its bytes since the checkpoint."""
        writer = self.open()
        self.play(writer, at)
        writer._hand_over()
        writer.abandon()
        last = self.files()[-1]
        safe = self.saved.sizes.get(last.name, 0)
        with last.open("rb+") as file:
            file.truncate(safe + int(left * (last.stat().st_size - safe)))

    def finish(self) -> dict[str, bytes]:
        with self.open() as writer:
            self.play(writer, len(self.records))
        return {path.name: path.read_bytes() for path in self.files()}

    def files(self) -> list[Path]:
        return sorted(self.folder.glob("stream-*.mcap"))


@pytest.fixture(scope="module")
def records(made_up: Any) -> list[Record]:
    return made_up.records(steps=6)


@pytest.fixture(scope="module")
def never_killed(made_up: Any, records: list[Record], tmp_path_factory: pytest.TempPathFactory) -> Any:
    files = {roll: Run(tmp_path_factory.mktemp("log"), made_up, records, roll).finish() for roll in ROLLS}
    assert len(files[1]) > len(files[20_000]) > len(files[2**28]) == 1
    return files


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    st.sampled_from(ROLLS),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=4),
)
def test_killed_anywhere_any_number_of_times(
    made_up: Any, records: list[Record], never_killed: Any, roll: int, kills: list[tuple[float, float]]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), made_up, records, roll)
        for share, left in kills:
            begun = run.saved.records
            run.kill(begun + int(share * (len(records) - begun)), left)
        assert run.finish() == never_killed[roll]


def test_files_before_the_checkpoint_stay_unchanged(
    made_up: Any, records: list[Record], never_killed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither copied nor unpacked."""
    run = Run(tmp_path, made_up, records, 1)
    run.kill(len(records) - 8, 1.0)
    before = {path.name: path.stat() for path in run.files()}
    unpacked = set[str]()

    def noted(path: Path) -> Any:
        unpacked.add(path.name)
        return log_container.chunks(path)

    monkeypatch.setattr("gym_open.formats.logs.resume.chunks", noted)
    run.finish()
    after = {path.name: path.stat() for path in run.files()}
    same = {name for name in before if before[name].st_ino == after[name].st_ino}
    assert len(same) > 5
    assert {name for name in same if before[name].st_mtime_ns != after[name].st_mtime_ns} == set()
    assert unpacked
    assert not unpacked & same


def test_the_longer_of_two_files_is_kept_aside(made_up: Any, records: list[Record], tmp_path: Path) -> None:
    """Killed late, then again earlier: the records of the first writer are compared as well."""
    run = Run(tmp_path, made_up, records, 2**28)
    run.kill(13, 1.0)
    run.kill(4, 1.0)
    run.kill(2, 1.0)
    keyframe = records[5]
    assert isinstance(keyframe, SegmentStart)
    run.records = [*records[:5], msgspec.structs.replace(keyframe, object_state=np.zeros((3, 13))), *records[6:]]
    with pytest.raises(LogError, match=r"message \d+ \(/segment\) differs from the one logged"):
        run.finish()


@pytest.mark.parametrize("left", [0, 100, 9_000])
def test_killed_while_records_before_the_checkpoint_are_copied(
    made_up: Any, records: list[Record], never_killed: Any, tmp_path: Path, left: int
) -> None:
    run = Run(tmp_path, made_up, records, 2**28)
    run.kill(40, 1.0)
    run.open().abandon()
    (path,) = run.files()
    assert path.stat().st_size > 9_000
    with path.open("rb+") as file:
        file.truncate(left)
    assert run.finish() == never_killed[2**28]


def test_files_after_a_damaged_file_are_not_compared(
    made_up: Any, records: list[Record], never_killed: Any, tmp_path: Path
) -> None:
    """They do not continue its undamaged beginning."""
    run = Run(tmp_path, made_up, records, 1)
    run.kill(13, 1.0)
    files = run.files()
    assert len(files) > 3
    with files[1].open("rb+") as file:
        file.truncate(files[1].stat().st_size // 2)
    assert run.finish() == never_killed[1]


def test_a_resume_interrupted_between_two_files_can_be_repeated(
    made_up: Any, records: list[Record], never_killed: Any, tmp_path: Path
) -> None:
    run = Run(tmp_path, made_up, records, 1)
    run.kill(13, 1.0)
    files = run.files()
    assert len(files) > 3
    run.aside.mkdir(exist_ok=True)
    for path in files[1:3]:  # as if it had been killed after moving these
        path.rename(run.aside / path.name)
    assert run.finish() == never_killed[1]


def test_files_of_other_names_stay_where_they_are(
    made_up: Any, records: list[Record], never_killed: Any, tmp_path: Path
) -> None:
    run = Run(tmp_path, made_up, records, 1)
    run.kill(13, 1.0)
    others = ["stream-002-000-repaired.mcap", "stream-002-0000.mcap", "stream-002-new.mcap"]
    for name in others:
        (tmp_path / name).write_text(name)
    made = run.finish()
    assert {name: made.pop(name).decode() for name in others} == {name: name for name in others}
    assert made == never_killed[1]


def test_a_run_that_differs_is_an_error_and_the_old_log_is_kept(
    made_up: Any, records: list[Record], tmp_path: Path
) -> None:
    run = Run(tmp_path, made_up, records, 2**28)
    run.kill(22, 1.0)
    before = run.files()[0].read_bytes()
    run.records = [*records[:16], records[17], *records[16:]]
    with pytest.raises(LogError, match=r"message \d+ .*differs from the one logged before .* the old log is kept"):
        run.finish()
    assert (run.aside / "stream-002-000.mcap").read_bytes() == before


def test_a_log_shorter_than_its_checkpoint_is_an_error(made_up: Any, records: list[Record], tmp_path: Path) -> None:
    run = Run(tmp_path, made_up, records, 2**28)
    run.kill(20, 0.0)
    (path,) = run.files()
    with path.open("rb+") as file:
        file.truncate(path.stat().st_size - 3000)
    with pytest.raises(LogError, match=r"stream 2's log hold \d+ messages, the checkpoint was taken after \d+"):
        run.open()
    with pytest.raises(LogError, match="the checkpoint was taken after 3;"):
        resume_writer(tmp_path, run.aside, made_up.head, 3)  # in the middle of a chunk
