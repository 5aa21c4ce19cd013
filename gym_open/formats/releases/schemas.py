"""Columns of the tables of a release: LeRobot's `meta/episodes` and our own tables."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gym_open.formats.releases.layout import BOOKKEEPING, IMAGE, Table

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pyarrow as pa

STATS = "stats/"
"""Prefix of the columns of `meta/episodes` with an episode's statistics; `<feature>/<statistic>` follows."""
STATISTICS = ("min", "max", "mean", "std", "count")

PIXEL_ERROR = "pixel_error/"
"""Prefix of the columns of `meta/episodes` with the error of an episode's video. `mean` or `max` follows for the
absolute difference from the logged pixels, `mse` for the mean square difference; in levels of 255."""

NULLABLE = frozenset({"split"})
"""Columns that may lack a value: a world that was never visited belongs to no split."""

Columns = list[tuple[str, str]]
"""Names and Arrow types."""
_I, _S, _B, _D = "int64", "string", "bool", "list<double>"
_TABLES: dict[Table, Columns] = {
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
EPISODE_ROW: Columns = [
    *[("stream", _I), ("explorer", _S), ("segment", _I), ("piece", _I), ("world", _I), ("puzzle", _S)],
    *[("first_step", _I), ("steps", _I), ("continued", _B), ("ended", _S), ("split", _S)],
]
"""Our own columns of `meta/episodes`."""
_EPISODES: Columns = [
    *[("episode_index", _I), ("tasks", "list<string>"), ("length", _I)],
    *[("dataset_from_index", _I), ("dataset_to_index", _I), ("data/chunk_index", _I), ("data/file_index", _I)],
    *EPISODE_ROW,
    *[("meta/episodes/chunk_index", _I), ("meta/episodes/file_index", _I)],
]
_VIDEO: Columns = [
    *[(f"videos/{IMAGE}/chunk_index", _I), (f"videos/{IMAGE}/file_index", _I)],
    *[(f"videos/{IMAGE}/from_timestamp", "double"), (f"videos/{IMAGE}/to_timestamp", "double")],
    *[(f"{PIXEL_ERROR}{name}", "double") for name in ("mean", "max", "mse")],
]


def table_schema(name: Table, features: Mapping[str, Any]) -> "pa.Schema":
    """Columns of one of our tables in a release with these features."""
    if name == "content":
        return _schema([("episode_index", _I), *[(item, _S) for item in content_features(features)]])
    lost = () if "world_model.loss" in features else ("world_losses",)
    return _schema([(column, kind) for column, kind in _TABLES[name] if column not in lost])


def episodes_schema(features: Mapping[str, Any]) -> "pa.Schema":
    """Columns of `meta/episodes` in a release with these features."""
    video = _VIDEO if features[IMAGE]["dtype"] == "video" else []
    stats = [(f"{STATS}{name}/{item}", _statistic(name, item)) for name in sorted(features) for item in STATISTICS]
    return _schema([*_EPISODES, *video, *stats])


def content_features(features: Mapping[str, Any]) -> list[str]:
    """Names of the features that have a content digest: all except `BOOKKEEPING`, sorted."""
    return sorted(name for name in features if name not in BOOKKEEPING)


def _statistic(feature: str, statistic: str) -> str:
    if statistic == "count":
        return "list<int64>"
    return "list<list<list<double>>>" if feature == IMAGE else _D


def _schema(columns: Columns) -> "pa.Schema":
    import pyarrow as pa

    return pa.schema([(name, _arrow(kind)) for name, kind in columns])


def _arrow(kind: str) -> "pa.DataType":
    import pyarrow as pa

    inner = kind.removeprefix("list<")
    return pa.type_for_alias(kind) if inner == kind else pa.list_(_arrow(inner[:-1]))
