"""What `meta/` will say of a data file's episodes, kept in the scratch folder until all of a batch is written.

checkpoint/parts/train-000.{episodes,keyframes}.parquet    of train's first data file
checkpoint/parts/train-000.json                            written last, when that file is whole
"""

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
"""Episodes in memory as Python objects at a time: some 75 kB each."""


class Mark(msgspec.Struct, frozen=True):
    """A data file is whole, and so are the rows about it."""

    episodes: int
    frames: int
    files: dict[str, str]
    """SHA-256 of the data file, and of the video beside it, by name below the release's folder."""


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
        """Begin anew, with these columns of each table."""
        self._rows = {table: [] for table in columns}
        self._writers = {table: parquet_writer(self.path(table), schema) for table, schema in columns.items()}

    def add(self, table: str, rows: Sequence[dict[str, Any]]) -> None:
        """Add rows to a table."""
        self._rows[table].extend(rows)
        if len(self._rows[table]) >= _GROUP_ROWS:
            self._flush(table)

    def finish(self, episodes: int, frames: int, files: Sequence[str]) -> None:
        """Put on disk what was added, then the mark that it and `files` are whole."""
        for table, writer in self._writers.items():
            self._flush(table)
            writer.close()
            _sync(self.path(table))
        for name in files:
            _sync(self._folder / name)
        hashes = {name: sha256_file(self._folder / name) for name in files}
        write_atomically(self._base.with_suffix(".json"), canonical_json(Mark(episodes, frames, hashes)))

    def mark(self) -> Mark | None:
        """The mark, if there is one and the files are those that it was made for."""
        try:
            mark = msgspec.json.decode(self._base.with_suffix(".json").read_bytes(), type=Mark)
            whole = all(sha256_file(self._folder / name) == digest for name, digest in mark.files.items())
        except (OSError, msgspec.DecodeError):
            return None
        return mark if whole else None

    def _flush(self, table: str) -> None:
        writer, rows = self._writers[table], self._rows[table]
        if rows:
            writer.write_table(pa.Table.from_pylist(rows, schema=writer.schema))
        self._rows[table] = []


def join(paths: Sequence[Path], out: Path, columns: pa.Schema, prefix: str = "") -> None:
    """Write `out` with the rows of all `paths`, in their order: the `columns`, called so with `prefix` before it there.

    A row group at a time, so that memory does not grow with the number of rows.
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
