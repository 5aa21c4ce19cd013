"""Writing a log: nothing is lost, and the bytes depend neither on time nor on the folder."""

import random
import resource
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open.formats.logs import mcap as log_mcap
from gym_open.formats.logs import parts as log_parts
from gym_open.formats.logs import schemas as log_schemas
from gym_open.formats.logs import writer as log_writer
from gym_open.formats.logs.container import LogMessage, read_contents, whole_chunks
from gym_open.formats.logs.messages import messages_of
from gym_open.formats.logs.resume import resume_writer
from gym_open.formats.logs.schemas import LogError, Record, SegmentStart, StepMetrics, StepRecord
from gym_open.formats.logs.writer import LogWriter
from tests.children import until


def read(paths: list[Path]) -> list[LogMessage]:
    return [message for path in paths for chunk in whole_chunks(path) for message in chunk]


def expected(made_up: Any, records: list[Record]) -> list[LogMessage]:
    return [message for record in records for message in messages_of(record, made_up.head.reward_parts)]


def noisy(records: list[Record]) -> list[Record]:
    """The same with images of noise, which take 21 kB each on disk."""
    rng = np.random.default_rng(1)
    return [
        msgspec.structs.replace(record, image=rng.integers(0, 256, (84, 84, 3), np.uint8))
        if isinstance(record, (SegmentStart, StepRecord))
        else record
        for record in records
    ]


@pytest.mark.parametrize("all_images", [False, True])
def test_messages_stand_in_the_order_of_the_records(made_up: Any, tmp_path: Path, all_images: bool) -> None:
    records = made_up.records(all_images=all_images)
    assert read(made_up.write(tmp_path, records)) == expected(made_up, records)


def test_bytes_repeat_in_another_folder(made_up: Any, tmp_path: Path) -> None:
    files = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        (tmp_path / name).mkdir()
        files.append(made_up.write(tmp_path / name, made_up.records(seed))[0].read_bytes())
    assert files[0] == files[1] != files[2]


@pytest.mark.parametrize(("batch", "queue"), [(1, 1), (3, 2), (7, 1)])
def test_bytes_do_not_depend_on_timing(
    made_up: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batch: int, queue: int
) -> None:
    """Neither the order in which the threads run nor the size of a batch matters."""
    records = made_up.records(steps=3)
    for name in ("plain", "hampered"):
        (tmp_path / name).mkdir()
    plain = made_up.write(tmp_path / "plain", records, roll_bytes=9_000)
    rng = random.Random(batch)
    add, put = log_parts.LogParts.add, made_up.put

    def slow_add(files: log_parts.LogParts, record: Record) -> None:
        time.sleep(rng.choice([0, 0, 0.0005]))
        add(files, record)

    def slow_put(writer: LogWriter, record: Record) -> None:
        time.sleep(rng.choice([0, 0, 0.0005]))
        put(writer, record)

    monkeypatch.setattr(log_parts.LogParts, "add", slow_add)
    monkeypatch.setattr(made_up, "put", slow_put)
    monkeypatch.setattr(log_writer, "BATCH", batch)
    monkeypatch.setattr(log_writer, "QUEUE", queue)
    hampered = made_up.write(tmp_path / "hampered", records, roll_bytes=9_000)
    assert len(plain) > 1
    assert [path.name for path in hampered] == [path.name for path in plain]
    assert [path.read_bytes() for path in hampered] == [path.read_bytes() for path in plain]


def test_a_slow_disk_makes_the_caller_wait_and_loses_nothing(
    made_up: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_writer, "BATCH", 2)
    monkeypatch.setattr(log_writer, "QUEUE", 3)
    works_again = threading.Event()
    write = log_mcap.McapWriter.message

    def stalled(*arguments: Any) -> None:
        works_again.wait()
        write(*arguments)

    class Watched(Queue):
        def put(self, *arguments: Any, **options: Any) -> None:
            nonlocal waits
            waits = self.full()  # no thread takes from it yet
            super().put(*arguments, **options)

    monkeypatch.setattr(log_mcap.McapWriter, "message", stalled)
    monkeypatch.setattr(log_writer, "Queue", Watched)
    records, taken, waits = made_up.records(steps=3), list[Record](), False

    def play() -> None:
        with LogWriter(tmp_path, made_up.head) as writer:
            for record in records:
                made_up.put(writer, record)
                taken.append(record)

    player = threading.Thread(target=play, daemon=True)
    player.start()
    until(lambda: waits or not player.is_alive())
    before = len(taken)
    works_again.set()
    player.join()
    assert 0 < before <= 2 * (1 + 3 + 1)  # one batch being written, three waiting, one being enqueued
    assert read(sorted(tmp_path.iterdir())) == expected(made_up, records)


def test_an_error_of_the_thread_reaches_the_caller_unchanged(made_up: Any, tmp_path: Path) -> None:
    records = made_up.records()
    bad = msgspec.structs.replace(records[2], image=np.zeros((4, 4, 3), np.uint8))
    writer = LogWriter(tmp_path, made_up.head)
    for record in (*records[:2], bad):
        made_up.put(writer, record)
    with pytest.raises(ValueError, match=r"expected an image of uint8 \(84, 84, 3\), got uint8 \(4, 4, 3\)") as caught:
        writer.sync()
    for call in (lambda: made_up.put(writer, records[3]), writer.flush, writer.close):
        with pytest.raises(ValueError, match="expected an image") as again:
            call()
        assert again.value is caught.value
    assert not writer._thread.is_alive()


def test_parts_of_a_reward_must_be_those_of_the_head(made_up: Any, tmp_path: Path) -> None:
    step = next(record for record in made_up.records() if isinstance(record, StepRecord))
    with (
        pytest.raises(ValueError, match=r"step 0: expected 2 reward parts \(forward, inverse\), got 1"),
        LogWriter(tmp_path, made_up.head) as writer,
    ):
        writer.step(msgspec.structs.replace(step, metrics=StepMetrics(reward_parts=(1.0,))))


class KilledError(Exception):
    """Stands for any error that ends the exploration."""


def test_a_writer_that_an_error_passes_through_writes_no_index(made_up: Any, tmp_path: Path) -> None:
    records = made_up.records()

    def play() -> None:
        with LogWriter(tmp_path, made_up.head) as writer:
            for record in records[:-1]:
                made_up.put(writer, record)
            writer.sync()
            assert writer.messages == len(expected(made_up, records[:-1]))
            raise KilledError

    with pytest.raises(KilledError):
        play()
    (path,) = tmp_path.iterdir()
    assert read([path]) == expected(made_up, records[:-1])
    assert not path.read_bytes().endswith(b"MCAP0\r\n")


def test_a_closed_writer_can_be_closed_again(made_up: Any, tmp_path: Path) -> None:
    with LogWriter(tmp_path, made_up.head) as writer:
        for record in made_up.records():
            made_up.put(writer, record)
        writer.close()
        before = (tmp_path / "stream-002-000.mcap").read_bytes()
    assert (tmp_path / "stream-002-000.mcap").read_bytes() == before


@pytest.mark.parametrize("roll_bytes", [1, 30_000, 100_000])
def test_after_a_large_file_the_next_one_begins_at_a_keyframe(made_up: Any, tmp_path: Path, roll_bytes: int) -> None:
    records = noisy(made_up.records(steps=4))
    paths = made_up.write(tmp_path, records, roll_bytes=roll_bytes)
    assert len(paths) > 2
    assert [path.name for path in paths] == [f"stream-002-{part:03d}.mcap" for part in range(len(paths))]
    assert read(paths) == expected(made_up, records)
    for part, path in enumerate(paths):
        contents, last = read_contents(path), part + 1 == len(paths)
        assert contents.metadata["gym-open"]["part"] == str(part)
        assert contents.metadata.get("continues") == (None if last else {"part": str(part + 1)})
        assert set(contents.attachments) == {"config.json", "model.xml", "puzzles.json"}
        assert last or path.stat().st_size >= roll_bytes
        assert last or path.read_bytes().index(b"continues") > contents.chunks[-1].offset
        assert read([path])[0].topic == (log_schemas.SWITCH if part == 0 else log_schemas.SEGMENT)


def test_the_next_file_begins_when_complete_chunks_reach_the_size(made_up: Any, tmp_path: Path) -> None:
    """A chunk ends at every switch here, so the first two are on the disk when the second segment begins."""
    records = noisy(made_up.records(steps=4))
    for name in ("whole", "just", "not"):
        (tmp_path / name).mkdir()
    (whole,) = made_up.write(tmp_path / "whole", records)
    written = read_contents(whole).chunks[2].offset
    first_segment = next(i for i, record in enumerate(records) if getattr(record, "reason", None) == "learned") + 1
    just = made_up.write(tmp_path / "just", records, roll_bytes=written)
    assert read(just[:1]) == expected(made_up, records[:first_segment])
    later = made_up.write(tmp_path / "not", records, roll_bytes=written + 1)
    assert len(read(later[:1])) > len(read(just[:1]))


@pytest.fixture
def disk() -> Iterator[Callable[[int], None]]:
    """`disk(size)` limits the files of this process to that many bytes, like a full disk."""
    usual, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (usual, most))


def test_a_full_disk_is_a_clear_error_and_the_log_continues_when_there_is_room(
    made_up: Any, tmp_path: Path, disk: Callable[[int], None]
) -> None:
    """All complete chunks can be read, and a writer that continues from there ends with the intended log."""
    records = noisy(made_up.records(steps=4))

    def play(writer: LogWriter, todo: list[Record]) -> None:
        with writer:
            for record in todo:
                made_up.put(writer, record)
                writer.flush()

    disk(200_000)
    with pytest.raises(
        LogError, match=r"stream-002-000\.mcap: cannot be written \(File too large\).*make room, then run"
    ):
        play(LogWriter(tmp_path, made_up.head), records)
    (path,) = tmp_path.iterdir()
    meant, saved = expected(made_up, records), read([path])
    assert 10 < len(saved) < len(meant)
    assert saved == meant[: len(saved)]
    disk(10**9)
    checkpoint = next(i for i in range(len(records)) if len(expected(made_up, records[:i])) > len(saved) - 5)
    messages = len(expected(made_up, records[:checkpoint]))
    play(resume_writer(tmp_path, tmp_path / "aside", made_up.head, messages), records[checkpoint:])
    assert read([path]) == meant


def test_a_disk_without_room_for_the_head_is_a_clear_error(made_up: Any, tmp_path: Path) -> None:
    (tmp_path / "stream-002-000.mcap").symlink_to("/dev/full")
    with (
        pytest.raises(LogError, match=r"cannot be written \(No space left on device\)"),
        LogWriter(tmp_path, made_up.head) as writer,
    ):
        writer.sync()
