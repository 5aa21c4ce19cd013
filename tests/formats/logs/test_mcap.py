"""The container compared with the mcap package: its writer makes the same bytes, and its reader reads them."""

from io import BytesIO
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from gym_open.formats.logs import mcap as log_mcap
from gym_open.formats.logs import schemas as log_schemas
from gym_open.formats.logs.mcap import McapWriter

TOPICS = {"/a": ("p/msg/A", "int32 a"), "/b": ("p/msg/B", "int32 b"), "/c": ("p/msg/A", "int32 a")}
MESSAGES = st.lists(
    st.tuples(st.sampled_from([1, 2, 3]), st.integers(0, 10**6), st.binary(max_size=99), st.booleans()), min_size=1
)


def ours(messages: list[tuple[int, int, bytes, bool]]) -> bytes:
    file = BytesIO()
    writer = McapWriter(file)
    assert [writer.channel(topic, *type_) for topic, type_ in TOPICS.items()] == [1, 2, 3]
    writer.attach("x.json", "application/json", b"{}")
    writer.metadata("m", {"k": "v"})
    for sequence, (channel, time, data, flush) in enumerate(messages):
        writer.message(channel, sequence, time, data)
        if flush:
            writer.flush()
            assert writer.size == len(file.getvalue())
    writer.finish()
    return file.getvalue()


def theirs(messages: list[tuple[int, int, bytes, bool]], chunk_bytes: int) -> bytes:
    file = BytesIO()
    writer = Writer(file, chunk_bytes, CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True)
    writer.start("ros2")
    schemas: dict[str, int] = {}
    for topic, (name, definition) in TOPICS.items():
        if name not in schemas:
            schemas[name] = writer.register_schema(name, "ros2msg", definition.encode())
        writer.register_channel(topic, "cdr", schemas[name])
    writer.add_attachment(0, 0, "x.json", "application/json", b"{}")
    writer.add_metadata("m", {"k": "v"})
    for sequence, (channel, time, data, flush) in enumerate(messages):
        writer.add_message(channel, time, data, time, sequence)
        if flush:
            writer.flush()
    writer.finish()
    return file.getvalue()


@settings(max_examples=60)
@given(MESSAGES)
def test_bytes_are_those_of_the_mcap_package(messages: list[tuple[int, int, bytes, bool]]) -> None:
    assert ours(messages) == theirs(messages, 4 * 2**20)


def test_large_chunks_end_where_those_of_the_mcap_package_do(monkeypatch: Any) -> None:
    monkeypatch.setattr(log_mcap, "CHUNK_BYTES", 1000)
    messages = [(1 + i % 3, i, bytes(40 * (i % 7)), False) for i in range(200)]
    assert ours(messages) == theirs(messages, 1000)


def test_the_mcap_package_reads_a_log(made_up: Any, tmp_path: Path) -> None:
    """With its seeking reader, its ROS 2 decoder and CRC checks."""
    (path,) = made_up.write(tmp_path)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert {one.name for one in reader.iter_attachments()} == {"config.json", "model.xml", "puzzles.json"}
        heads = {one.name: one.metadata for one in reader.iter_metadata()}
        found = [(channel.topic, message.log_time, ros)
                 for _, channel, message, ros in reader.iter_decoded_messages(log_time_order=False)]  # fmt: skip
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(found)
    assert heads["provenance"] == made_up.head.provenance
    assert heads["gym-open"] == {
        "format": "gym-open-log/2", "keyframe_every": "2", "part": "0", "reward_parts": '["forward","inverse"]',
        "step_ns": "40000000", "stream": "2",
    }  # fmt: skip
    steps = [(time, ros) for topic, time, ros in found if topic == log_schemas.STEP]
    assert [ros.step for _, ros in steps] == list(range(9))
    assert [time for time, _ in steps] == [40_000_000 * i for i in range(9)]
    keyframes = [ros.segment_step for topic, _, ros in found if topic == log_schemas.SEGMENT]
    assert keyframes == [0, 2, 0, 2, 0]
    assert sum(topic == log_schemas.IMAGE for topic, _, _ in found) == 9 + 5
    words = [ros.data for topic, _, ros in found if topic == log_schemas.EVENTS]
    assert words[1:3] == ["step 2: heavy_0 stuck in a corner at (1.90, -1.90, 0.05)", "step 4: world 1 -> 0 (learned)"]
