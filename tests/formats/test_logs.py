"""Logs: what is written comes back, bytes repeat, and damage of any kind is found and named."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory

from gym_open.envs.physics.contacts import Contact
from gym_open.envs.puzzles import Placement, Puzzle, arranged
from gym_open.errors import ArtefactError
from gym_open.formats import log_container, log_schemas
from gym_open.formats.logs import LogError, LogHead, LogWriter, SegmentStart, StepRecord, Switch, log_files, open_log

NAMES = ("agent", "yellow_0", "heavy_0")
POOL = tuple(
    Puzzle(task="sandbox", objects=arranged([Placement("agent", 3, column), Placement("yellow", 9, 4)]))
    for column in (1, 2, 6)
)
HEAD = LogHead(
    stream=2,
    config={"seed": 7, "steps": 9},
    puzzles=POOL,
    provenance={"code": "0.1.0+abc", "seed": "7"},
    model_xml="<mujoco/>",
)
PLAN = [(1, 4, False, "learned"), (0, 3, False, "learned"), (1, 2, True, "budget")]
"""World, steps, continued, why it ended: three segments of one stream."""


def image(rng: np.random.Generator) -> np.ndarray:
    out = np.full((84, 84, 3), 90, np.uint8)
    out[20:30, 40:50] = rng.integers(0, 256, (10, 10, 3))
    return out


def records(seed: int = 0) -> list[SegmentStart | StepRecord | Switch]:
    rng = np.random.default_rng(seed)
    made: list[SegmentStart | StepRecord | Switch] = []
    step = 0
    made.append(Switch(0, -1, PLAN[0][0], "start", [np.inf] * 3))
    for index, (world, length, continued, reason) in enumerate(PLAN):
        state = rng.normal(size=(len(NAMES), 13))
        made.append(
            SegmentStart(index, step, world, POOL[world], continued, NAMES, state, rng.normal(size=31), image(rng))
        )
        for i in range(length):
            contacts = tuple(
                Contact(
                    a="agent", b=f"yellow_{k}", position=(0.5, -1.25, 0.05), normal=(0.0, 1.0, 0.0), impulse=k + 0.1
                )
                for k in range(i % 3)
            )
            state = rng.normal(size=(len(NAMES), 13))
            numbers = [float(x) for x in rng.normal(size=4)]
            made.append(StepRecord(step, index, i, int(rng.integers(9)), state, contacts, *numbers, image=image(rng)))
            step += 1
        following = PLAN[index + 1][0] if index + 1 < len(PLAN) else -1
        made.append(Switch(step, world, following, reason, [0.25, 1.5, np.inf]))  # type: ignore[arg-type]
    return made


def put(writer: LogWriter, record: SegmentStart | StepRecord | Switch) -> None:
    if isinstance(record, SegmentStart):
        writer.segment(record)
    elif isinstance(record, StepRecord):
        writer.step(record)
    else:
        writer.switch(record)
        writer.flush()


def write(path: Path, made: list[SegmentStart | StepRecord | Switch] | None = None) -> Path:
    with LogWriter(path, HEAD) as writer:
        for record in made if made is not None else records():
            put(writer, record)
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log") / "stream-002.mcap")


def test_head_comes_back(whole: Path) -> None:
    log = open_log(whole)
    assert (log.stream, log.config, log.puzzles) == (2, HEAD.config, POOL)
    assert (log.provenance, log.model_xml, log.n_steps) == (HEAD.provenance, HEAD.model_xml, 9)
    assert log.switches == [record for record in records() if isinstance(record, Switch)]


def test_segments_come_back_bit_for_bit(whole: Path) -> None:
    made = records()
    segments = list(open_log(whole).segments())
    assert [(s.world, len(s.actions), s.continued, s.ended) for s in segments] == PLAN
    for segment in segments:
        start = next(r for r in made if isinstance(r, SegmentStart) and r.index == segment.index)
        steps = [r for r in made if isinstance(r, StepRecord) and r.segment == segment.index]
        assert (segment.stream, segment.first_step, segment.puzzle) == (2, start.first_step, start.puzzle)
        assert segment.object_names == NAMES
        assert segment.contacts == [step.contacts for step in steps]
        np.testing.assert_array_equal(segment.integration_state, start.integration_state)
        np.testing.assert_array_equal(segment.images, [start.image, *(step.image for step in steps)])
        np.testing.assert_array_equal(segment.object_state, [start.object_state, *(s.object_state for s in steps)])
        np.testing.assert_array_equal(segment.actions, [step.action for step in steps])
        for name in log_schemas.METRIC_NAMES:
            np.testing.assert_array_equal(getattr(segment, name), [getattr(step, name) for step in steps])


def test_arrays_have_the_documented_types(whole: Path) -> None:
    segment = next(open_log(whole).segments())
    found = {name: (getattr(segment, name).dtype.str, getattr(segment, name).shape) for name in
             ("images", "actions", "object_state", "value", "integration_state")}  # fmt: skip
    assert found == {
        "images": ("|u1", (5, 84, 84, 3)),
        "actions": ("<i8", (4,)),
        "object_state": ("<f8", (5, 3, 13)),
        "value": ("<f8", (4,)),
        "integration_state": ("<f8", (31,)),
    }


def test_bytes_repeat_in_another_folder(whole: Path, tmp_path: Path) -> None:
    assert write(tmp_path / "other.mcap").read_bytes() == whole.read_bytes()


def test_other_content_is_other_bytes(whole: Path, tmp_path: Path) -> None:
    assert write(tmp_path / "other.mcap", records(seed=1)).read_bytes() != whole.read_bytes()


def builtin(record: Any) -> Any:
    """Numbers and lists in place of arrays and structs, as the ROS 2 library takes them."""
    if isinstance(record, np.ndarray):
        return record.ravel().tolist()
    if isinstance(record, msgspec.Struct):
        return {name: builtin(getattr(record, name)) for name in record.__struct_fields__}
    return [builtin(item) for item in record] if isinstance(record, (list, tuple)) else record


def test_messages_are_those_of_the_ros2_library() -> None:
    """Our encoder against mcap-ros2-support's, byte for byte, on every message type."""
    made = records()
    start = next(r for r in made if isinstance(r, SegmentStart))
    step = [r for r in made if isinstance(r, StepRecord)][2]
    switch = next(r for r in made if isinstance(r, Switch))
    time = 3_000_000_007
    header = {"stamp": {"sec": 3, "nanosec": 7}, "frame_id": "camera"}
    picture = {"header": header, "height": 84, "width": 84, "encoding": "rgb8", "is_bigendian": 0, "step": 252}
    metrics = {"header": header, "name": list(log_schemas.METRIC_NAMES)}
    metrics["position"] = [getattr(step, name) for name in log_schemas.METRIC_NAMES]
    pairs: dict[str, tuple[bytes, Any]] = {
        log_schemas.IMAGE: (
            log_schemas.encode_image(step.image, time),
            {**picture, "data": step.image.tobytes()},
        ),
        log_schemas.STEP: (log_schemas.encode_step(step), builtin(step)),
        log_schemas.SEGMENT: (
            log_schemas.encode_segment(start),
            {**builtin(start), "segment": start.index, "puzzle_digest": start.puzzle.digest},
        ),
        log_schemas.SWITCH: (log_schemas.encode_switch(switch), builtin(switch)),
        log_schemas.METRICS: (log_schemas.encode_metrics(step, time), metrics),
        log_schemas.EVENTS: (log_schemas.encode_text("step 0: näxt"), {"data": "step 0: näxt"}),
    }
    assert set(pairs) == set(log_schemas.DEFINITIONS)
    for topic, (ours, message) in pairs.items():
        name, definition = log_schemas.DEFINITIONS[topic]
        assert ours == serialize_dynamic(name, definition)[name](message), topic


def test_another_reader_of_mcap_reads_it(whole: Path) -> None:
    """The mcap package's own seeking reader with its ROS 2 decoder, CRCs on."""
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [(channel.topic, message.log_time, ros)
                 for _, channel, message, ros in reader.iter_decoded_messages(log_time_order=False)]  # fmt: skip
    steps = [(time, ros) for topic, time, ros in found if topic == log_schemas.STEP]
    assert [ros.step for _, ros in steps] == list(range(9))
    assert [time for time, _ in steps] == [40_000_000 * i for i in range(9)]
    assert sum(topic == log_schemas.IMAGE for topic, _, _ in found) == 9 + 3
    words = [ros.data for topic, _, ros in found if topic == log_schemas.EVENTS]
    assert words[1] == "step 4: world 1 -> 0 (learned)"


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_log_cut_anywhere_is_refused(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    raw = whole.read_bytes()
    cut = data.draw(st.integers(0, len(raw) - 1))
    path = tmp_path / "cut.mcap"
    path.write_bytes(raw[:cut])
    with pytest.raises(LogError, match=r"cut\.mcap: damaged at byte \d+.*whole.*(restore|again)"):
        open_log(path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_changed_byte_anywhere_is_found(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(whole.read_bytes())
    raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "changed.mcap"
    path.write_bytes(raw)
    with pytest.raises(LogError, match=r"changed\.mcap"):
        open_log(path)


def test_a_cut_names_the_last_whole_step(whole: Path, tmp_path: Path) -> None:
    places = log_container.read_contents(whole).chunks  # the start, then one chunk a segment
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: places[2].offset + 20])
    with pytest.raises(LogError, match=f"byte {places[2].offset}: .*the last whole step is 3;"):
        open_log(path)


def test_whole_chunks_of_a_cut_log_are_saved(whole: Path, tmp_path: Path) -> None:
    places = log_container.read_contents(whole).chunks
    path = tmp_path / "cut.mcap"
    everything = list(log_container.whole_chunks(whole))
    for kept, place in enumerate(places):
        for beyond in (0, 5, 100):
            path.write_bytes(whole.read_bytes()[: place.offset + beyond])
            assert list(log_container.whole_chunks(path)) == everything[:kept]


class KilledError(Exception):
    """Stands for kill -9: a writer that it passes through writes no index."""


@pytest.mark.parametrize("checkpoint", [0, 1, 2])
def test_a_killed_writer_is_resumed_to_the_same_bytes(whole: Path, tmp_path: Path, checkpoint: int) -> None:
    """Killed two records before the end, resumed from an earlier switch: what lies between is written again."""
    made = records()
    written = []
    with suppress(KilledError), LogWriter(tmp_path / "killed.mcap", HEAD) as killed:
        for record in made[:-2]:
            put(killed, record)
            written.append(killed.messages)
        raise KilledError
    at = [i for i, record in enumerate(made) if isinstance(record, Switch)][checkpoint]
    with LogWriter(tmp_path / "resumed.mcap", HEAD) as writer:
        writer.resume(tmp_path / "killed.mcap", written[at])
        for record in made[at + 1 :]:
            put(writer, record)
    assert (tmp_path / "resumed.mcap").read_bytes() == whole.read_bytes()


def resume_otherwise(path: Path, killed: Path) -> None:
    with LogWriter(path, HEAD) as writer:
        writer.resume(killed, 2)
        put(writer, msgspec.structs.replace(records()[1], continued=True))


def test_a_resumed_run_that_diverges_is_an_error(tmp_path: Path) -> None:
    killed = write(tmp_path / "killed.mcap")
    before = killed.read_bytes()
    with pytest.raises(LogError, match=r"message 2 .*is not the one that had been logged"):
        resume_otherwise(tmp_path / "x.mcap", killed)
    assert killed.read_bytes() == before


def test_a_log_shorter_than_its_checkpoint_is_an_error(whole: Path, tmp_path: Path) -> None:
    with (
        pytest.raises(LogError, match="the checkpoint was taken after 1000"),
        LogWriter(tmp_path / "x", HEAD) as writer,
    ):
        writer.resume(whole, 1000)


def test_a_log_without_its_last_switch_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="its writer was not finished"):
        open_log(write(tmp_path / "open.mcap", records()[:-1]))


def test_a_missing_step_is_refused(tmp_path: Path) -> None:
    made = records()
    log = open_log(write(tmp_path / "gap.mcap", made[:3] + made[4:]))
    with pytest.raises(LogError, match=r"gap\.mcap: the steps of segment 0 are not complete and in order"):
        list(log.segments())


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(LogError, match="no such log"):
        open_log(path)
    path.write_text("step,action\n" * 10)
    with pytest.raises(LogError, match="not an MCAP file"):
        open_log(path)
    with path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start("ros2")
        writer.finish()
    with pytest.raises(LogError, match="not a log of gym-open, or of another version: expected the format"):
        open_log(path)


def test_a_bomb_is_refused_before_it_unpacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small file that unpacks to 100 MB is refused by its declared size, and by the packed frame's own."""
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**20, enable_data_crcs=True)
        writer.start("ros2")
        channel = writer.register_channel("/zeros", "cdr", 0)
        for _ in range(60):
            writer.add_message(channel, 0, bytes(2**20), 0)
        writer.finish()
    monkeypatch.setattr(zstandard, "decompress", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(LogError, match="would unpack to"):
        open_log(path)


def test_a_chunk_beyond_the_limit_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_container, "MAX_CHUNK", 1000)
    with pytest.raises(LogError, match=r"a chunk would unpack to \d+ bytes, the limit is 1000"):
        open_log(whole)


def test_a_chunk_that_lies_about_its_size_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The packed frame's own size is held to the chunk's, so a frame cannot unpack to more than was allowed for."""
    monkeypatch.setattr(zstandard, "frame_content_size", lambda _: 10**12)
    with pytest.raises(LogError, match=r"a chunk is not packed as it says"):
        open_log(whole)


def test_log_files_are_in_the_order_of_the_streams(tmp_path: Path) -> None:
    for name in ("stream-001.mcap", "stream-000.mcap", "summary.json"):
        (tmp_path / name).touch()
    assert [path.name for path in log_files(tmp_path)] == ["stream-000.mcap", "stream-001.mcap"]
    with pytest.raises(ArtefactError, match="no logs"):
        log_files(tmp_path / "nowhere")
