"""A replay of real steps is identical, and finds every change in a log: where, and by how much."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open.cli import main
from gym_open.envs.physics.contacts import Contact
from gym_open.envs.physics.model import INVENTORY, model_xml
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.envs.puzzles.witnesses import witness_of
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs.reader import Log, log_files, open_log, open_logs
from gym_open.formats.logs.schemas import LogError, LogHead, Record, SegmentStart, StepRecord, Switch
from gym_open.formats.logs.writer import LogWriter
from gym_open.replay.logs import contact_error, replay, same_model
from gym_open.replay.player import ReplayWindow
from gym_open.replay.table import replay_report

EVERY = 16
TOLERANCE = 1e-3
STEPS = 40
"""Steps of a segment, which has windows of 16, 16 and 8 steps."""


def head(*puzzles: Puzzle, model: str = "") -> LogHead:
    return LogHead(0, {}, puzzles, {"code": "1.0"}, model or model_xml(), keyframe_every=EVERY)


def seen(world: World) -> dict[str, Any]:
    return {"image": world.observe(), "depth": world.depth(), "segmentation": world.segmentation()}


def played(puzzle: Puzzle, actions: list[int], *, index: int = 0, first: int = 0, hits: bool = False) -> list[Record]:
    """A segment of real steps in a world of its own, and the switch after it."""
    world = World()
    world.load(puzzle, recolour_hits=hits)
    made: list[Record] = []
    for i, action in enumerate(actions):
        if i % EVERY == 0:
            made.append(
                SegmentStart(
                    index, first, index, puzzle, False, INVENTORY, world.object_state(), world.save_state(),
                    segment_step=i, **seen(world),
                )
            )  # fmt: skip
        outcome = world.step(action)
        made.append(StepRecord(first + i, index, i, action, world.object_state(), outcome.contacts, **seen(world)))
    made.append(Switch(first + len(actions), index, index + 1 if index == 0 else -1, "learned", [0.0, 0.0]))
    return made


@pytest.fixture(scope="module")
def made() -> list[Record]:
    """Two segments in two worlds, in which the agent pushes objects."""
    rng = np.random.default_rng(5)
    records: list[Record] = [Switch(0, -1, 0, "start", [np.inf, np.inf])]
    for index, puzzle in enumerate(pool()):
        records += played(puzzle, rng.integers(1, 9, STEPS).tolist(), index=index, first=STEPS * index)
    return records


def pool() -> tuple[Puzzle, Puzzle]:
    rng = np.random.default_rng(4)
    return sample_puzzle("sandbox", rng), sample_puzzle("sandbox", rng)


def write(folder: Path, records: list[Record], top: LogHead | None = None, *, roll_bytes: int = 2**28) -> Path:
    with LogWriter(folder, top or head(*pool()), roll_bytes=roll_bytes) as log:
        for record in records:
            {SegmentStart: log.segment, StepRecord: log.step, Switch: log.switch}[type(record)](record)  # type: ignore[arg-type]
    return folder


def opened(folder: Path) -> Log:
    (log,) = open_logs(folder)
    return log


def windows(folder: Path) -> list[ReplayWindow]:
    return list(replay(opened(folder), TOLERANCE))


def test_real_steps_are_identical(made: list[Record], tmp_path: Path) -> None:
    found = windows(write(tmp_path, made))
    assert [window.verdict for window in found] == ["identical"] * 6
    assert [(window.segment, window.first_step, window.steps) for window in found] == [
        (0, 0, 16), (0, 16, 16), (0, 32, 8), (1, 40, 16), (1, 56, 16), (1, 72, 8)
    ]  # fmt: skip
    assert any(record.contacts for record in made if isinstance(record, StepRecord))  # something was pushed


def test_every_file_of_a_stream_can_be_replayed_alone(made: list[Record], tmp_path: Path) -> None:
    (parts,) = log_files(write(tmp_path, made, roll_bytes=1))
    alone = [window for path in parts for window in replay(open_log(path), TOLERANCE)]
    assert alone == windows(tmp_path)
    assert len(parts) >= 6


def test_a_task_is_replayed_with_the_colours_of_its_hits(tmp_path: Path) -> None:
    """Goals change colour in a task and not in the sandbox, which the images show."""
    puzzle = puzzle_by_id("goal-seeking/000")
    records = played(puzzle, list(witness_of("goal-seeking/000").actions), hits=True)
    records[-1] = msgspec.structs.replace(records[-1], to_world=-1, reason="terminated", world_losses=[0.0])
    folder = write(tmp_path, [Switch(0, -1, 0, "start", [np.inf]), *records], head(puzzle))
    assert {window.verdict for window in windows(folder)} == {"identical"}


Flaw = Callable[[StepRecord], dict[str, Any]]


def flawed(made: list[Record], step: int, flaw: Flaw) -> list[Record]:
    """The records with a change in one step."""
    return [
        msgspec.structs.replace(record, **flaw(record))
        if isinstance(record, StepRecord) and record.step == step
        else record
        for record in made
    ]


def moved(name: str, metres: float) -> Flaw:
    shift = np.zeros((len(INVENTORY), 13))
    shift[INVENTORY.index(name), 0] = metres
    return lambda record: {"object_state": record.object_state + shift}


def painted(rows: int, columns: int) -> Flaw:
    def paint(record: StepRecord) -> dict[str, Any]:
        image = record.image.copy()
        image[:rows, :columns] ^= 1
        return {"image": image}

    return paint


STEP = 20
"""The step that is changed; it is in the second window, which begins at 16."""


def changed_window(made: list[Record], folder: Path, flaw: Flaw) -> ReplayWindow:
    """The second window; all other windows are identical."""
    first, second, *others = windows(write(folder, flawed(made, STEP, flaw)))
    assert {window.verdict for window in (first, *others)} == {"identical"}
    return second


def test_an_object_with_a_small_offset_is_within_tolerance(made: list[Record], tmp_path: Path) -> None:
    window = changed_window(made, tmp_path, moved("heavy_1", 1e-6))
    assert (window.verdict, window.first_different, window.first_diverged) == ("within tolerance", STEP + 1, None)
    assert window.state_error == {"heavy_1": pytest.approx(1e-6, rel=1e-6)}
    assert (window.pixels, window.contact_steps) == (0, 0)


def test_an_object_elsewhere_has_diverged(made: list[Record], tmp_path: Path) -> None:
    window = changed_window(made, tmp_path, moved("yellow_0", 0.25))
    assert (window.verdict, window.first_different, window.first_diverged) == ("diverged", STEP + 1, STEP + 1)
    assert window.state_error == {"yellow_0": pytest.approx(0.25)}


def test_a_state_of_nan_has_diverged(made: list[Record], tmp_path: Path) -> None:
    window = changed_window(made, tmp_path, moved("agent", np.nan))
    assert (window.verdict, window.state_error) == ("diverged", {"agent": np.inf})


def test_minus_zero_is_not_the_same_to_the_bit(made: list[Record], tmp_path: Path) -> None:
    def negated(record: StepRecord) -> dict[str, Any]:
        state = record.object_state.copy()
        assert (state == 0).any()
        state[state == 0] = -0.0
        return {"object_state": state}

    window = changed_window(made, tmp_path, negated)
    assert (window.verdict, window.state_error, window.first_different) == ("within tolerance", {}, STEP + 1)


@pytest.mark.parametrize(("rows", "columns", "verdict"), [(1, 1, "within tolerance"), (7, 10, "within tolerance"),
                                                          (7, 11, "diverged"), (84, 84, "diverged")])  # fmt: skip
def test_pixels_are_counted(made: list[Record], tmp_path: Path, rows: int, columns: int, verdict: str) -> None:
    window = changed_window(made, tmp_path, painted(rows, columns))
    assert (window.verdict, window.pixels, window.images) == (verdict, rows * columns, 1)
    assert (window.first_different, window.state_error) == (STEP + 1, {})


@pytest.mark.parametrize("name", ["depth", "segmentation"])
def test_depth_and_segmentation_are_compared(made: list[Record], tmp_path: Path, name: str) -> None:
    def other(record: StepRecord) -> dict[str, Any]:
        image = getattr(record, name).copy()
        image[40:43, 20] += 1
        return {name: image}

    window = changed_window(made, tmp_path, other)
    assert (window.verdict, window.pixels, window.images) == ("within tolerance", 3, 1)


def test_an_additional_contact_has_diverged(made: list[Record], tmp_path: Path) -> None:
    more = Contact("light_0", "light_1", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.5)
    window = changed_window(made, tmp_path, lambda record: {"contacts": (*record.contacts, more)})
    assert (window.verdict, window.contact_error, window.contact_steps) == ("diverged", 0.5, 1)
    assert window.first_diverged == STEP + 1


def test_another_action_diverges_until_the_next_keyframe(made: list[Record], tmp_path: Path) -> None:
    """Another action moves the agent elsewhere; the following steps of the window differ, too."""
    window = changed_window(made, tmp_path, lambda record: {"action": (record.action + 3) % 8 + 1})
    assert (window.verdict, window.first_diverged) == ("diverged", STEP + 1)
    assert window.state_error["agent"] > 0.05
    assert window.images > 1


def test_a_keyframe_that_was_not_reached_is_found(made: list[Record], tmp_path: Path) -> None:
    """Its state differs in the last bit, so the window before it is not identical."""
    at = [i for i, record in enumerate(made) if isinstance(record, SegmentStart)][1]
    frame = made[at]
    assert isinstance(frame, SegmentStart)
    state = frame.integration_state.copy()
    state[0] = np.nextafter(state[0], 1e9)  # the time, on which nothing else depends
    found = windows(
        write(tmp_path, [*made[:at], msgspec.structs.replace(frame, integration_state=state), *made[at + 1 :]])
    )
    assert [window.verdict for window in found[:2]] == ["within tolerance", "within tolerance"]
    assert (found[0].first_different, found[0].state_error) == (16, {})


def test_contact_error_is_the_greatest_difference() -> None:
    one = Contact("a", "b", (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 4.0)
    near = msgspec.structs.replace(one, position=(1.0, 2.25, 3.0), impulse=4.125)
    other = msgspec.structs.replace(one, b="c", impulse=0.5)
    assert contact_error([], []) == contact_error([one], [one]) == 0
    assert contact_error([one], [near]) == 0.25
    assert contact_error([one, other], [near]) == contact_error([near], [other, one]) == 0.5
    assert contact_error([], [one]) == 4


def test_objects_of_another_world_are_refused(made: list[Record], tmp_path: Path) -> None:
    names = INVENTORY[:3]
    others: list[Record] = []
    for record in made:
        if isinstance(record, SegmentStart):
            record = msgspec.structs.replace(record, object_names=names)  # noqa: PLW2901
        if isinstance(record, SegmentStart | StepRecord):
            record = msgspec.structs.replace(record, object_state=record.object_state[:3])  # noqa: PLW2901
        others.append(record)
    with pytest.raises(
        LogError, match=f"expected the {len(INVENTORY)} objects of this version's world, got {', '.join(names)}"
    ):
        windows(write(tmp_path, others))


def test_a_state_of_another_version_is_refused(made: list[Record], tmp_path: Path) -> None:
    start = made[1]
    assert isinstance(start, SegmentStart)
    other = msgspec.structs.replace(start, integration_state=start.integration_state[:-1])
    with pytest.raises(ArtefactError, match="keyframe before step 0: world state: expected"):
        windows(write(tmp_path, [made[0], other, *made[2:]]))


def test_another_model_is_reported(made: list[Record], tmp_path: Path) -> None:
    folder = write(tmp_path, made, head(*pool(), model="<mujoco/>"))
    assert not same_model(opened(folder))
    report = replay_report(folder, TOLERANCE)
    assert report.notes == ["stream 0: the model in it is not the one that this version builds; it was written by 1.0"]
    assert report.verdict == "identical"


def test_a_report_lists_the_worst_window_first(made: list[Record], tmp_path: Path) -> None:
    hair = flawed(made, 3, moved("heavy_1", 1e-6))
    report = replay_report(write(tmp_path, flawed(hair, STEP, moved("yellow_0", 0.25))), TOLERANCE)
    assert report.verdict == "diverged"
    assert report.first_diverged == f"stream 0, segment 0, step {STEP + 1}"
    by_stream, by_window = ([list(column.cells) for column in table.columns] for table in report.tables)
    assert [cells[0] for cells in by_stream] == ["0", "80", "4", "1", "1", "0.25", "0", "0"]
    assert [cells[0] for cells in by_window] == ["0/0", "21", "21", "yellow_0", "0.25", "0", "0"]
    assert [cells[1] for cells in by_window][:4] == ["0/0", "4", "–", "heavy_1"]


def test_streams_are_chosen(made: list[Record], tmp_path: Path) -> None:
    folder = write(tmp_path, made)
    assert replay_report(folder, TOLERANCE, [0]).verdict == "identical"
    with pytest.raises(UsageError, match=r"--streams: .* holds the streams \[0\], got \[3\]"):
        replay_report(folder, TOLERANCE, [0, 3])
    with pytest.raises(UsageError, match="--tolerance: expected 0 or more, got nan"):
        replay_report(folder, float("nan"))


def test_the_command_fails_if_a_window_diverged(
    made: list[Record], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "replay", str(write(tmp_path, made))]) == 0
    assert "verdict: identical" in capsys.readouterr().out
    hair = write(tmp_path, flawed(made, STEP, moved("yellow_0", 1e-6)))
    assert main(["log", "replay", str(hair)]) == 0
    assert "verdict: within tolerance" in capsys.readouterr().out
    assert main(["log", "replay", str(hair), "--tolerance", "1e-9"]) == 1
    shown = capsys.readouterr()
    assert "verdict: diverged" in shown.out
    assert f"has diverged, first in stream 0, segment 0, step {STEP + 1}" in shown.err
