"""Reading part of a log: requested steps, and the undamaged beginning of a damaged log."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.opcode import Opcode

from gym_open.formats.logs import LogWriter, Segment, SegmentStart, StepRecord, Stuck, Switch, open_log, open_whole_part
from gym_open.formats.logs import logfile as module
from gym_open.formats.logs import mcap as log_mcap
from gym_open.formats.logs.container import read_contents
from gym_open.formats.logs.messages import messages_of
from gym_open.formats.logs.repair import repair
from gym_open.formats.logs.schemas import LogError


@pytest.fixture(scope="module")
def chunked(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of 27 steps with a chunk every 5 records."""
    folder = tmp_path_factory.mktemp("log")
    with LogWriter(folder, made_up.head) as log:
        for number, record in enumerate(made_up.records(all_images=True, steps=3)):
            {SegmentStart: log.segment, StepRecord: log.step, Switch: log.switch, Stuck: log.stuck}[type(record)](
                record
            )
            if number % 5 == 4:
                log.flush()
    return next(folder.glob("*.mcap"))


def by_step(pieces: Iterator[Segment]) -> dict[int, tuple[Any, ...]]:
    """What each step holds, by its number."""
    found: dict[int, tuple[Any, ...]] = {}
    for item in pieces:
        for i, action in enumerate(item.actions.tolist()):
            seen = tuple(
                array[i + 1].tobytes() for array in (item.images, item.depth, item.object_state) if array is not None
            )
            found[item.first_step + i] = (action, item.world, item.index, item.contacts[i], seen)
    return found


@pytest.mark.parametrize("max_steps", [None, 2])
@pytest.mark.parametrize("steps", [range(1), range(11, 12), range(5, 13), range(12, 21), range(20, 99), range(27)])
def test_only_requested_steps_are_read(chunked: Path, steps: range, max_steps: int | None) -> None:
    log = open_log(chunked)
    every = by_step(log.segments())
    found = by_step(log.segments(max_steps, steps))
    assert {step: found[step] for step in steps if step < 27} == {step: every[step] for step in steps if step < 27}
    assert all(every[step] == value for step, value in found.items())
    assert min(found) > steps.start - 2  # a keyframe every two steps
    assert max(found) < steps.stop


def test_other_chunks_are_not_unpacked(chunked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, total = open_log(chunked), len(read_contents(chunked).chunks)
    unpacked: list[int] = []
    real = module.read_chunk

    def counted(path: Path, place: Any, topics: Any) -> Any:
        unpacked.append(place.offset)
        return real(path, place, topics)

    monkeypatch.setattr(module, "read_chunk", counted)
    assert 20 in by_step(log.segments(None, range(20, 21)))
    assert total > 8
    assert len(set(unpacked)) <= 4


def test_steps_of_a_later_part_do_not_open_the_ones_before(
    made_up: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = made_up.write(tmp_path, made_up.records(steps=3), roll_bytes=1)
    log, opened = open_log(parts), set()
    real = module.read_chunk
    monkeypatch.setattr(
        module, "read_chunk", lambda path, place, topics: (opened.add(path), real(path, place, topics))[1]
    )
    assert 20 in by_step(log.segments(None, range(20, 21)))
    assert len(opened) <= 3 < len(parts)


@pytest.mark.parametrize("share", [0.35, 0.5, 0.8, 0.97])
def test_a_log_that_is_cut_off_is_read_up_to_there(chunked: Path, share: float, tmp_path: Path) -> None:
    """`log repair` finds the undamaged beginning in another way."""
    cut = tmp_path / "stream-002-000.mcap"
    raw = chunked.read_bytes()
    cut.write_bytes(raw[: int(share * len(raw))])
    log = open_whole_part([cut])
    fixed = repair(cut)
    assert fixed.saved is not None
    saved = open_log(fixed.saved)
    assert by_step(log.segments()) == by_step(saved.segments())
    assert (log.n_steps, log.stuck) == (fixed.steps, saved.stuck)
    assert log.switches == saved.switches[: len(log.switches)]
    assert log.damage is not None
    assert f"byte {fixed.offset:,}" in log.damage


def test_changed_bytes_end_a_log_before_them(chunked: Path, tmp_path: Path) -> None:
    raw, place = bytearray(chunked.read_bytes()), read_contents(chunked).chunks[5]
    raw[place.offset + 60] ^= 1
    changed = tmp_path / "stream-002-000.mcap"
    changed.write_bytes(raw)
    log = open_whole_part([changed])
    assert log.damage is not None
    assert f"byte {place.offset:,}" in log.damage
    found, every = by_step(log.segments()), by_step(open_log(chunked).segments())
    assert 0 < len(found) == log.n_steps < 27
    assert found == {step: every[step] for step in range(len(found))}


def end_of_chunk(raw: bytes, offset: int) -> int:
    """Offset of the first byte after the record at `offset`; the index of a chunk follows there."""
    return offset + 9 + struct.unpack_from("<Q", raw, offset + 1)[0]


def test_an_incomplete_step_is_not_read(made_up: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks also end between the messages of a step, and a cut may leave a chunk without its index."""
    monkeypatch.setattr(log_mcap, "CHUNK_BYTES", 110_000)
    records = made_up.records(all_images=True, steps=2)
    (path,) = made_up.write(tmp_path, records)
    raw, every, places = path.read_bytes(), by_step(open_log(path).segments()), read_contents(path).chunks
    ends = np.cumsum([len(list(messages_of(record, made_up.head.reward_parts))) for record in records])
    steps = [
        (begin, end)
        for record, begin, end in zip(records, [0, *ends], ends, strict=False)
        if isinstance(record, StepRecord)
    ]
    held, torn = sum(places[0].counts.values()), 0
    for place in places[1:]:
        held += sum(place.counts.values())
        path.write_bytes(raw[: end_of_chunk(raw, place.offset)])
        log, whole = open_whole_part([path]), sum(end <= held for _, end in steps)
        assert log.n_steps == whole
        assert by_step(log.segments()) == {step: every[step] for step in range(whole)}
        torn += sum(begin < held < end for begin, end in steps)
    assert torn > 3


def test_a_damaged_index_of_a_chunk_is_not_used(chunked: Path, tmp_path: Path) -> None:
    """Only the checksum of the whole file shows the damage; the messages are undamaged."""
    raw, log, places = chunked.read_bytes(), open_log(chunked), read_contents(chunked).chunks
    changed, at, tried = tmp_path / "stream-002-000.mcap", end_of_chunk(raw, places[3].offset), 0
    while raw[at] == Opcode.MESSAGE_INDEX:
        other_channel = bytes([raw[at + 9] ^ 1])
        changed.write_bytes(raw[: at + 9] + other_channel + raw[at + 10 :])
        found = open_whole_part([changed])
        assert found.damage is not None
        assert (found.n_steps, found.switches, found.stuck) == (27, log.switches, log.stuck)
        at, tried = end_of_chunk(raw, at), tried + 1
    assert tried > 3


def test_a_whole_log_is_not_damaged(chunked: Path) -> None:
    log = open_whole_part([chunked])
    assert log.damage is None
    assert by_step(log.segments()) == by_step(open_log(chunked).segments())


def test_what_comes_before_a_missing_part_is_read(made_up: Any, tmp_path: Path) -> None:
    parts = made_up.write(tmp_path, made_up.records(steps=3), roll_bytes=1)
    every = by_step(open_log(parts).segments())
    before = open_whole_part([*parts[:2], *parts[3:]])
    assert before.damage is not None
    assert "missing" in before.damage
    found = by_step(before.segments())
    assert found == {step: every[step] for step in range(before.n_steps)}
    last = open_whole_part(parts[:2])
    assert last.damage == f"{parts[2].name}, in which it continues, is missing"
    assert open_whole_part([parts[2]]).damage is None  # a single part needs no other part


def test_a_part_of_another_run_is_not_read(made_up: Any, tmp_path: Path) -> None:
    """Although it has the right number."""
    stranger = type(made_up)()
    stranger.head = msgspec.structs.replace(made_up.head, provenance={"code": "other"})
    for folder in (tmp_path / "own", tmp_path / "other"):
        folder.mkdir()
    first, *_ = made_up.write(tmp_path / "own", made_up.records(steps=3), roll_bytes=1)
    _, *others = stranger.write(tmp_path / "other", made_up.records(steps=3), roll_bytes=1)
    log = open_whole_part([first, *others])
    assert log.damage == f"the next part is missing: {others[0].name} is part 1, of this or another run"
    assert by_step(log.segments()) == by_step(open_log(first).segments())


def test_a_log_without_its_end_says_so(made_up: Any, tmp_path: Path) -> None:
    parts = made_up.write(tmp_path, made_up.records(steps=3)[:-1])
    log = open_whole_part(parts)
    assert log.damage == "it has no last switch: its writer did not finish"
    assert len(by_step(log.segments())) == log.n_steps == 27


def test_a_log_without_an_undamaged_beginning_is_refused(chunked: Path, tmp_path: Path) -> None:
    cut = tmp_path / "stream-002-000.mcap"
    cut.write_bytes(chunked.read_bytes()[:500])
    with pytest.raises(LogError, match="no step before it is whole"):
        open_whole_part([cut])
    cut.write_bytes(np.zeros(500, np.uint8).tobytes())
    with pytest.raises(LogError, match="stream-002-000"):
        open_whole_part([cut])
