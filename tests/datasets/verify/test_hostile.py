"""Releases that mean harm: refused with words, without a traceback, and without doing what they ask for."""

import json
import pickle
import resource
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open.artefacts import canonical_json
from gym_open.datasets.verify import VerificationReport
from gym_open.errors import ArtefactError
from gym_open.formats.releases import IMAGE, open_release, parquet

Quick = Callable[[Path], VerificationReport]
Reseal = Callable[[Path], None]
DATA = "data/chunk-000/file-000.parquet"
INFO = "meta/info.json"


@pytest.fixture(autouse=True)
def little_memory() -> Iterator[None]:
    """What unpacks to much fails, rather than take the machine down."""
    usual, most = resource.getrlimit(resource.RLIMIT_DATA)
    used = int(next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmData" in line).split()[1])
    resource.setrlimit(resource.RLIMIT_DATA, (used * 1024 + 2**30, most))
    yield
    resource.setrlimit(resource.RLIMIT_DATA, (usual, most))


def change_info(**values: Any) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        info = json.loads((root / INFO).read_text())
        (root / INFO).write_text(json.dumps(info | values))
        return INFO

    return change


def change_ours(**values: Any) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        info = json.loads((root / INFO).read_text())
        info["gym_open"] |= values
        (root / INFO).write_text(json.dumps(info))
        return INFO

    return change


def deep(name: str) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        (root / name).write_text('{"a":' + "[" * 100_000 + "]" * 100_000 + "}")
        return name

    return change


def extra(name: str, data: bytes) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)
        return name

    return change


def footer(length: int) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        data = (root / DATA).read_bytes()
        (root / DATA).write_bytes(data[:-8] + struct.pack("<I", length) + b"PAR1")
        return DATA

    return change


def rewritten(make: Callable[[pa.Table], pa.Table], name: str = DATA, **options: Any) -> Callable[[Path], str]:
    """Another table in a file's place, written in another way."""

    def change(root: Path) -> str:
        table = make(pq.ParquetFile(root / name).read())
        pq.write_table(table, root / name, **{"compression": "snappy", "use_dictionary": False, **options})
        return name

    return change


def repeated(table: pa.Table) -> pa.Table:
    """Many times the first frame: some kB, by a dictionary, which unpack to a thousand times as much."""
    return table.take(pa.array(np.zeros(4000, np.int64)))


def nothing(table: pa.Table) -> pa.Table:
    """A hundred thousand rows without a value: some kB, too."""
    return pa.table({field.name: pa.nulls(10**5, field.type) for field in table.schema})


def with_picture(data: bytes) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        place = table.schema.get_field_index(IMAGE)
        files = [data, *(row["bytes"] for row in table.column(IMAGE).to_pylist()[1:])]
        kind = table.schema.field(IMAGE).type
        column = pa.StructArray.from_arrays(
            [pa.array(files, pa.binary()), pa.nulls(len(files), pa.string())], fields=list(kind)
        )
        return table.set_column(place, table.schema.field(IMAGE), column)

    return change


def png(width: int, height: int, extra_chunk: bytes = b"") -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    rows = zlib.compress(bytes((1 + 3 * 84) * 84))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra_chunk + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def text_bomb() -> bytes:
    data = b"x\0\0" + zlib.compress(bytes(2**24))
    return struct.pack(">I", len(data)) + b"zTXt" + data + struct.pack(">I", zlib.crc32(b"zTXt" + data))


def linked(name: str) -> Callable[[Path], str]:
    def change(root: Path) -> str:
        elsewhere = root.parent / "elsewhere"
        shutil.move(root / name, elsewhere)
        (root / name).symlink_to(elsewhere)
        return name

    return change


def retyped(table: pa.Table) -> pa.Table:
    return table.set_column(
        table.schema.get_field_index("timestamp"), "timestamp", table["timestamp"].cast(pa.float64())
    )


HOSTILE: dict[str, tuple[Callable[[Path], str], str]] = {
    "template": (change_info(data_path="../../{chunk_index}/{file_index}.parquet"), "data_path must be"),
    "absolute template": (change_info(data_path="/etc/{chunk_index}{file_index}"), "data_path must be"),
    "format string": (change_info(data_path="{chunk_index.__class__.__mro__}{file_index}"), "data_path must be"),
    "video template": (change_info(video_path="../{video_key}/{chunk_index}{file_index}"), "video_path must be"),
    "no number": (change_info(total_frames=float("nan")), "not readable"),
    "fraction": (change_info(total_frames=1.5), "total_frames"),
    "negative": (change_info(total_episodes=-1), "total_episodes"),
    "huge": (change_info(total_frames=10**18), "total_frames"),
    "too many frames": (change_info(total_frames=10**9), "frames"),
    "text for a number": (change_info(total_episodes="8"), "total_episodes"),
    "feature": (change_info(features={"observation.image": {"dtype": "image", "shape": [10**6, 10**6, 3]}}), "feature"),
    "rate": (change_info(fps=1e-9), "fps must be"),
    "unknown field": (change_info(trust_remote_code=True), "trust_remote_code"),
    "another format": (change_ours(format="gym-open-release/9"), "gym_open.format must be"),
    "name": (change_ours(name="../../etc"), "gym_open.name"),
    "objects": (change_ours(objects=["agent", "\x1b[2J"]), "gym_open.objects"),
    "batches": (change_ours(batches=10**6), "gym_open.batches"),
    **{f"deep {name}": (deep(name), "not readable") for name in (INFO, "meta/stats.json", "meta/digests.json")},
    **{f"deep {name}": (deep(name), "not readable") for name in ("config.json", "lineage.json", "croissant.json")},
    "deep manifest": (deep("manifest.json"), "not readable"),
    "pickle": (extra("data/chunk-000/file-000.pkl", pickle.dumps({"a": 1})), "has such a file"),
    "code": (extra("explore.py", b"print(1)"), "has such a file"),
    "another data file": (extra("data/chunk-007/file-000.parquet", b"PAR1"), "belongs to no episode"),
    "footer beyond the file": (footer(2**31 - 1), "footer"),
    "footer over the limit": (footer(2**25), "footer"),
    "footer of nothing": (footer(0), "parquet"),
    "no parquet": (extra(DATA, pickle.dumps([1])), "footer"),
    "dictionary": (rewritten(repeated, use_dictionary=True), "dictionary"),
    "rows of nothing": (rewritten(nothing), "rows in"),
    "another codec": (rewritten(lambda table: table, compression="zstd"), "ZSTD"),
    "missing column": (rewritten(lambda table: table.drop_columns(["action"])), "columns"),
    "another type": (rewritten(retyped), "should be float"),
    "table of another schema": (rewritten(lambda t: t.rename_columns([f"{c}2" for c in t.column_names]),
                                          "meta/worlds/file-000.parquet"), "columns"),
    "picture of another size": (rewritten(with_picture(png(50_000, 50_000))), "no PNG file"),
    "picture of no kind": (rewritten(with_picture(pickle.dumps({}))), "no PNG file"),
    "picture with long text": (rewritten(with_picture(png(84, 84, text_bomb()))), "PNG file"),
    "link": (linked(DATA), "links"),
    "linked folder": (linked("meta"), "links"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_it_is_refused_in_words(case: str, release: Path, reseal: Reseal, quick: Quick) -> None:
    """As it is, for its bytes; with its manifest made anew, for what it is."""
    change, words = HOSTILE[case]
    named = change(release)
    for resealed in (False, True):
        if resealed and named != "manifest.json":
            reseal(release)
        report = quick(release)
        assert not report.good
        told = report.problems
        assert any(named in text for problem in told for text in (problem.file, problem.what)), told
        assert any(words in problem.what for problem in told) or not resealed, told
        assert not any("cannot be checked" in problem.what for problem in told), told


def test_a_page_that_says_that_it_unpacks_to_more_is_not_unpacked(tmp_path: Path) -> None:
    """The second field of the first page's header is its size when unpacked: 160 kB, here made 1 MB."""
    path, at = tmp_path / "x.parquet", 7
    values = np.append(np.random.default_rng(0).integers(2**60, size=2500), np.zeros(17_500, np.int64))
    table = pa.table({"a": values})
    pq.write_table(table, path, compression="snappy", use_dictionary=False)
    assert parquet.read(path, table.schema).equals(table)
    data = bytearray(path.read_bytes())
    assert data[at - 1] == 0x15  # the next field, of 32 bits
    assert data[at + 2] < 128 <= data[at + 1]  # a number of three bytes
    data[at : at + 3] = b"\xfe\xff\x7f"
    path.write_bytes(data)
    with pytest.raises(ArtefactError, match="claims to unpack to 1,048,575"):
        parquet.read(path, table.schema)


def test_a_dictionary_that_the_footer_does_not_tell_of_is_found(tmp_path: Path) -> None:
    """The footer's place of the dictionary, and that it has one, are left out: pages tell."""
    path = tmp_path / "x.parquet"
    table = pa.table({"a": ["x" * 1000] * 1000})
    pq.write_table(table, path, compression="snappy", use_dictionary=True)
    with pq.ParquetFile(path) as file:
        chunk = file.metadata.row_group(0).column(0)
        page = chunk.dictionary_page_offset
    with path.open("rb") as file, pytest.raises(ValueError, match="a page of type 2, expected data"):
        parquet._check_chunk(file, _Told(page, chunk), 1000)


class _Told:
    """A column chunk as a lying footer has it."""

    def __init__(self, page: int, chunk: Any) -> None:
        self.data_page_offset = page
        self.total_compressed_size = chunk.total_compressed_size
        self.num_values = chunk.num_values
        self.total_uncompressed_size = chunk.total_uncompressed_size
        self.physical_type = chunk.physical_type


def test_nothing_is_opened_by_a_name_that_the_release_gives(release: Path, reseal: Reseal, quick: Quick) -> None:
    """A manifest whose entries leave the folder."""
    (release.parent / "secret").write_text("mine")
    reseal(release)
    manifest = json.loads((release / "manifest.json").read_text())
    for name in ("../secret", "/etc/hostname", "meta/../../secret", "a\\b", ".", "x\x1by"):
        entry = {name: {"sha256": "0" * 64, "bytes": 4}}
        (release / "manifest.json").write_bytes(canonical_json({**manifest, **entry}))
        report = quick(release)
        assert any(problem.file == name and "may not list" in problem.what for problem in report.problems), name
        with pytest.raises(ArtefactError, match="may not list"):
            open_release(release)


def test_a_manifest_written_in_another_way_is_told(release: Path, quick: Quick) -> None:
    manifest = msgspec.json.decode((release / "manifest.json").read_bytes())
    (release / "manifest.json").write_bytes(msgspec.json.encode(manifest))
    assert [problem.file for problem in quick(release).problems] == ["manifest.json"]
