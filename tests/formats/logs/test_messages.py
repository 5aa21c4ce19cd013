"""Messages compared with those of mcap-ros2-support, which encodes them number by number from the definition."""

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import serialize_dynamic

from gym_open.envs.physics.contacts import Contact
from gym_open.formats.logs import messages, schemas
from gym_open.formats.logs.schemas import Record, SegmentStart, StepMetrics, StepRecord, Stuck, Switch

PARTS = ("forward", "inverse")


def foreign(topic: str, message: dict[str, Any]) -> bytes:
    """The message as the ROS 2 library encodes it."""
    name, definition = schemas.DEFINITIONS[topic]
    return serialize_dynamic(name, definition)[name](message)


def plain(value: Any) -> Any:
    """Numbers, lists and dicts in place of arrays and structs."""
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    if isinstance(value, msgspec.Struct):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    return [plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def image_message(topic: str, pixels: np.ndarray, encoding: str, nanoseconds: int) -> bytes:
    row = pixels.nbytes // 84
    return foreign(
        topic,
        {
            "header": header(nanoseconds), "height": 84, "width": 84, "encoding": encoding, "is_bigendian": 0,
            "step": row, "data": pixels.tobytes(),
        },
    )  # fmt: skip


def header(nanoseconds: int) -> dict[str, Any]:
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": "camera"}


def image_messages(record: SegmentStart | StepRecord, time: int) -> list[tuple[str, int, bytes]]:
    assert record.depth is not None
    assert record.segmentation is not None
    seen = [
        (schemas.IMAGE, record.image, "rgb8"),
        (schemas.DEPTH, record.depth, "32FC1"),
        (schemas.SEGMENTATION, record.segmentation, "32SC1"),
    ]
    return [(topic, time, image_message(topic, pixels, encoding, time)) for topic, pixels, encoding in seen]


def step_fields(record: StepRecord) -> dict[str, Any]:
    return {**plain(record), **plain(record.metrics)}


def expected(record: Record) -> list[tuple[str, int, bytes]]:
    """Topic, time and bytes of the messages of a record, made by the ROS 2 library."""
    if isinstance(record, SegmentStart):
        time = 40_000_000 * (record.first_step + record.segment_step)
        fields = {**plain(record), "segment": record.index, "puzzle_digest": record.puzzle.digest}
        return [(schemas.SEGMENT, time, foreign(schemas.SEGMENT, fields)), *image_messages(record, time)]
    time = 40_000_000 * record.step
    if isinstance(record, StepRecord):
        own = record.metrics
        figures = [own.intrinsic_reward, own.world_model_loss, own.policy_entropy, own.value]
        names = ["intrinsic_reward", "world_model_loss", "policy_entropy", "value"]
        metrics = {
            "header": header(time),
            "name": [*names, "intrinsic_reward/forward", "intrinsic_reward/inverse"],
            "position": [*figures, *own.reward_parts],
        }
        return [
            (schemas.STEP, time, foreign(schemas.STEP, step_fields(record))),
            (schemas.METRICS, time, foreign(schemas.METRICS, metrics)),
            *image_messages(record, time + 40_000_000),
        ]
    if isinstance(record, Switch):
        topic, words = schemas.SWITCH, f"world {record.from_world} -> {record.to_world} ({record.reason})"
    else:
        how = "stuck in a corner" if record.began else "free again"
        topic, words = schemas.STUCK, f"heavy_0 {how} at (1.90, -1.90, 0.05)"
    event = {"data": f"step {record.step}: {words}"}
    return [(topic, time, foreign(topic, plain(record))), (schemas.EVENTS, time, foreign(schemas.EVENTS, event))]


def test_messages_are_those_of_the_ros2_library(made_up: Any) -> None:
    records = made_up.records(all_images=True)
    assert {type(record) for record in records} == {SegmentStart, StepRecord, Switch, Stuck}
    made = [message for record in records for message in messages.messages_of(record, PARTS)]
    assert {message.topic for message in made} == set(schemas.DEFINITIONS)
    assert made == [message for record in records for message in expected(record)]


NUMBER = st.floats(allow_nan=False)
CONTACTS = st.builds(
    Contact, a=st.text(max_size=9), b=st.text(max_size=9), position=st.tuples(NUMBER, NUMBER, NUMBER),
    normal=st.tuples(NUMBER, NUMBER, NUMBER), impulse=NUMBER,
)  # fmt: skip


@given(st.lists(CONTACTS, max_size=5), st.lists(NUMBER, max_size=4), st.integers(1, 3), st.integers(0, 2**64 - 1))
def test_any_step_is_that_of_the_ros2_library_and_comes_back(
    contacts: list[Contact], parts: list[float], objects: int, step: int
) -> None:
    """Names of any length, because the numbers after them must be aligned."""
    state = np.arange(13.0 * objects).reshape(objects, 13)
    image = np.zeros((84, 84, 3), np.uint8)
    metrics = StepMetrics(0.1, np.inf, 2.2, -1.0, tuple(parts))
    record = StepRecord(step, 1, 2, 3, state, tuple(contacts), image, metrics)
    encoded = messages.encode_step(record)
    assert encoded == foreign(schemas.STEP, step_fields(record))
    assert plain(messages.decode_step(encoded, image)) == plain(record)


def test_records_come_back_from_their_messages(made_up: Any) -> None:
    """To the bit, including NaN."""
    for record in made_up.records(all_images=True):
        first, *rest = messages.messages_of(record, PARTS)
        seen = [messages.decode_image(one.topic, one.data) for one in rest if one.topic in messages.PIXELS]
        match record:
            case SegmentStart():
                again = messages.decode_segment(first.data, made_up.pool, *seen)
            case StepRecord():
                again = messages.decode_step(first.data, *seen)
            case Switch():
                again = messages.decode_switch(first.data)
            case _:
                again = messages.decode_stuck(first.data)
        assert plain(again) == plain(record)


def test_a_loss_of_nan_comes_back() -> None:
    switch = messages.decode_switch(messages.encode_switch(Switch(1, 0, 1, "interval", [np.nan, np.inf, 0.5])))
    np.testing.assert_array_equal(switch.world_losses, [np.nan, np.inf, 0.5])


@pytest.mark.parametrize("image", [np.zeros((4, 4, 3), np.uint8), np.zeros((84, 84, 3))])
def test_an_image_of_another_size_or_type_is_not_written(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"/observation/image: expected an image of uint8 \(84, 84, 3\), got .*\d\)$"):
        messages.encode_image(schemas.IMAGE, image, 0)


def test_an_image_of_another_size_or_kind_is_refused() -> None:
    depth = messages.encode_image(schemas.DEPTH, np.zeros((84, 84), np.float32), 0)
    with pytest.raises(ValueError, match="/observation/segmentation: expected a 84x84 32SC1 image, got 84x84 32FC1"):
        messages.decode_image(schemas.SEGMENTATION, depth)


@pytest.mark.parametrize(
    ("topic", "record"),
    [
        (schemas.SWITCH, Switch(1, 0, 1, "learned", [])),
        (schemas.STUCK, Stuck(1, 0, "corner", "heavy_0", True, (0.0, 0.0, 0.0))),
    ],
)
def test_a_word_that_the_format_does_not_have_is_refused(topic: str, record: Switch | Stuck) -> None:
    fields = {**plain(record), "reason": "bored", "kind": "bored"}
    decode = messages.decode_switch if topic == schemas.SWITCH else messages.decode_stuck
    with pytest.raises(msgspec.ValidationError, match="bored"):
        decode(foreign(topic, fields))


@given(st.integers(0, 140))
def test_a_message_cut_anywhere_is_refused(cut: int) -> None:
    contact = Contact("agent", "yellow_0", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0)
    image = np.zeros((84, 84, 3), np.uint8)
    whole = messages.encode_step(StepRecord(0, 0, 0, 1, np.zeros((1, 13)), (contact,), image))
    with pytest.raises(ValueError, match=r"ends at byte|expected little-endian CDR"):
        messages.decode_step(whole[:cut], image)


def test_a_segment_whose_puzzle_the_pool_lacks_is_refused(made_up: Any) -> None:
    start = next(record for record in made_up.records() if isinstance(record, SegmentStart))
    with pytest.raises(ValueError, match=r"segment 0 is in world 1 with puzzle .*, which the pool does not hold"):
        messages.decode_segment(messages.encode_segment(start), made_up.pool[:1], start.image)
