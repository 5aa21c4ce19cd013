"""Write LeRobot v3.0 files with pyarrow: data files, tasks, info.

LeRobot's own writer reaches about 500 frames/s, and its bytes change from run to run. Its reader checks these files.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gym_open.artefacts import canonical_json
from gym_open.formats.releases.features import Features, fps, schema
from gym_open.formats.releases.layout import (
    CODEBASE_VERSION,
    DATA_TEMPLATE,
    IMAGE,
    INFO_PATH,
    MAX_FILES,
    TASKS_PATH,
    VIDEO_TEMPLATE,
)

GROUP_ROWS = 1000
"""Frames at which a row group ends: few enough to read one for a single frame, enough to compress well."""
TASK = "explore the sandbox: no task, no reward"
"""LeRobot needs a sentence for the task; exploration has none."""


def parquet_writer(path: Path, columns: pa.Schema) -> pq.ParquetWriter:
    """Open a writer of `path` and create its folder. It uses Snappy: Rerun silently loads no episode from zstd."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return pq.ParquetWriter(path, columns, compression="snappy", use_dictionary=False)


def write_table(table: pa.Table, path: Path) -> None:
    """Write a small table as parquet."""
    with parquet_writer(path, table.schema) as writer:
        writer.write_table(table)


def write_json(value: Any, path: Path) -> None:
    """Write JSON with sorted keys."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(canonical_json(value))


def frames_batch(described: Features, values: Mapping[str, np.ndarray], pngs: list[bytes] | None) -> pa.RecordBatch:
    """Frames of one episode in Arrow. `values` has all features except the image; `pngs` is None for video."""
    columns: list[pa.Array] = []
    fields = schema(described)
    for field in fields:
        if field.name == IMAGE:
            assert pngs is not None
            paths = pa.nulls(len(pngs), pa.string())
            columns.append(pa.StructArray.from_arrays([pa.array(pngs, pa.binary()), paths], fields=list(field.type)))
        elif values[field.name].ndim == 1:
            columns.append(pa.array(values[field.name], field.type))
        else:
            flat = pa.array(np.ascontiguousarray(values[field.name]).reshape(-1), field.type.value_type)
            columns.append(pa.FixedSizeListArray.from_arrays(flat, type=field.type))
    return pa.RecordBatch.from_arrays(columns, schema=fields)


class DataFile:
    """A data file that grows. Closing writes the footer, without which a parquet file is unreadable."""

    def __init__(self, path: Path, described: Features) -> None:
        self.path = path
        self.bytes = 0
        """Size in memory of the added episodes."""
        self.frames = 0
        self._schema = schema(described)
        self._waiting: list[pa.RecordBatch] = []
        self._writer = parquet_writer(path, self._schema)

    def add(self, batch: pa.RecordBatch) -> None:
        """Add one episode. A row group holds whole episodes."""
        self._waiting.append(batch)
        self.bytes += batch.nbytes
        self.frames += len(batch)
        if sum(len(item) for item in self._waiting) >= GROUP_ROWS:
            self._flush()

    def close(self) -> None:
        """Finish the file."""
        self._flush()
        self._writer.close()

    def _flush(self) -> None:
        if self._waiting:
            table = pa.Table.from_batches(self._waiting, schema=self._schema)
            self._writer.write_table(table, row_group_size=len(table))
            self._waiting = []


def write_tasks(folder: Path) -> None:
    """Write `meta/tasks.parquet`: a pandas frame whose index is the sentence, by which LeRobot finds the task."""
    import pandas as pd

    table = pa.Table.from_pandas(pd.DataFrame({"task_index": [0]}, index=pd.Index([TASK])))
    write_table(table, folder / TASKS_PATH)


def write_info(
    folder: Path, described: Features, *, episodes: int, frames: int, splits: Mapping[str, str], data_file_mb: int,
    ours: Mapping[str, Any],
) -> None:  # fmt: skip
    """Write `meta/info.json`. `ours` goes under the key `gym_open`, which LeRobot ignores."""
    info = {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": "gym-open",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": MAX_FILES,
        "data_files_size_in_mb": data_file_mb,
        "video_files_size_in_mb": data_file_mb,
        "fps": fps(),
        "splits": splits,
        "data_path": DATA_TEMPLATE,
        "video_path": VIDEO_TEMPLATE if described[IMAGE]["dtype"] == "video" else None,
        "features": described,
        "gym_open": ours,
    }
    write_json(info, folder / INFO_PATH)
