"""Writes LeRobot v3.0 files with pyarrow: data files that roll at a size, episodes, tasks, info and statistics.

LeRobot's own writer does some 500 frames/s and its bytes change from run to run; its reader is the judge of these.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gym_open.artefacts import canonical_json
from gym_open.formats.releases.features import Features, fps, schema
from gym_open.formats.releases.layout import CODEBASE_VERSION, EPISODES_PATH, IMAGE, INFO_PATH, STATS_PATH, TASKS_PATH

CHUNK_FILES = 1000
"""Files in a chunk folder."""
GROUP_ROWS = 1000
"""A row group is closed at this many frames: small enough to read one for a single frame, large enough to compress."""
TASK = "explore the sandbox: no task, no reward"
"""LeRobot wants a sentence for the task; play has none."""


def write_table(table: pa.Table, path: Path) -> None:
    """Write a small table as parquet (snappy: a later Rerun silently loads no episode from zstd)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="snappy", use_dictionary=False)


def write_json(value: Any, path: Path) -> None:
    """Write JSON with sorted keys."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(canonical_json(value))


class DataFiles:
    """The growing data files. Closing writes the footer: without it a parquet file is lost."""

    def __init__(self, folder: Path, described: Features, limit_bytes: int) -> None:
        self._folder = folder
        self._features = described
        self._schema = schema(described)
        self._limit = limit_bytes
        self._file = 0
        self._bytes = 0
        self._waiting: list[pa.RecordBatch] = []
        self._writer: pq.ParquetWriter | None = None

    def add(self, numbers: dict[str, np.ndarray], pngs: list[bytes]) -> tuple[int, int]:
        """Add one episode and return the chunk and the file that it is in."""
        batch = self._batch(numbers, pngs)
        if self._bytes and self._bytes + batch.nbytes > self._limit:
            self.close()
            self._file += 1
        self._waiting.append(batch)
        self._bytes += batch.nbytes
        if sum(len(item) for item in self._waiting) >= GROUP_ROWS:
            self._flush()
        return divmod(self._file, CHUNK_FILES)

    def close(self) -> None:
        """Finish the file in hand."""
        self._flush()
        if self._writer is not None:
            self._writer.close()
        self._writer, self._bytes = None, 0

    def _batch(self, numbers: dict[str, np.ndarray], pngs: list[bytes]) -> pa.RecordBatch:
        columns: list[pa.Array] = []
        for field in self._schema:
            if field.name == IMAGE:
                paths = pa.nulls(len(pngs), pa.string())
                columns.append(
                    pa.StructArray.from_arrays([pa.array(pngs, pa.binary()), paths], fields=list(field.type))
                )
                continue
            values = numbers[field.name]
            if values.ndim == 1:
                columns.append(pa.array(values, field.type))
            else:
                flat = pa.array(np.ascontiguousarray(values).reshape(-1), field.type.value_type)
                columns.append(pa.FixedSizeListArray.from_arrays(flat, type=field.type))
        return pa.RecordBatch.from_arrays(columns, schema=self._schema)

    def _flush(self) -> None:
        if not self._waiting:
            return
        if self._writer is None:
            chunk, file = divmod(self._file, CHUNK_FILES)
            path = self._folder / f"data/chunk-{chunk:03d}/file-{file:03d}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema, compression="snappy", use_dictionary=False)
        table = pa.Table.from_batches(self._waiting, schema=self._schema)
        self._writer.write_table(table, row_group_size=len(table))
        self._waiting = []


def write_tasks(folder: Path) -> None:
    """Write `meta/tasks.parquet`: a pandas frame whose index is the sentence, as LeRobot looks it up."""
    import pandas as pd

    table = pa.Table.from_pandas(pd.DataFrame({"task_index": [0]}, index=pd.Index([TASK])))
    write_table(table, folder / TASKS_PATH)


def write_episodes(rows: list[dict[str, Any]], folder: Path) -> None:
    """Write `meta/episodes`: LeRobot's columns, and ours as they are in `rows`."""
    places = {"tasks": [TASK], "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
    write_table(pa.Table.from_pylist([{**row, **places} for row in rows]), folder / EPISODES_PATH)


def write_info(
    folder: Path, described: Features, *, episodes: int, frames: int, splits: dict[str, str], data_file_mb: int,
    ours: dict[str, Any],
) -> None:  # fmt: skip
    """Write `meta/info.json`; `ours` goes under the key `gym_open`, which LeRobot ignores."""
    info = {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": "gym-open",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": data_file_mb,
        "video_files_size_in_mb": data_file_mb,
        "fps": fps(),
        "splits": splits,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": described,
        "gym_open": ours,
    }
    write_json(info, folder / INFO_PATH)


def write_stats(stats: dict[str, Any], folder: Path) -> None:
    """Write `meta/stats.json`."""
    write_json(stats, folder / STATS_PATH)
