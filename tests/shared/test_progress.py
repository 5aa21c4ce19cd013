"""How far a process is, in a file that another process reads."""

from pathlib import Path

import pytest

from gym_open.progress import FILE, Progressed, bar


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b'{"done": "much", "total": 1, "rate": 0}', b"\xff"])
def test_a_file_that_says_nothing_is_no_error(content: bytes, tmp_path: Path) -> None:
    assert Progressed.read(tmp_path / "none") is None
    (tmp_path / "some").write_bytes(content)
    assert Progressed.read(tmp_path / "some") is None


def test_the_end_is_written_at_once_and_what_was_done_before_is_no_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("gym_open.progress.time.monotonic", lambda: now[0])
    monkeypatch.setenv(FILE, str(tmp_path / "said"))
    with bar("work", 100, done=40) as shown:
        assert Progressed.read(tmp_path / "said") == Progressed(40, 100, 0.0)
        now[0] += 0.5
        shown.advance(10)
        assert Progressed.read(tmp_path / "said") == Progressed(40, 100, 0.0)  # not more than once a second
        now[0] += 1.5
        shown.advance(10)
        assert Progressed.read(tmp_path / "said") == Progressed(60, 100, 10.0)
        shown.advance(40)
        assert Progressed.read(tmp_path / "said") == Progressed(100, 100, 30.0)


def test_a_file_that_cannot_be_written_stops_no_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FILE, str(tmp_path / "no such folder" / "said"))
    with bar("work", 2) as shown:
        shown.advance(2)
