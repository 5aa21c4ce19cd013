"""Rows for `meta/` about the episodes of a data file, in the scratch folder until the whole batch is written.

checkpoint/parts/train-000.{episodes,keyframes}.parquet    for the first data file of train
checkpoint/parts/train-000.json                            written last, when the data file is whole
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from gym_open.artefacts import SCRATCH, canonical_json
from gym_open.datasets.writing.lerobot_files import parquet_writer
from gym_open.files import sha256_file, write_atomically

_GROUP_ROWS = 128
"""Number of episodes that are Python objects at the same time: about 75 kB each."""


class Mark(msgspec.Struct, frozen=True):
    """Mark that a data file and the rows about it are whole."""

    episodes: int
    frames: int
    files: dict[str, str]
    """SHA-256 of the data file and of its video, by path in the release."""
    rows: dict[str, str]
    """SHA-256 of the rows about it, by table."""


def sha256_json(value: Any) -> str:
    """SHA-256 of a value as JSON."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


class Part:
    """Rows about the episodes of one data file."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._base = folder / SCRATCH / "parts" / name
        self._writers: dict[str, pq.ParquetWriter] = {}
        self._rows: dict[str, list[dict[str, Any]]] = {}

    def path(self, table: str) -> Path:
        """File with the rows of `table`: `episodes` or `keyframes`."""
        return self._base.with_name(f"{self._base.name}.{table}.parquet")

    def begin(self, columns: Mapping[str, pa.Schema]) -> None:
        """Begin with empty tables of these columns."""
        self._rows = {table: [] for table in columns}
        self._writers = {table: parquet_writer(self.path(table), schema) for table, schema in columns.items()}

    def add(self, table: str, rows: Sequence[dict[str, Any]]) -> None:
        """Add rows to a table."""
        self._rows[table].extend(rows)
        if len(self._rows[table]) >= _GROUP_ROWS:
            self._flush(table)

    def finish(self, episodes: int, frames: int, files: Sequence[str]) -> None:
        """Write all rows to disk, then the mark that they and `files` are whole."""
        for table, writer in self._writers.items():
            self._flush(table)
            writer.close()
            _sync(self.path(table))
        for name in files:
            _sync(self._folder / name)
        hashes = {name: sha256_file(self._folder / name) for name in files}
        rows = {table: sha256_file(self.path(table)) for table in self._writers}
        mark = Mark(episodes, frames, hashes, rows)
        write_atomically(self._base.with_suffix(".json"), canonical_json([sha256_json(mark), mark]))

    def mark(self) -> Mark | None:
        """The mark, if there is one and it fits the files."""
        try:
            said, mark = msgspec.json.decode(self._base.with_suffix(".json").read_bytes(), type=tuple[str, Mark])
            whole = said == sha256_json(mark)
            whole = whole and all(sha256_file(self._folder / name) == digest for name, digest in mark.files.items())
            whole = whole and all(sha256_file(self.path(table)) == digest for table, digest in mark.rows.items())
        except (OSError, msgspec.DecodeError):
            return None
        return mark if whole else None

    def _flush(self, table: str) -> None:
        writer, rows = self._writers[table], self._rows[table]
        if rows:
            writer.write_table(pa.Table.from_pylist(rows, schema=writer.schema))
        self._rows[table] = []


def join(paths: Sequence[Path], out: Path, columns: pa.Schema, prefix: str = "") -> None:
    """Write `columns` of the rows of all `paths`, in order, to `out`. In `paths`, names may begin with `prefix`.

    It reads one row group at a time, so that memory does not grow with the number of rows.
    """
    with parquet_writer(out, columns) as writer:
        for path in paths:
            with pq.ParquetFile(path) as part:
                for group in range(part.num_row_groups):
                    there = part.schema_arrow.names
                    names = [prefix + name if prefix + name in there else name for name in columns.names]
                    table = part.read_row_group(group, columns=names).select(names)
                    writer.write_table(table.rename_columns(columns.names).cast(columns))


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
