"""Our tables: streams, worlds and switches from logs, and segments from episodes."""

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec
import pyarrow as pa

from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.sources import SourceStream
from gym_open.datasets.writing.splits import Unit, unit_of
from gym_open.formats.releases.features import Features
from gym_open.formats.releases.layout import Split, Table
from gym_open.formats.releases.schemas import table_schema


def tables_of_logs(
    config: ReleaseConfig, streams: Iterable[SourceStream], splits: Mapping[Unit, Split], described: Features
) -> dict[Table, pa.Table]:
    """Tables of the logs: their configurations, their pools of puzzles, and the curriculum's switches."""
    streams = list(streams)
    rows: dict[Table, list[dict[str, Any]]] = {
        "streams": [_stream_row(stream) for stream in streams],
        "worlds": [row for stream in streams for row in _world_rows(config, stream, splits)],
        "switches": [
            {"stream": stream.stream, **msgspec.structs.asdict(item)}
            for stream in streams
            for item in stream.log.switches
        ],
    }
    return {name: pa.Table.from_pylist(rows[name], schema=table_schema(name, described)) for name in rows}


def _stream_row(stream: SourceStream) -> dict[str, Any]:
    return {
        "stream": stream.stream,
        "log": stream.parent,
        "log_stream": stream.log.stream,
        "explorer": stream.explorer,
        "steps": stream.log.n_steps,
        "seed": str(stream.log.config.get("seed", "")),
        "config": msgspec.json.encode(stream.log.config, order="sorted").decode(),
    }


def _world_rows(config: ReleaseConfig, stream: SourceStream, splits: Mapping[Unit, Split]) -> list[dict[str, Any]]:
    visited = {switch.to_world for switch in stream.log.switches}
    return [
        {
            "stream": stream.stream,
            "world": world,
            "puzzle": puzzle.digest,
            "split": splits[unit_of(config.split_by, stream.stream, puzzle.digest)] if world in visited else None,
            "json": puzzle.to_json().decode(),
        }
        for world, puzzle in enumerate(stream.log.puzzles)
    ]
