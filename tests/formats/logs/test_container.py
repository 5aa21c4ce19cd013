"""Files that are cut off, changed, foreign or hostile are detected before their contents are used."""

import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, IndexType, Writer

from gym_open.cli import main
from gym_open.formats.logs import container as log_container
from gym_open.formats.logs import schemas as log_schemas
from gym_open.formats.logs.container import LogMessage, read_contents, whole_chunks
from gym_open.formats.logs.reader import open_log
from gym_open.formats.logs.schemas import LogError

FIXTURES = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]


@pytest.fixture(scope="module")
def whole(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up.write(tmp_path_factory.mktemp("log"))[0]


def rewritten(
    whole: Path,
    out: Path,
    *,
    attachments: Mapping[str, bytes | None] | None = None,
    head: Mapping[str, str] | None = None,
    metadata: Mapping[str, dict[str, str]] | None = None,
    definitions: Mapping[str, tuple[str, str] | None] | None = None,
    messages: Iterable[LogMessage] | None = None,
    twice: str = "",
    index: IndexType = IndexType.ALL,
) -> Path:
    """Write the log again with the MCAP package: all CRCs are right, and one thing is changed."""
    contents = read_contents(whole)
    files = {**contents.attachments, **(attachments or {})}
    with out.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True, index_types=index)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, kind in {**log_schemas.DEFINITIONS, **(definitions or {})}.items():
            if kind is None:
                continue
            schema = writer.register_schema(kind[0], SchemaEncoding.ROS2, kind[1].encode())
            channels[topic] = writer.register_channel(topic, MessageEncoding.CDR, schema)
        for name, data in [*files.items(), *((twice, data) for name, data in files.items() if name == twice)]:
            if data is not None:
                writer.add_attachment(0, 0, name, "", data)
        for name, values in {**contents.metadata, **(metadata or {})}.items():
            writer.add_metadata(name, {**values, **(head or {})} if name == log_schemas.HEAD else values)
        messages = chain.from_iterable(whole_chunks(whole)) if messages is None else messages
        for number, (topic, time, data) in enumerate(messages):
            writer.add_message(channels[topic], time, data, time, number)
        writer.finish()
    return out


def test_a_log_written_by_the_mcap_package_is_read(whole: Path, tmp_path: Path) -> None:
    """So the only faults in the tests below are those that they make."""
    log = open_log(rewritten(whole, tmp_path / "x.mcap"))
    assert [len(segment.actions) for segment in log.segments()] == [4, 3, 2]


@settings(max_examples=60, suppress_health_check=FIXTURES)
@given(st.data())
def test_a_log_cut_anywhere_is_refused(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    raw = whole.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw) - 1))])
    with pytest.raises(LogError, match=r"cut\.mcap: damaged at byte \d+.*whole.*(restore|again)"):
        open_log(path)


@settings(max_examples=150, suppress_health_check=FIXTURES)
@given(st.data())
def test_a_changed_byte_anywhere_is_found(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(whole.read_bytes())
    raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "changed.mcap"
    path.write_bytes(raw)
    with pytest.raises(LogError, match=r"changed\.mcap"):
        open_log(path)


def test_a_cut_names_the_last_whole_step(whole: Path, tmp_path: Path) -> None:
    places = read_contents(whole).chunks  # the start, then one chunk per segment
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: places[2].offset + 20])
    with pytest.raises(LogError, match=f"byte {places[2].offset}: .*the last whole step is 3;"):
        open_log(path)


def test_a_changed_chunk_is_named_although_the_file_continues_after_it(whole: Path, tmp_path: Path) -> None:
    """The CRC of the whole data section does not say where the damage is."""
    raw, place = bytearray(whole.read_bytes()), read_contents(whole).chunks[2]
    raw[place.offset + 200] ^= 1
    path = tmp_path / "changed.mcap"
    path.write_bytes(raw)
    with pytest.raises(LogError, match=f"byte {place.offset}: .*the last whole step is 3;"):
        open_log(path)


def test_a_chunk_with_another_opcode_is_noticed(whole: Path, tmp_path: Path) -> None:
    """Readers must skip records with unknown opcodes, so its messages would be lost silently."""
    raw, places = bytearray(whole.read_bytes()), read_contents(whole).chunks
    raw[places[1].offset] = 0x70
    path = tmp_path / "changed.mcap"
    path.write_bytes(raw)
    assert list(whole_chunks(path)) == list(whole_chunks(whole))[:1]
    with pytest.raises(
        LogError, match=f"byte {places[2].offset}: messages are missing before this byte, from number 2 on"
    ):
        open_log(path)


def test_whole_chunks_of_a_cut_log_are_saved(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    everything = list(whole_chunks(whole))
    for kept, place in enumerate(read_contents(whole).chunks):
        for beyond in (0, 5, 100):
            path.write_bytes(whole.read_bytes()[: place.offset + beyond])
            assert list(whole_chunks(path)) == everything[:kept]


def empty(path: Path, **options: Any) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2")
        writer.finish()
    return path


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(LogError, match="no such log"):
        open_log(path)
    path.write_text("step,action\n" * 10)
    with pytest.raises(LogError, match="not an MCAP file"):
        open_log(path)
    for options in ({}, {"enable_data_crcs": True}):
        with pytest.raises(LogError, match="not a log of gym-open, or of another version: expected the format"):
            open_log(empty(path, **options))


def test_another_version_is_refused_before_the_rest_is_read(whole: Path, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "old.mcap", head={"format": "gym-open-log/1"})
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(LogError, match="expected the format 'gym-open-log/2', got 'gym-open-log/1'"):
        open_log(path)


@pytest.mark.parametrize("name", ["../../.bashrc", "/etc/passwd", "more.json"])
def test_other_attachments_are_refused(whole: Path, tmp_path: Path, name: str) -> None:
    """Attachments are never written to disk; a log with such a name is not ours."""
    path = rewritten(whole, tmp_path / "x.mcap", attachments={name: b"x"})
    with pytest.raises(LogError, match=rf"expected the attachments .*, got .*{name}"):
        open_log(path)


def test_a_missing_attachment_is_refused(whole: Path, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", attachments={"model.xml": None})
    with pytest.raises(LogError, match="expected the attachments"):
        open_log(path)


def test_an_attachment_that_is_there_twice_is_refused(whole: Path, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", twice="puzzles.json")
    with pytest.raises(LogError, match=r"'puzzles\.json' is there twice"):
        open_log(path)


@pytest.mark.parametrize(
    ("name", "data"),
    [("puzzles.json", b'[{"task": "sandbox", "objects": 3}]'), ("puzzles.json", b"{"), ("config.json", b"[1]"),
     ("model.xml", b"\xff")],
)  # fmt: skip
def test_nonsense_in_an_attachment_is_refused(whole: Path, tmp_path: Path, name: str, data: bytes) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", attachments={name: data})
    with pytest.raises(LogError, match=r"x\.mcap: not a log of gym-open, or of another version"):
        open_log(path)


DEEP = b"[" * 200_000 + b"]" * 200_000


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("config.json", b'{"a":' + DEEP + b"}"),
        ("config.json", b'{"a":' + b"[" * 70 + b"]" * 70 + b"}"),
        ("puzzles.json", DEEP),
        ("puzzles.json", b'[{"task":' + DEEP + b"}]"),
    ],
)
def test_deep_nesting_is_refused(
    whole: Path, tmp_path: Path, name: str, data: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every reader refuses it."""
    path = rewritten(whole, tmp_path / "x.mcap", attachments={name: data})
    with pytest.raises(LogError, match=r"x\.mcap: not a log .*: JSON in it is nested too deeply; refused"):
        open_log(path)
    for command in ("info", "replay", "repair"):
        assert main(["log", command, str(path)]) == 1
        assert "nested too deeply" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stream": "two"}, "stream: expected a whole number from 0 on, got 'two'"),
        ({"stream": "-1"}, "stream: expected a whole number from 0 on, got '-1'"),
        ({"stream": "1_0"}, "stream: expected"),
        ({"stream": "9" * 5000}, ""),
        ({"part": ""}, "part: expected"),
        ({"part": "-1"}, "part: expected"),
        ({"part": "9999999999"}, "part: expected"),
        ({"keyframe_every": "x"}, "keyframe_every: expected"),
        ({"keyframe_every": "0"}, "keyframe_every: expected a whole number from 1 on, got '0'"),
        ({"step_ns": "20000000"}, "step_ns: expected 40000000, got 20000000"),
        ({"reward_parts": "{}"}, ""),
    ],
)
def test_nonsense_in_the_head_is_refused(whole: Path, tmp_path: Path, change: dict[str, str], said: str) -> None:
    with pytest.raises(LogError, match=f"x\\.mcap: not a log of gym-open, or of another version: .*{said}"):
        open_log(rewritten(whole, tmp_path / "x.mcap", head=change))


@pytest.mark.parametrize("topic", ["/step", "/camera"])
def test_messages_of_another_type_are_refused(whole: Path, tmp_path: Path, topic: str) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", definitions={topic: ("gym_open_msgs/msg/Step", "uint64 step\n")})
    with pytest.raises(LogError, match=f"the messages of '{topic}' are not of the type"):
        open_log(path)


def test_a_missing_channel_is_refused(whole: Path, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", definitions={"/observation/depth": None})
    with pytest.raises(LogError, match="the messages of '/observation/depth' are not of the type"):
        open_log(path)


@pytest.mark.parametrize("following", [{"part": "2"}, {"part": "../x"}, {}])
def test_a_file_that_continues_in_another_part_than_the_next_is_refused(
    whole: Path, tmp_path: Path, following: dict[str, str]
) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", metadata={log_schemas.CONTINUES: following})
    with pytest.raises(LogError, match=r"part 0 continues in .*, expected part 1"):
        open_log(path)


def test_an_index_that_hides_steps_is_detected(whole: Path, tmp_path: Path) -> None:
    """It counts them for a channel that does not exist; the CRC of the whole data section is right."""
    raw, offset = bytearray(whole.read_bytes()), 8
    steps = next(number for number, topic in read_contents(whole).topics.items() if topic == log_schemas.STEP)
    while raw[offset] != Opcode.DATA_END:
        opcode, length, channel = struct.unpack_from("<BQH", raw, offset)
        if (opcode, channel) == (Opcode.MESSAGE_INDEX, steps):
            struct.pack_into("<H", raw, offset + 9, 77)
        offset += 9 + length
    struct.pack_into("<I", raw, offset + 9, zlib.crc32(raw[:offset]))
    path = tmp_path / "x.mcap"
    path.write_bytes(raw)
    with pytest.raises(LogError, match="it holds 9 steps, its index says 0"):
        list(open_log(path).segments())


def test_a_bomb_is_refused_before_it_unpacks(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small log with 120 MB of zeros is refused by the sizes that its chunks declare."""
    zeros = [LogMessage(log_schemas.EVENTS, 0, bytes(2**20))] * 120
    path = rewritten(whole, tmp_path / "bomb.mcap", messages=zeros)
    assert path.stat().st_size < 40_000
    monkeypatch.setattr(zstandard, "decompress", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(LogError, match=r"would unpack to more than \d+ times its size; refused"):
        open_log(path)


def test_a_chunk_beyond_the_limit_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_container, "MAX_CHUNK", 50_000)
    with pytest.raises(LogError, match=r"a chunk would unpack to \d+ bytes, the limit is 50000"):
        open_log(whole)


def test_a_record_beyond_the_limit_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_container, "MAX_CHUNK", 100)
    with pytest.raises(LogError, match=r"a record has \d+ bytes, the limit is 100; refused"):
        open_log(whole)


def test_attachments_beyond_the_limit_are_refused(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = rewritten(whole, tmp_path / "x.mcap", attachments={f"{i}": bytes(40_000) for i in range(4)})
    monkeypatch.setattr(log_container, "MAX_CHUNK", 150_000)
    with pytest.raises(LogError, match="the attachments have more than 150000 bytes"):
        open_log(path)


def test_a_chunk_that_lies_about_its_size_is_refused(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The size in the zstd frame must equal the chunk's, so a frame cannot unpack to more than is allowed."""
    monkeypatch.setattr(zstandard, "frame_content_size", lambda _: 10**12)
    with pytest.raises(LogError, match=r"a chunk is not packed as its header says"):
        open_log(whole)


def chunk_of(raw: bytes) -> bytes:
    """An MCAP file of one chunk with these bytes; all CRCs are right."""
    packed = zstandard.compress(raw)
    chunk = (
        struct.pack("<QQQI", 0, 0, len(raw), zlib.crc32(raw)) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    )
    data = b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(chunk)) + chunk
    data += struct.pack("<BQI", 15, 4, zlib.crc32(data))
    footer = struct.pack("<BQQQ", 2, 20, 0, 0)
    return data + footer + struct.pack("<I", zlib.crc32(footer)) + b"\x89MCAP0\r\n"


def message(channel: int, length: int) -> bytes:
    return struct.pack("<BQHIQQ", 5, length, channel, 0, 0, 0)


@pytest.mark.parametrize(
    "raw",
    [
        pytest.param(message(1, 10**6), id="longer than its chunk"),
        pytest.param(b"\x05\x16", id="cut off in its head"),
        pytest.param(message(7, 22), id="of a channel that was not named"),
        pytest.param(struct.pack("<BQ", 4, 3) + b"abc", id="a channel of three bytes"),
        pytest.param(struct.pack("<BQHHI", 4, 8, 1, 1, 10**9), id="a topic of a gigabyte"),
    ],
)
def test_nonsense_in_a_chunk_whose_crc_is_right_is_damage(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(chunk_of(raw))
    with pytest.raises(log_container.Damage, match="is invalid"):
        list(log_container.chunks(path))


def test_messages_outside_of_chunks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=True)
        writer.start("ros2")
        writer.add_message(writer.register_channel("/step", "cdr", 0), 0, b"x", 0)
        writer.finish()
    with pytest.raises(log_container.Damage, match="a message outside the chunks"):
        read_contents(path)


@settings(max_examples=100, suppress_health_check=FIXTURES)
@given(st.data())
def test_nonsense_in_messages_is_a_log_error_if_anything(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    """Bytes of a message are changed and every CRC is right, as in a malicious file."""
    messages = [message for chunk in whole_chunks(whole) for message in chunk]
    victim = data.draw(st.sampled_from([i for i, message in enumerate(messages) if "image" not in message.topic]))
    raw = bytearray(messages[victim].data)
    raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    messages[victim] = messages[victim]._replace(data=bytes(raw))
    path = rewritten(whole, tmp_path / "x.mcap", messages=messages)
    with suppress(LogError):
        for _ in open_log(path).segments(2):
            pass


def test_a_log_without_message_indexes_is_whole(whole: Path, tmp_path: Path) -> None:
    """MCAP allows it; the messages are counted in the chunks."""
    path = rewritten(whole, tmp_path / whole.name, index=IndexType.ALL & ~IndexType.MESSAGE)
    log, other = open_log(whole), open_log(path)
    assert (log.n_steps, len(log.switches)) == (other.n_steps, len(other.switches))
    assert other.damage is None
    assert main(["log", "info", str(path)]) == 0


@pytest.mark.parametrize("record", [bytes(9), struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 1, 0, 0, 0)])
def test_chunks_of_tiny_records_are_refused_at_once(whole: Path, tmp_path: Path, record: bytes) -> None:
    """Eight such chunks, within the limit of expansion, took a minute to read."""
    raw = record * (2**22 // len(record))
    packed = zstandard.compress(raw)
    body = (
        struct.pack("<QQQI", 0, 0, len(raw), zlib.crc32(raw)) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    )
    data = whole.read_bytes()
    first = read_contents(whole).chunks[0].offset
    path = tmp_path / whole.name
    path.write_bytes(data[:first] + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body + data[first:])
    with pytest.raises(LogError, match=r"far too many; refused|is invalid"):
        open_log(path)
