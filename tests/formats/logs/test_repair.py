"""Repair saves the undamaged records of a log and nothing else, and says what is missing."""

import io
import shutil
import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from gym_open.formats.logs import mcap as log_mcap
from gym_open.formats.logs import repair as log_repair
from gym_open.formats.logs.container import read_contents
from gym_open.formats.logs.messages import messages_of
from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.reader import open_log
from gym_open.formats.logs.repair import RepairedLog, repair
from gym_open.formats.logs.schemas import IMAGE, METRICS, SEGMENTATION, STEP, LogError, Segment, StepRecord, Switch

FIXTURES = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]


@pytest.fixture(scope="module")
def whole(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """27 steps in one file whose chunks end anywhere, also between the messages of a step."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_mcap, "CHUNK_BYTES", 110_000)
        return made_up.write(tmp_path_factory.mktemp("log"), made_up.records(all_images=True, steps=3))[0]


@pytest.fixture(scope="module")
def rolled(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The same in several files of several chunks."""
    folder = tmp_path_factory.mktemp("log")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_mcap, "CHUNK_BYTES", 400_000)
        return made_up.write(folder, made_up.records(all_images=True, steps=3), roll_bytes=6000)


def steps_by_the_mcap_package(raw: bytes) -> int:
    """Number of steps whose messages are all in complete chunks of a file that is cut off."""
    topics: list[str] = []
    channels: dict[int, str] = {}
    try:
        for record in StreamReader(io.BytesIO(raw), emit_chunks=True, validate_crcs=True).records:
            for item in breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else []:
                if isinstance(item, Channel):
                    channels[item.id] = item.topic
                elif isinstance(item, Message):
                    topics.append(channels[item.channel_id])
    except (McapError, struct.error, ValueError, zstandard.ZstdError):
        pass  # it has no error of its own for a file that ends
    complete = topics.count(STEP)
    last = topics[len(topics) - 1 - topics[::-1].index(STEP) :] if complete else []
    return complete - (not {METRICS, IMAGE, SEGMENTATION} <= set(last)) if complete else 0


def damaged(folder: Path, raw: bytes, name: str = "stream-002-000.mcap") -> Path:
    for left in folder.iterdir():
        left.unlink()
    path = folder / name
    path.write_bytes(raw)
    return path


def assert_beginning(found: list[Segment], expected: list[Segment]) -> None:
    """The segments are the expected ones; the last one may lack its end."""
    assert len(found) <= len(expected)
    for i, (one, other) in enumerate(zip(found, expected, strict=False)):
        n = len(one.actions)
        assert (one.index, one.world, one.first_step) == (other.index, other.world, other.first_step)
        assert one.actions.tolist() == other.actions[:n].tolist()
        np.testing.assert_array_equal(one.images, other.images[: n + 1])
        np.testing.assert_array_equal(one.depth, other.depth[: n + 1])  # type: ignore[index]
        np.testing.assert_array_equal(one.object_state, other.object_state[: n + 1])
        assert one.value.tolist() == other.value[:n].tolist()
        assert one.ended == (other.ended if n == len(other.actions) and i + 1 < len(found) else one.ended)


@settings(max_examples=40, suppress_health_check=FIXTURES)
@given(st.data())
def test_a_log_cut_anywhere_is_saved_up_to_its_last_whole_step(
    whole: Path, tmp_path: Path, data: st.DataObject
) -> None:
    raw, contents = whole.read_bytes(), read_contents(whole)
    cut = data.draw(st.integers(contents.chunks[1].offset, len(raw) - 1))
    path, steps = damaged(tmp_path, raw[:cut]), steps_by_the_mcap_package(raw[:cut])
    if not steps:
        with pytest.raises(LogError, match="nothing can be saved"):
            repair(path)
        assert list(tmp_path.iterdir()) == [path]
        return
    made = repair(path)
    assert made.saved is not None
    assert made.saved.name == "stream-002-000-repaired.mcap"
    assert set(tmp_path.iterdir()) == {path, made.saved}
    assert path.read_bytes() == raw[:cut]
    assert (made.steps, made.last_step, made.missing_bytes) == (steps, steps - 1, cut - made.offset)
    log = open_log(made.saved)
    found = list(log.segments())
    assert sum(len(segment.actions) for segment in found) == log.n_steps == steps
    assert_beginning(found, list(open_log(whole).segments()))
    assert made.cut == (found[-1].ended == "cut")
    assert made.cut or steps == 27
    if made.cut:
        end = log.switches[-1]
        assert (end.step, end.from_world, end.to_world, end.reason) == (steps, found[-1].world, -1, "cut")
        losses = next(switch.world_losses for switch in open_log(whole).switches[::-1] if switch.step <= steps)
        assert end.world_losses == losses


@settings(max_examples=40, suppress_health_check=FIXTURES)
@given(st.data())
def test_nothing_wrong_is_saved_from_a_log_with_a_changed_byte(
    whole: Path, tmp_path: Path, data: st.DataObject
) -> None:
    """And everything before that byte is saved."""
    raw = bytearray(whole.read_bytes())
    at = data.draw(st.integers(read_contents(whole).chunks[1].offset, len(raw) - 1))
    before = steps_by_the_mcap_package(bytes(raw[:at]))
    raw[at] ^= data.draw(st.integers(1, 255))
    path = damaged(tmp_path, bytes(raw))
    try:
        made = repair(path)
    except LogError as error:
        assert "nothing can be saved" in str(error)  # noqa: PT017 - or something is
        assert before == 0
        return
    assert made.saved is not None
    assert made.steps >= before
    assert_beginning(list(open_log(made.saved).segments()), list(open_log(whole).segments()))


@pytest.mark.parametrize("number", [1, 2])
def test_a_repaired_last_part_takes_its_place(rolled: list[Path], tmp_path: Path, number: int) -> None:
    raw = rolled[number].read_bytes()
    path = damaged(tmp_path, raw[: read_contents(rolled[number]).chunks[-1].offset + 9], rolled[number].name)
    made = repair(path)
    assert made.saved is not None
    log = open_log([*rolled[:number], made.saved])
    found = list(log.segments())
    assert found[-1].ended == "cut"
    assert_beginning(found, list(open_log(rolled).segments()))
    assert made.last_step == log.n_steps - 1
    assert (
        numbers(made.saved)[:-2] == numbers(rolled[number])[: len(numbers(made.saved)) - 2]
    )  # except those of the cut


def numbers(path: Path) -> list[int]:
    """Sequence numbers of the messages, which continue from part to part."""
    with path.open("rb") as file:
        return [message.sequence for _, _, message in make_reader(file).iter_messages(log_time_order=False)]


def test_a_part_that_lost_only_its_index_continues_as_before(rolled: list[Path], tmp_path: Path) -> None:
    path = damaged(tmp_path, rolled[1].read_bytes()[:-30], rolled[1].name)
    made = repair(path)
    assert made.saved is not None
    assert not made.cut
    assert open_log([rolled[0], made.saved, *rolled[2:]]).n_steps == 27


def test_a_log_that_lost_only_its_index_is_saved_completely(whole: Path, tmp_path: Path) -> None:
    made = repair(damaged(tmp_path, whole.read_bytes()[:-30]))
    assert made.saved is not None
    assert (made.steps, made.cut) == (27, False)
    assert open_log(made.saved).switches == open_log(whole).switches


def test_a_log_that_was_never_ended_is_ended(made_up: Any, tmp_path: Path) -> None:
    (path,) = made_up.write(tmp_path, made_up.records()[:-1])
    made = repair(path)
    assert made.saved is not None
    assert [segment.ended for segment in open_log(made.saved).segments()] == ["learned", "learned", "cut"]
    assert made.missing_bytes == 0


def test_a_switch_to_a_world_without_any_record_is_undone(made_up: Any, tmp_path: Path) -> None:
    """Killed between a switch and the segment after it."""
    made = made_up.records()
    second = [i for i, record in enumerate(made) if isinstance(record, Switch)][1]
    repaired = repair(made_up.write(tmp_path, made[: second + 1])[0]).saved
    assert repaired is not None
    log = open_log(repaired)
    assert [(switch.step, switch.to_world, switch.reason) for switch in log.switches] == [
        (0, 1, "start"),
        (4, -1, "cut"),
    ]


def test_a_whole_log_is_left_alone(whole: Path) -> None:
    before = set(whole.parent.iterdir())
    assert repair(whole) == RepairedLog(saved=None)
    assert set(whole.parent.iterdir()) == before


def test_nothing_is_overwritten(whole: Path, tmp_path: Path) -> None:
    path = damaged(tmp_path, whole.read_bytes()[:-30])
    (tmp_path / "stream-002-000-repaired.mcap").write_text("mine")
    with pytest.raises(LogError, match="exists already and is not overwritten"):
        repair(path)
    assert (tmp_path / "stream-002-000-repaired.mcap").read_text() == "mine"


def test_a_file_that_is_not_a_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such log"):
        repair(tmp_path / "x.mcap")
    (tmp_path / "x.mcap").write_text("no log at all")
    with pytest.raises(LogError, match=r"not an MCAP file.*; no step before it is whole"):
        repair(tmp_path / "x.mcap")


def test_undamaged_bytes_that_do_not_form_a_log_are_an_error(made_up: Any, tmp_path: Path) -> None:
    """All CRCs are right, but the file has no step, or its steps have another number of parts than the head."""
    (stepless,) = made_up.write(tmp_path, [one for one in made_up.records() if not isinstance(one, StepRecord)])
    with pytest.raises(LogError, match=r"stream-002-000\.mcap: .*restore the file from a copy"):
        repair(stepless)
    head = msgspec.structs.replace(made_up.head, reward_parts=tuple(f"part {i}" for i in range(1000)))
    files = LogParts(tmp_path, head, 2**40)
    for record in made_up.records():
        for message in messages_of(record, made_up.head.reward_parts):
            files.put(message)
    files.finish()
    with pytest.raises(LogError, match="step 0 has 2 reward parts, the log names 1000; restore"):
        repair(stepless)
    stepless.write_bytes(stepless.read_bytes()[:-30])
    with pytest.raises(LogError, match=rf"{stepless}: step 0 has 2 reward parts.*; nothing can be saved"):
        repair(stepless)
    assert list(tmp_path.iterdir()) == [stepless]


@pytest.mark.parametrize("inside", ["", "checkpoint"])
def test_nothing_is_written_into_the_folder_of_an_unfinished_artefact(whole: Path, tmp_path: Path, inside: str) -> None:
    """The file would become part of the artefact or be removed with the checkpoint when the run continues."""
    folder = tmp_path / ".curl[1].partial" / inside
    folder.mkdir(parents=True)
    path = damaged(folder, whole.read_bytes()[:-30])
    made = repair(path)
    assert made.saved is not None
    assert made.saved == tmp_path / "curl[1]-stream-002-000-repaired.mcap"
    assert open_log(made.saved).n_steps == 27
    assert list(folder.iterdir()) == [path]


class KilledError(Exception):
    """Stands for kill -9."""


def test_a_repair_that_fails_leaves_nothing_and_can_be_repeated(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = damaged(tmp_path, whole.read_bytes()[:-30])

    def killed(*_: object, **__: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(LogParts, "finish", killed)
        with pytest.raises(KilledError):
            repair(path)
        assert list(tmp_path.iterdir()) == [path]
        patch.setattr(log_repair.shutil, "rmtree", lambda *_, **__: None)  # killed before that, too
        with pytest.raises(KilledError):
            repair(path)
    assert len(list(tmp_path.iterdir())) == 2
    assert repair(path).steps == 27
    shutil.rmtree(tmp_path)
