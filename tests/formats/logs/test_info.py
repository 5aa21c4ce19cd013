"""The output of the `log` commands, compared with the records that were written."""

import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gym_open.cli import main
from gym_open.errors import ArtefactError
from gym_open.formats.logs import schemas
from gym_open.formats.logs.container import read_contents
from gym_open.formats.logs.info import info_tables, inspect
from gym_open.formats.logs.schemas import LogError, SegmentStart, StepRecord, Stuck, Switch


@pytest.fixture(scope="module")
def whole(made_up: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up.write(tmp_path_factory.mktemp("log"), made_up.records(steps=3))[0]


@pytest.fixture
def parts(made_up: Any, tmp_path: Path) -> list[Path]:
    parts = made_up.write(tmp_path, made_up.records(steps=3), roll_bytes=6000)
    assert len(parts) == 3
    return parts


def cells(source: Path, number: int) -> list[list[str]]:
    """Rows of one of the tables: files, streams, channels."""
    columns = [list(column.cells) for column in info_tables(source)[0][number].columns]
    return [[str(cell) for cell in row] for row in zip(*columns, strict=True)]


def test_counts_are_those_of_the_records(made_up: Any, whole: Path) -> None:
    made, info = made_up.records(steps=3), inspect(whole)
    count = Counter(type(record) for record in made)
    assert info.messages == Counter(
        {
            schemas.SEGMENT: count[SegmentStart],
            schemas.STEP: count[StepRecord],
            schemas.METRICS: count[StepRecord],
            schemas.IMAGE: count[SegmentStart] + count[StepRecord],
            schemas.SWITCH: count[Switch],
            schemas.STUCK: count[Stuck],
            schemas.EVENTS: count[Switch] + count[Stuck],
            schemas.DEPTH: 0,
            schemas.SEGMENTATION: 0,
        }
    )
    assert (info.steps, info.seconds, info.bytes) == (27, pytest.approx(27 * 0.04), whole.stat().st_size)
    assert info.switches == [record for record in made if isinstance(record, Switch)]
    assert info.stuck == [record for record in made if isinstance(record, Stuck)]
    assert (info.health, info.first_world, info.head) == ("whole", 1, made_up.head)


def test_files_and_streams_are_summarised(whole: Path) -> None:
    size = whole.stat().st_size
    assert cells(whole, 0) == [["stream-002-000.mcap", "27", "1 s", f"{size:,}", f"{size / 27:,.0f}", "whole"]]
    assert cells(whole, 1) == [
        ["2", "27", f"{size / 27:,.0f}", "2 of 3", "3", "1", "start 1, learned 2, budget 1", "whole"]
    ]
    assert ["/step", "gym_open_msgs/msg/Step", "27"] in cells(whole, 2)
    assert not any(row[0] == schemas.DEPTH for row in cells(whole, 2))
    assert info_tables(whole)[0][0].title == "gym-open-log/2, written by 0.1.0+abc, seed 7"


def test_parts_are_summarised(whole: Path, parts: list[Path], tmp_path: Path) -> None:
    """Together, the parts hold what one file would hold."""
    assert [row[0] for row in cells(tmp_path, 0)] == [path.name for path in parts]
    assert [row[-1] for row in cells(tmp_path, 0)] == ["whole, goes on", "whole, goes on", "whole"]
    (one,), (other,) = cells(tmp_path, 1), cells(whole, 1)
    assert [one[0], one[1], *one[3:]] == [other[0], other[1], *other[3:]]
    assert cells(tmp_path, 2) == cells(whole, 2)


def test_a_part_alone_says_in_which_world_it_begins(parts: list[Path]) -> None:
    info = inspect(parts[-1])
    assert info.first_world == 1
    assert info.part == 2


def test_messages_before_the_damage_are_counted(whole: Path, tmp_path: Path) -> None:
    place = read_contents(whole).chunks[2]  # the start, a segment, a segment, …
    path = tmp_path / whole.name
    path.write_bytes(whole.read_bytes()[: place.offset + 10])
    info = inspect(path)
    assert info.messages == Counter(
        {schemas.STEP: 12, schemas.METRICS: 12, schemas.IMAGE: 18, schemas.SEGMENT: 6, schemas.SWITCH: 2,
         schemas.STUCK: 1, schemas.EVENTS: 3}
    )  # fmt: skip
    assert info.health.startswith(f"at byte {place.offset:,}: the file is cut off")
    assert cells(path, 1)[0][-1] == "part 0 damaged"


def test_a_log_that_was_not_ended_says_so(made_up: Any, tmp_path: Path) -> None:
    (path,) = made_up.write(tmp_path, made_up.records()[:-1])
    assert inspect(path).health == "not ended: no last switch in it"


@pytest.mark.parametrize(("gone", "health"), [(0, "part 0 missing"), (1, "part 1 missing"), (2, "part 2 missing")])
def test_missing_parts_are_named(parts: list[Path], tmp_path: Path, gone: int, health: str) -> None:
    parts[gone].unlink()
    assert cells(tmp_path, 1)[0][-1] == health
    assert cells(next(path for path in parts if path.exists()), 1)[0][-1].startswith("whole")  # alone, none is missed


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="no logs"):
        info_tables(tmp_path)
    with pytest.raises(LogError, match="no such log"):
        inspect(tmp_path / "x.mcap")
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(LogError, match=r"damaged at byte 8: .*; no step before it is whole"):
        inspect(tmp_path / "x.mcap")


def test_the_commands_say_what_to_do_next(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(shutil.copy(whole, tmp_path))
    assert main(["log", "repair", str(path)]) == 0
    assert "is complete, nothing to do" in capsys.readouterr().out
    path.write_bytes(whole.read_bytes()[:-20_000])
    assert main(["log", "info", str(path)]) == 1
    said = capsys.readouterr()
    assert "at byte" in said.out
    assert "gym-open log repair" in said.err
    assert main(["log", "repair", str(path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    saved = path.with_name("stream-002-000-repaired.mcap")
    assert "stream-002-000-repaired.mcap (12 steps)" in shown
    assert re.search(r"missing: all steps after 11; the last [\d,]+ bytes are left out", shown)
    assert f"next: gym-open log replay {saved}" in shown
    assert main(["log", "replay", str(path)]) == 1
    assert "damaged at byte" in capsys.readouterr().err
    assert main(["log", "repair", str(path)]) == 1
    assert "exists already" in capsys.readouterr().err


HOSTILE = "[/nope]\x1b]0;gone\x07:x:\u202e"


def test_text_from_a_log_is_shown_without_effect(
    made_up: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is not read as markup, and its control characters do not reach the terminal."""
    stranger = type(made_up)()
    stranger.head = msgspec.structs.replace(made_up.head, provenance={"code": HOSTILE, "seed": HOSTILE})
    made = [
        msgspec.structs.replace(record, object_names=(HOSTILE, "b", "c"))
        if isinstance(record, SegmentStart)
        else record
        for record in made_up.records()
    ]
    (tmp_path / HOSTILE.replace("/", "")).mkdir()
    (path,) = stranger.write(tmp_path / HOSTILE.replace("/", ""), made)
    path = path.rename(path.with_name("[bold].mcap"))
    assert main(["log", "info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert r"[/nope]\x1b]0;gone\x07:x:\u202e" in "".join(shown.split())
    assert "[bold].mcap" in shown
    assert main(["log", "replay", str(path)]) == 1
    error = capsys.readouterr().err
    assert rf"world, got {HOSTILE[:7]}\x1b]0;gone\x07:x:\u202e, b, c" in error
    assert main(["log", "repair", str(path)]) == 0
    repaired = capsys.readouterr().out
    assert "[bold].mcap is complete, nothing to do" in repaired
    assert all(text.replace("\n", "").isprintable() for text in (shown, repaired, error.splitlines()[-1]))


def test_a_replay_that_cannot_be_made_is_an_error(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "replay", str(whole), "--streams", "0"]) == 2
    assert "holds the streams [2], got [0]" in capsys.readouterr().err
    assert main(["log", "replay", str(whole)]) == 1
    assert "objects of this version's world" in capsys.readouterr().err
