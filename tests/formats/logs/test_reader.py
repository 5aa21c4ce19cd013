"""Reading logs: the reader returns what was written, in pieces of any length, and refuses parts of other logs."""

import shutil
import tracemalloc
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs.reader import Log, log_files, open_log, open_logs
from gym_open.formats.logs.schemas import (
    METRIC_NAMES,
    LogError,
    Record,
    Segment,
    SegmentStart,
    StepRecord,
    Stuck,
    Switch,
    log_name,
)

FIELDS = ("actions", "contacts", *METRIC_NAMES)
SEEN = ("images", "depth", "segmentation", "object_state")


@pytest.fixture(scope="module")
def whole(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file."""
    return made_up.write(tmp_path_factory.mktemp("log"), made_up.records(all_images=True, steps=3))[0]


@pytest.fixture(scope="module")
def rolled(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The same with about one file per keyframe."""
    parts = made_up.write(tmp_path_factory.mktemp("log"), made_up.records(all_images=True, steps=3), roll_bytes=1)
    assert len(parts) > 5
    return parts


def pixels(record: SegmentStart | StepRecord, name: str) -> Any:
    return getattr(record, {"images": "image"}.get(name, name))


def test_head_comes_back(made_up: Any, whole: Path) -> None:
    log, head, made = open_log(whole), made_up.head, made_up.records(all_images=True, steps=3)
    assert (log.stream, log.config, log.puzzles, log.provenance) == (2, head.config, head.puzzles, head.provenance)
    assert (log.model_xml, log.reward_parts, log.keyframe_every) == ("<mujoco/>", ("forward", "inverse"), 2)
    assert log.n_steps == 27
    assert log.switches == [record for record in made if isinstance(record, Switch)]
    assert log.stuck == [record for record in made if isinstance(record, Stuck)]


def test_segments_come_back_bit_for_bit(made_up: Any, whole: Path) -> None:
    made = made_up.records(all_images=True, steps=3)
    found = list(open_log(whole).segments())
    plan = [(world, 3 * length, continued, ended) for world, length, continued, ended in made_up.plan]
    assert [(one.world, len(one.actions), one.continued, one.ended) for one in found] == plan
    for segment in found:
        frames = [record for record in made if isinstance(record, SegmentStart) and record.index == segment.index]
        steps = [record for record in made if isinstance(record, StepRecord) and record.segment == segment.index]
        assert (segment.stream, segment.first_step, segment.segment_step) == (2, frames[0].first_step, 0)
        assert (segment.puzzle, segment.object_names) == (frames[0].puzzle, made_up.names)
        for name in SEEN:
            expected = [pixels(record, name) for record in (frames[0], *steps)]
            np.testing.assert_array_equal(getattr(segment, name), expected)
        assert segment.contacts == [step.contacts for step in steps]
        assert segment.actions.tolist() == [step.action for step in steps]
        for name in METRIC_NAMES:
            np.testing.assert_array_equal(getattr(segment, name), [getattr(step.metrics, name) for step in steps])
        for i, name in enumerate(("forward", "inverse")):
            assert segment.reward_parts[name].tolist() == [step.metrics.reward_parts[i] for step in steps]
        np.testing.assert_array_equal(segment.integration_state, frames[0].integration_state)
        assert [frame.segment_step for frame in segment.keyframes] == [frame.segment_step for frame in frames]
        for one, frame in zip(segment.keyframes, frames, strict=True):
            np.testing.assert_array_equal(one.integration_state, frame.integration_state)


def test_arrays_have_the_documented_types(whole: Path) -> None:
    segment = next(open_log(whole).segments())
    found = {name: (getattr(segment, name).dtype.str, getattr(segment, name).shape) for name in
             (*SEEN, "actions", "value", "integration_state")}  # fmt: skip
    assert found == {
        "images": ("|u1", (13, 84, 84, 3)),
        "depth": ("<f4", (13, 84, 84)),
        "segmentation": ("<i4", (13, 84, 84)),
        "object_state": ("<f8", (13, 3, 13)),
        "actions": ("<i8", (12,)),
        "value": ("<f8", (12,)),
        "integration_state": ("<f8", (31,)),
    }


def test_without_depth_and_segmentation_there_is_none(made_up: Any, tmp_path: Path) -> None:
    for segment in open_log(made_up.write(tmp_path)).segments():
        assert segment.depth is None
        assert segment.segmentation is None


def assert_pieces_of(whole: Segment, pieces: list[Segment], max_steps: int) -> None:
    length, start = len(whole.actions), 0
    assert [len(piece.actions) for piece in pieces[:-1]] == [max_steps] * (len(pieces) - 1)
    for piece in pieces:
        stop = start + len(piece.actions)
        assert (piece.segment_step, piece.first_step, piece.index) == (start, whole.first_step + start, whole.index)
        assert piece.ended == (whole.ended if stop == length else None)
        for name in SEEN:
            np.testing.assert_array_equal(getattr(piece, name), getattr(whole, name)[start : stop + 1])
        for name in FIELDS:
            assert list(getattr(piece, name)) == list(getattr(whole, name)[start:stop])
        for name, values in piece.reward_parts.items():
            assert values.tolist() == whole.reward_parts[name][start:stop].tolist()
        within = {frame.segment_step: frame for frame in whole.keyframes if start <= frame.segment_step}
        expected = [step for step in within if step < stop]
        assert [frame.segment_step for frame in piece.keyframes] == expected
        assert (piece.integration_state is not None) == (start % 2 == 0)
        if piece.integration_state is not None:
            np.testing.assert_array_equal(piece.integration_state, within[start].integration_state)
        start = stop
    assert start == length


@settings(max_examples=14)
@given(max_steps=st.integers(1, 14), parts=st.booleans())
def test_pieces_form_the_segments(whole: Path, rolled: list[Path], max_steps: int, parts: bool) -> None:
    """Pieces of any length, from one file or from many."""
    log = open_log(rolled if parts else whole)
    pieces = list(log.segments(max_steps))
    for segment in open_log(whole).segments():
        assert_pieces_of(segment, [piece for piece in pieces if piece.index == segment.index], max_steps)


def test_a_part_alone_can_be_read(whole: Path, rolled: list[Path]) -> None:
    """Each part begins with a keyframe, and together they hold every step once."""
    everything = {segment.index: segment for segment in open_log(whole).segments()}
    steps: list[int] = []
    for path in rolled:
        log, first = open_log(path), len(steps)
        for piece in log.segments():
            assert piece.integration_state is not None
            segment = everything[piece.index]
            stop = piece.segment_step + len(piece.actions)
            assert piece.actions.tolist() == segment.actions[piece.segment_step : stop].tolist()
            steps += range(piece.first_step, piece.first_step + len(piece.actions))
        assert log.n_steps == len(steps) - first
    assert steps == list(range(27))


def test_a_segment_that_continues_in_another_file_has_no_end(rolled: list[Path]) -> None:
    *_, last = open_log(rolled[1]).segments()
    assert last.ended is None


def test_reading_needs_memory_for_one_piece(made_up: Any, tmp_path: Path) -> None:
    """The segment has 17 MB; one chunk and one piece of it are in memory."""
    log = open_log(made_up.write(tmp_path, made_up.records(steps=200)))
    tracemalloc.start()
    try:
        steps = sum(len(piece.actions) for piece in log.segments(64))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert steps == 9 * 200
    assert peak < 20e6


def test_pieces_of_no_length_are_refused(whole: Path) -> None:
    with pytest.raises(UsageError, match="max_steps: expected 1 or more, got 0"):
        next(open_log(whole).segments(0))


def test_files_are_in_the_order_of_streams_and_parts(tmp_path: Path) -> None:
    names = [log_name(0, part) for part in range(11)] + [log_name(1, 0), log_name(10, 0), log_name(1000, 0)]
    for name in (*reversed(names), "stream-000-000-repaired.mcap", "stream-1.mcap", "summary.json"):
        (tmp_path / name).touch()
    assert [[path.name for path in parts] for parts in log_files(tmp_path)] == [names[:11], *([n] for n in names[11:])]
    with pytest.raises(ArtefactError, match=r"no logs \(stream-\*\.mcap\)"):
        log_files(tmp_path / "nowhere")


@pytest.fixture
def copied(rolled: list[Path], tmp_path: Path) -> list[Path]:
    return [Path(shutil.copy(path, tmp_path)) for path in rolled]


@pytest.mark.parametrize("missing", [0, 2])
def test_a_missing_part_is_named(copied: list[Path], tmp_path: Path, missing: int) -> None:
    copied[missing].unlink()
    with pytest.raises(LogError, match=rf"stream-002-00{missing}\.mcap: missing, but a later part is there"):
        open_logs(tmp_path)


def test_a_missing_last_part_is_named(copied: list[Path], tmp_path: Path) -> None:
    copied[-1].unlink()
    with pytest.raises(LogError, match=rf"the stream continues in {copied[-1].name}, which is missing"):
        open_logs(tmp_path)


def test_a_part_that_is_there_twice_is_refused(copied: list[Path], tmp_path: Path) -> None:
    shutil.copy(copied[2], copied[3])
    with pytest.raises(LogError, match=r"003\.mcap: part 2 of its stream, expected part 3"):
        open_logs(tmp_path)


def test_an_additional_part_is_refused(copied: list[Path], tmp_path: Path) -> None:
    more = tmp_path / log_name(2, len(copied))
    shutil.copy(copied[-1], more)
    with pytest.raises(LogError, match=r"the stream ends in it, so .* is not a part of it"):
        open_logs(tmp_path)


def test_a_part_of_another_run_is_refused(made_up: Any, copied: list[Path], tmp_path: Path) -> None:
    other = msgspec.structs.replace(made_up.head, provenance={"code": "other"})
    stranger = type(made_up)()
    stranger.head = other
    (tmp_path / "other").mkdir()
    parts = stranger.write(tmp_path / "other", made_up.records(all_images=True, steps=3), roll_bytes=1)
    shutil.copy(parts[1], copied[1])
    with pytest.raises(LogError, match=r"001\.mcap: of another run or stream than .*000\.mcap"):
        open_logs(tmp_path)


def test_a_part_of_another_run_with_the_same_head_is_refused(made_up: Any, copied: list[Path], tmp_path: Path) -> None:
    """Its keyframe differs from the state at the end of the part before it."""
    (tmp_path / "other").mkdir()
    parts = made_up.write(tmp_path / "other", made_up.records(seed=1, all_images=True, steps=3), roll_bytes=1)
    shutil.copy(parts[2], copied[2])
    with pytest.raises(LogError, match="the keyframe before step 2 differs from the state there"):
        list(open_logs(tmp_path)[0].segments())


def test_repair_is_named_only_where_it_can_save_something(made_up: Any, copied: list[Path], tmp_path: Path) -> None:
    def remedy(source: Path | list[Path]) -> bool:
        with pytest.raises(LogError, match="restore the file from a copy, or run") as caught:
            list(open_log(source).segments())
        return "log repair" in str(caught.value)

    raw = copied[1].read_bytes()
    assert not remedy(copied[:-1])  # a part is missing
    copied[1].write_bytes(raw[:-30])
    assert remedy(copied[1])  # the index is lost
    copied[1].write_bytes(raw[:4000])
    assert not remedy(copied[1])  # nothing is left
    for name, records in (
        ("unfinished", made_up.records()[:-1]),
        ("out of place", flawed(made_up.records(), (StepRecord, 2, None))),
    ):
        (tmp_path / name).mkdir()
        assert remedy(made_up.write(tmp_path / name, records)[0]) == (name == "unfinished")


Change = dict[str, Any]
Flaw = tuple[type, int, Change | None]
"""The `n`-th record of a type is changed, or left out."""


def flawed(made: list[Record], flaw: Flaw) -> list[Record]:
    kind, number, change = flaw
    at = [i for i, record in enumerate(made) if isinstance(record, kind)][number]
    new = [] if change is None else [msgspec.structs.replace(made[at], **change)]
    return [*made[:at], *new, *made[at + 1 :]]


@pytest.mark.parametrize(
    ("flaw", "message"),
    [
        ((Switch, -1, None), "it has no last switch: its writer did not finish"),
        ((Switch, 1, None), "a keyframe of segment 1, step 0, stands in segment 0 before step 4"),
        (
            (Switch, 1, {"step": 3}),
            r"the switch at step 3 leaves world 1 \(learned\), but segment 0 in world 1 has 4 steps",
        ),
        ((Switch, 1, {"from_world": 2}), "the switch at step 4 leaves world 2"),
        (
            (Switch, 1, {"to_world": 2}),
            "segment 1 in world 0 begins at step 4, where segment 1 in world 2 should begin",
        ),
        ((Switch, 1, {"reason": "start"}), r"the switch at step 4 leaves world 1 \(start\)"),
        ((SegmentStart, 0, None), "step 0 belongs to no segment"),
        ((SegmentStart, 1, {"segment_step": 1}), "a keyframe of segment 0, step 1, stands in segment 0 before step 2"),
        (
            (SegmentStart, 1, {"object_state": np.zeros((3, 13))}),
            "the keyframe before step 2 differs from the state there",
        ),
        (
            (SegmentStart, 1, {"image": np.zeros((84, 84, 3), np.uint8)}),
            "the keyframe before step 2 differs from the state",
        ),
        ((SegmentStart, 2, {"index": 2}), "segment 2 in world 0 begins at step 4, where segment 1"),
        ((SegmentStart, 2, {"first_step": 5}), "segment 1 in world 0 begins at step 5"),
        (
            (StepRecord, 2, None),
            "the steps of segment 0 are not complete and in order: expected step 2 of it, got step 3",
        ),
        ((StepRecord, 2, {"step": 7}), "the steps of segment 0 are not complete and in order"),
        ((StepRecord, 2, {"segment": 1}), "got step 2 of segment 1"),
        ((Switch, 1, {"world_losses": [0.5]}), "switch at step 4: 1 losses for a pool of 3 worlds"),
        ((StepRecord, 2, {"action": 9}), "step 2 has the action 9, expected 0 to 8"),
    ],
)
def test_records_out_of_place_are_refused(made_up: Any, tmp_path: Path, flaw: Flaw, message: str) -> None:
    (path,) = made_up.write(tmp_path, flawed(made_up.records(), flaw))
    with pytest.raises(LogError, match=message) as caught:
        list(open_log(path).segments())
    assert str(path) in str(caught.value)


def test_a_segment_with_depth_in_some_observations_is_refused(made_up: Any, tmp_path: Path) -> None:
    made = flawed(made_up.records(all_images=True), (StepRecord, 0, {"depth": None}))
    log = open_log(made_up.write(tmp_path, made))
    with pytest.raises(LogError, match="1 of 5 observations of a segment have no depth"):
        list(log.segments())


def test_an_open_log_is_read_in_the_order_of_recording(whole: Path, rolled: list[Path]) -> None:
    for log in (open_log(whole), open_log(rolled)):
        assert isinstance(log, Log)
        steps = [piece.first_step for piece in log.segments(1)]
        assert all(b == a + 1 for a, b in pairwise(steps))
