"""Tables of our own beside LeRobot's: streams, worlds, switches and segments, as parquet under `meta/`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.lerobot_files import write_table
from gym_open.datasets.splits import split_of
from gym_open.formats.releases.layout import Table

if TYPE_CHECKING:
    from gym_open.formats.logs.reader import Log
    from gym_open.formats.logs.schemas import Segment

_I, _S, _B, _D = pa.int64(), pa.string(), pa.bool_(), pa.list_(pa.float64())
SCHEMAS: dict[Table, pa.Schema] = {
    "streams": pa.schema([("stream", _I), ("steps", _I), ("config", _S), ("provenance", _S)]),
    "worlds": pa.schema([("stream", _I), ("world", _I), ("puzzle", _S), ("split", _S), ("json", _S)]),
    "switches": pa.schema(
        [("stream", _I), ("step", _I), ("from_world", _I), ("to_world", _I), ("reason", _S), ("world_losses", _D)]
    ),
    "segments": pa.schema(
        [
            *[("stream", _I), ("segment", _I), ("world", _I), ("puzzle", _S), ("first_step", _I), ("steps", _I)],
            *[("continued", _B), ("ended", _S), ("integration_state", _D)],
        ]
    ),
}
"""Columns of each table."""


def write_tables(
    folder: Path, config: ReleaseConfig, logs: "Sequence[Log]", val: frozenset[str], segments: list[dict[str, Any]]
) -> None:
    """Write all four; `segments` are rows of `segment_row`."""
    rows: dict[Table, list[dict[str, Any]]] = {
        "streams": [_stream_row(log) for log in logs],
        "worlds": [row for log in logs for row in _world_rows(config, log, val)],
        "switches": [{"stream": log.stream, **msgspec.structs.asdict(item)} for log in logs for item in log.switches],
        "segments": sorted(segments, key=lambda row: (row["stream"], row["segment"])),
    }
    for name, columns in SCHEMAS.items():
        write_table(pa.Table.from_pylist(rows[name], schema=columns), folder / f"meta/{name}.parquet")


def _stream_row(log: "Log") -> dict[str, Any]:
    config, provenance = (msgspec.json.encode(item, order="sorted").decode() for item in (log.config, log.provenance))
    return {"stream": log.stream, "steps": log.n_steps, "config": config, "provenance": provenance}


def _world_rows(config: ReleaseConfig, log: "Log", val: frozenset[str]) -> list[dict[str, Any]]:
    visited = {switch.to_world for switch in log.switches}
    return [
        {
            "stream": log.stream,
            "world": world,
            "puzzle": puzzle.digest,
            "split": split_of(config, log.stream, puzzle.digest, val) if world in visited else None,
            "json": puzzle.to_json().decode(),
        }
        for world, puzzle in enumerate(log.puzzles)
    ]


def segment_row(segment: "Segment") -> dict[str, Any]:
    """What a replay needs to know of a segment that begins here, the state it begins with included."""
    return {
        "stream": segment.stream,
        "segment": segment.index,
        "world": segment.world,
        "puzzle": segment.puzzle.digest,
        "first_step": segment.first_step,
        "steps": len(segment.actions),
        "continued": segment.continued,
        "ended": segment.ended,
        "integration_state": segment.integration_state,
    }
