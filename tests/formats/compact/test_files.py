"""Compressed rows and numbers come back as they were, and hostile files are refused in bounded memory."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gym_open.errors import ArtefactError
from gym_open.formats.compact import files
from gym_open.formats.compact.files import NumberReader, NumberWriter, read_rows, write_rows


class Row(msgspec.Struct, frozen=True):
    number: int
    text: str


@given(st.lists(st.builds(Row, st.integers(-(2**60), 2**60), st.text(max_size=20))))
def test_rows_come_back(tmp_path_factory: pytest.TempPathFactory, rows: list[Row]) -> None:
    path = tmp_path_factory.mktemp("rows") / "rows.jsonl.zst"
    write_rows(path, rows)
    assert list(read_rows(path, Row)) == rows


@given(arrays(np.float32, st.integers(0, 50)), st.lists(st.integers(0, 20), max_size=5))
def test_numbers_come_back_in_any_portions(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, cuts: list[int]
) -> None:
    path = tmp_path_factory.mktemp("numbers") / "columns" / "x.zst"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "_BLOCK", 8)  # several blocks
        with NumberWriter(path, np.float32) as writer:
            for part in np.split(values, np.minimum(np.cumsum(cuts), len(values)).astype(int)):
                writer.add(part)
        with NumberReader(path, np.float32, len(values)) as reader:
            done, found = 0, []
            for count in [*cuts, len(values)]:
                found.append(reader.take(min(count, len(values) - done)))
                done += len(found[-1])
    assert np.concatenate(found).tobytes() == values.tobytes()  # NaN with their bits, too


def test_uniform_actions_take_hardly_more_than_their_entropy(tmp_path: Path) -> None:
    actions = np.random.default_rng(0).integers(0, 9, 100_000)
    with NumberWriter(tmp_path / "a.zst", np.uint8) as writer:
        writer.add(actions)
    assert (tmp_path / "a.zst").stat().st_size < 1.03 * len(actions) * np.log2(9) / 8


@pytest.mark.parametrize(("total", "what"), [(9, "more numbers"), (11, "fewer numbers")])
def test_another_number_of_numbers_is_refused(tmp_path: Path, total: int, what: str) -> None:
    with NumberWriter(tmp_path / "x.zst", np.uint8) as writer:
        writer.add(np.arange(10))
    with pytest.raises(ArtefactError, match=what), NumberReader(tmp_path / "x.zst", np.uint8, total) as reader:
        reader.take(total)


def _pack(path: Path, data: bytes) -> Path:
    path.write_bytes(zstandard.ZstdCompressor(level=1).compress(data))
    return path


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\n" * 2**24, "row 0|unpacks to more"),
        (b" " * 2**24, "unpacks to more"),
        (b'{"number": 1, "text": "a"}', "no end"),
        (b'{"number": 1, "text": 2}\n', "row 0"),
        (b"\xff\n", "row 0"),
        (b"[" * 100_000 + b"\n", "row 0"),
    ],
)
def test_hostile_rows_are_refused(tmp_path: Path, data: bytes, what: str) -> None:
    with pytest.raises(ArtefactError, match=what):
        list(read_rows(_pack(tmp_path / "rows.zst", data), Row))


def test_a_bomb_of_numbers_is_not_unpacked(tmp_path: Path) -> None:
    path = _pack(tmp_path / "x.zst", bytes(2**28))
    with pytest.raises(ArtefactError, match="more numbers"), NumberReader(path, np.uint8, 10) as reader:
        assert not reader.take(10).any()


@pytest.mark.parametrize("cut", [0, 3, 12])
def test_a_cut_or_changed_file_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "x.zst"
    with NumberWriter(path, np.float32) as writer:
        writer.add(np.arange(100, dtype=np.float32))
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ArtefactError, match=r"x\.zst"), NumberReader(path, np.float32, 100) as reader:
        reader.take(100)


def test_a_missing_file_and_a_link_are_refused(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("/dev/zero")
    for name in ("nothing", "link"):
        with pytest.raises(ArtefactError, match="missing, or a link"):
            list(read_rows(tmp_path / name, Row))
