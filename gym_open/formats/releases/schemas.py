"""Columns of the tables of a release: LeRobot's episodes, and our own."""

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from gym_open.formats.releases.layout import BOOKKEEPING, IMAGE, Table

STATS = "stats/"
"""What columns of `meta/episodes` are called, with `<feature>/<statistic>` after it: statistics of an episode."""
STATISTICS = ("min", "max", "mean", "std", "count")

PIXEL_ERROR = "pixel_error/"
"""What columns of `meta/episodes` are called, with `mean`, `max` or `mse` after it: absolute differences of an
episode's video from the logged pixels, and their mean square, in levels of 255."""

NULLABLE = frozenset({"split"})
"""Columns that may lack a value: a world that was never visited is in no split."""

_I, _S, _B, _D = pa.int64(), pa.string(), pa.bool_(), pa.list_(pa.float64())
_TABLES: dict[Table, list[tuple[str, pa.DataType]]] = {
    "streams": [
        *[("stream", _I), ("log", _I), ("log_stream", _I), ("explorer", _S), ("steps", _I)],
        *[("seed", _S), ("config", _S)],
    ],
    "worlds": [("stream", _I), ("world", _I), ("puzzle", _S), ("split", _S), ("json", _S)],
    "switches": [
        *[("stream", _I), ("step", _I), ("from_world", _I), ("to_world", _I), ("reason", _S), ("world_losses", _D)],
    ],
    "segments": [
        *[("stream", _I), ("segment", _I), ("world", _I), ("puzzle", _S), ("first_step", _I), ("steps", _I)],
        *[("continued", _B), ("ended", _S)],
    ],
    "keyframes": [
        *[("stream", _I), ("segment", _I), ("segment_step", _I), ("episode_index", _I), ("frame_index", _I)],
        ("integration_state", _D),
    ],
}
EPISODE_ROW: list[tuple[str, pa.DataType]] = [
    *[("stream", _I), ("explorer", _S), ("segment", _I), ("piece", _I), ("world", _I), ("puzzle", _S)],
    *[("first_step", _I), ("steps", _I), ("continued", _B), ("ended", _S), ("split", _S)],
]
"""Columns of `meta/episodes` that are ours."""
_EPISODES: list[tuple[str, pa.DataType]] = [
    *[("episode_index", _I), ("tasks", pa.list_(_S)), ("length", _I)],
    *[("dataset_from_index", _I), ("dataset_to_index", _I), ("data/chunk_index", _I), ("data/file_index", _I)],
    *EPISODE_ROW,
    *[("meta/episodes/chunk_index", _I), ("meta/episodes/file_index", _I)],
]
_VIDEO: list[tuple[str, pa.DataType]] = [
    *[(f"videos/{IMAGE}/chunk_index", _I), (f"videos/{IMAGE}/file_index", _I)],
    *[(f"videos/{IMAGE}/from_timestamp", pa.float64()), (f"videos/{IMAGE}/to_timestamp", pa.float64())],
    *[(f"{PIXEL_ERROR}{name}", pa.float64()) for name in ("mean", "max", "mse")],
]


def table_schema(name: Table, features: Mapping[str, Any]) -> pa.Schema:
    """Columns of one of our tables in a release with these features."""
    if name == "content":
        return pa.schema([("episode_index", _I), *[(item, _S) for item in content_features(features)]])
    return pa.schema(_TABLES[name])


def episodes_schema(features: Mapping[str, Any]) -> pa.Schema:
    """Columns of `meta/episodes` in a release with these features."""
    video = _VIDEO if features[IMAGE]["dtype"] == "video" else []
    stats = [(f"{STATS}{name}/{item}", _statistic(name, item)) for name in sorted(features) for item in STATISTICS]
    return pa.schema([*_EPISODES, *video, *stats])


def content_features(features: Mapping[str, Any]) -> list[str]:
    """The features that have a content digest: all but the bookkeeping, by name."""
    return sorted(name for name in features if name not in BOOKKEEPING)


def _statistic(feature: str, statistic: str) -> pa.DataType:
    if statistic == "count":
        return pa.list_(_I)
    return pa.list_(pa.list_(_D)) if feature == IMAGE else _D
