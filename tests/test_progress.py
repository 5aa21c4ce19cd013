"""Progress in a file for another process, in lines, and as a bar on a terminal."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gym_open import progress
from gym_open.progress import FILE, Lines, Progressed, Waiting, bar, doing, duration, speed
from tests.children import python, started


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b'{"done": "much", "total": 1, "rate": 0}', b"\xff"])
def test_an_unreadable_file_is_no_error(content: bytes, tmp_path: Path) -> None:
    assert Progressed.read(tmp_path / "none") is None
    (tmp_path / "some").write_bytes(content)
    assert Progressed.read(tmp_path / "some") is None


def test_the_end_is_written_at_once_and_earlier_units_do_not_count_for_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("gym_open.progress.time.monotonic", lambda: now[0])
    monkeypatch.setenv(FILE, str(tmp_path / "said"))
    with bar("work", 100, done=40) as shown:
        assert Progressed.read(tmp_path / "said") == Progressed(40, 100, 0.0)
        now[0] += 0.5
        shown.advance(10)
        assert Progressed.read(tmp_path / "said") == Progressed(40, 100, 0.0)  # at most once per second
        now[0] += 1.5
        shown.advance(10)
        assert Progressed.read(tmp_path / "said") == Progressed(60, 100, 10.0)
        shown.advance(40)
        assert Progressed.read(tmp_path / "said") == Progressed(100, 100, 30.0)


def test_a_file_that_cannot_be_written_stops_no_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FILE, str(tmp_path / "no such folder" / "said"))
    with bar("work", 2) as shown:
        shown.advance(2)


@pytest.fixture
def nothing_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even on a slow machine, no line is written between start and end."""
    monkeypatch.setattr(progress, "EVERY", 1e6)


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_lines_give_units_speed_and_remaining_time() -> None:
    said, clock = list[str](), Clock()
    lines = Lines("exploring", 20_480, write_line=said.append, clock=clock)
    lines.now()  # the speed is unknown yet
    clock.now += 10
    lines.advance(3_310, "2 of 12 worlds")
    lines.now()
    clock.now += 40
    lines.advance(3_310, None)
    lines.now()
    clock.now += 10
    lines.advance(13_860, "learned")
    lines.end()
    assert said == [
        "exploring: 0 of 20,480",
        "exploring: 0 of 20,480 (0%)",
        "exploring: 3,310 of 20,480 (16%), 331/s, 52 s left; 2 of 12 worlds",
        "exploring: 6,620 of 20,480 (32%), 132/s, 2 min left; 2 of 12 worlds",
        "exploring: 20,480 of 20,480 in 60 s, 341/s; learned",
    ]


def test_earlier_units_are_written_and_do_not_count_for_speed() -> None:
    said, clock = list[str](), Clock()
    lines = Lines("work", 100, done=40, write_line=said.append, clock=clock)
    clock.now += 4
    lines.advance(1, None)
    lines.now()
    lines.end()  # it may end before all units are done
    assert said == [
        "work: goes on at 40 of 100",
        "work: 41 of 100 (41%), 0.2/s, 4 min left",
        "work: 41 of 100 in 4.0 s, 0.2/s",
    ]


def test_work_without_units_does_not_divide_by_zero() -> None:
    said, clock = list[str](), Clock()
    lines = Lines("read", 0, write_line=said.append, clock=clock)
    lines.now()
    lines.end()
    assert said == ["read: 0 of 0", "read: 0 of 0 (0%)", "read: 0 of 0 in 0.0 s"]


def test_work_without_a_count_gives_its_time_so_far() -> None:
    said, clock = list[str](), Clock()
    plain, why = (Waiting("probe", hint, write_line=said.append, clock=clock) for hint in ("", "it is large"))
    clock.now += 100
    plain.now()
    why.now()
    assert said == ["probe: 2 min so far", "probe: 2 min so far (it is large)"]


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.2, "0 s"), (89.4, "89 s"), (90, "2 min"), (5_400, "1 h 30 min"), (86_399, "24 h 00 min")]
)
def test_durations_are_short(seconds: float, words: str) -> None:
    assert duration(seconds) == words


@pytest.mark.parametrize(("rate", "words"), [(12_345.6, "12,346/s"), (9.96, "10.0/s"), (0.034, "0.03/s")])
def test_speeds_are_short(rate: float, words: str) -> None:
    assert speed(rate) == words


@pytest.mark.usefixtures("nothing_between")
def test_without_a_terminal_progress_is_in_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with doing("loading"), bar("work", 2) as shown:
        shown.advance(2, "done")
    before, start, end = capsys.readouterr().err.splitlines()
    assert (before, start) == ("loading …", "work: 0 of 2")
    assert end.startswith("work: 2 of 2 in ")
    assert end.endswith("; done")


@pytest.mark.usefixtures("nothing_between")
def test_after_an_error_no_line_says_that_work_has_ended(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="broken"), bar("work", 2):
        raise ValueError("broken")
    assert capsys.readouterr().err == "work: 0 of 2\n"


def test_quiet_progress_writes_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress.console, "quiet", True)
    with doing("loading"), bar("work", 2) as shown:
        shown.advance(2)
    assert capsys.readouterr().err == ""


WORKS = """
import sys
from gym_open import progress
progress.EVERY = 0.01
with progress.stage("outer"):
    print("a", flush=True)
    sys.stdin.readline()
    with progress.bar("inner", 3) as shown:
        shown.advance(1, "a note")
        sys.stdin.readline()
        shown.advance(2)
"""


@pytest.mark.parametrize("colour", [{}, {"FORCE_COLOR": "1"}, {"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_a_pipe_gets_each_line_at_once_from_the_innermost_work(colour: dict[str, str]) -> None:
    """CI may force colours, but draws no bars. The test waits for each line, not for a time."""
    words = [sys.executable, "-c", WORKS]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with started(words, env={**os.environ, **colour}, **pipes) as process:
        assert process.stderr is not None
        assert process.stdin is not None
        assert process.stderr.readline().startswith("outer: 0 s so far")
        process.stdin.write("\n")
        process.stdin.flush()
        line = next(line for line in process.stderr if not line.startswith("outer: "))
        assert line == "inner: 0 of 3\n"
        line = next(line for line in process.stderr if "1 of 3 (33%)" in line)  # written during the wait
        assert line.endswith("; a note\n")
        process.stdin.write("\n")
        process.stdin.flush()
        *between, last = [line for line in process.stderr if not line.startswith("outer: ")]
        assert all(line.startswith("inner: ") for line in between)
        assert last.startswith("inner: 3 of 3 in ")
        assert process.wait() == 0


def test_work_goes_on_if_nobody_reads_standard_error() -> None:
    read, write = os.pipe()
    os.close(read)
    done = python("from gym_open.progress import bar\nwith bar('a', 1): print('worked')", stderr=write)
    os.close(write)
    assert (done.returncode, done.stdout) == (0, "worked\n")


@pytest.mark.parametrize(("term", "drawn"), [("xterm", True), ("dumb", False)])
def test_a_terminal_gets_a_bar_if_it_can_draw_one(term: str, drawn: bool) -> None:
    code = """
from gym_open.progress import bar, doing
with doing("loading"):
    pass
with bar("work", 2) as shown:
    shown.advance(2)
"""
    ours, theirs = os.openpty()
    with started([sys.executable, "-c", code], stderr=theirs, env={**os.environ, "TERM": term}) as process:
        os.close(theirs)
        said = b"".join(_all_of(ours)).decode()
        assert process.wait() == 0
    assert ("━" in said and "2/2" in said) == drawn
    assert ("work: 0 of 2" in said) == (not drawn)


def _all_of(terminal: int) -> Iterator[bytes]:
    with suppress(OSError):  # a terminal ends like this
        while said := os.read(terminal, 65_536):
            yield said
    os.close(terminal)
