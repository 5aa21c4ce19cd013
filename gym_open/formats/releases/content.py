"""Digests of the content of a release; compression, row groups, PNG encoder and division into files do not matter.

    feature   SHA-256 over {"dtype", "shape"} and the frames' values, little-endian, in C order; images as decoded RGB
    episode   SHA-256 over its features' digests and `EPISODE_FACTS`; its position in the release does not matter
    release   SHA-256 over the features' description, the episodes in order, and our tables

All digests are in hex. Only `data_file_digest` depends on the division into files.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from gym_open.artefacts import canonical_json
from gym_open.formats.releases.layout import RECORDS, SIGNATURE

if TYPE_CHECKING:
    import pyarrow as pa

EPISODE_FACTS = ("puzzle", "explorer", "world", "steps", "continued", "ended", "split")
"""Columns of `meta/episodes` that belong to an episode's content."""
EPISODE_PLACES = ("stream", "segment", "piece", "first_step")
"""Columns of `meta/episodes` that say where an episode was recorded; they belong to the release's content."""


class _Hash(Protocol):
    def update(self, data: Any, /) -> None: ...


def _sha256(value: Any) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()


def feature_digest(values: np.ndarray) -> str:
    """Content digest of one feature in one episode; `values` has one row per frame."""
    array = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    total = hashlib.sha256(canonical_json({"dtype": array.dtype.name, "shape": list(array.shape)}))
    total.update(array.data)
    return total.hexdigest()


def episode_digest(features: Mapping[str, str], row: Mapping[str, Any]) -> str:
    """Content digest of an episode.

    Args:
        features: `feature_digest` of each feature except `BOOKKEEPING`.
        row: the episode's row of `meta/episodes`; only the columns `EPISODE_FACTS` are used.
    """
    return _sha256({"features": dict(features), **{name: row[name] for name in EPISODE_FACTS}})


def data_file_digest(episodes: Sequence[str]) -> str:
    """Content digest of a data file, or of its video, from the digests of its episodes."""
    return _sha256(list(episodes))


def table_digest(table: "pa.Table") -> str:
    """Content digest of a table: names, types and values of its columns, sorted by name."""
    total = hashlib.sha256()
    for name in sorted(table.column_names):
        column = table.column(name).combine_chunks()
        total.update(canonical_json({"name": name, "type": _kind(column.type), "rows": len(column)}))
        _add(total, column)
    return total.hexdigest()


def release_digest(
    features: Mapping[str, Any], episodes: Iterable[str], places: "pa.Table", tables: "Mapping[str, pa.Table]"
) -> str:
    """Content digest of a release.

    Args:
        features: LeRobot's description of the features; only `dtype`, `shape` and `names` are used.
        episodes: digests of the episodes, in order.
        places: the columns `EPISODE_PLACES` of `meta/episodes`.
        tables: all rows of each of our tables except `content`, which itself holds digests.
    """
    described = {name: {key: item[key] for key in ("dtype", "shape", "names")} for name, item in features.items()}
    return _sha256(
        {
            "features": described,
            "episodes": list(episodes),
            "places": table_digest(places.select(EPISODE_PLACES)),
            "tables": {name: table_digest(table) for name, table in tables.items() if name != "content"},
        }
    )


def payload_digest(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of a manifest without `RECORDS` and signature, so that unrelated changes of code do not affect it."""
    return _sha256({name: entry for name, entry in manifest.items() if name not in {*RECORDS, SIGNATURE}})


def _kind(kind: "pa.DataType") -> str:
    """Name of a type, independent of Arrow's name for the items of a list."""
    import pyarrow as pa

    if pa.types.is_list(kind):
        return f"list<{_kind(kind.value_type)}>"
    if pa.types.is_fixed_size_list(kind):
        return f"list<{_kind(kind.value_type)}, {kind.list_size}>"
    if pa.types.is_struct(kind):
        return f"struct<{', '.join(f'{field.name}: {_kind(field.type)}' for field in kind.fields)}>"
    return str(kind).removeprefix("large_")  # pandas stores text as large_string


def _add(total: _Hash, array: "pa.Array") -> None:
    """Add the values of a column of numbers, text, lists or structs, and which of them are null."""
    import pyarrow as pa

    if array.null_count:
        total.update(np.packbits(array.is_valid().to_numpy(zero_copy_only=False)).data)
    kind = array.type
    if pa.types.is_struct(kind):
        for i in range(kind.num_fields):
            _add(total, array.field(i))
    elif pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        total.update(array.value_lengths().fill_null(0).to_numpy(zero_copy_only=False).astype("<i8").data)
        _add(total, array.flatten())
    elif str(kind).removeprefix("large_") in {"string", "binary"}:
        texts = [value.as_buffer().to_pybytes() if value.is_valid else b"" for value in array]
        total.update(np.array([len(text) for text in texts], dtype="<i8").data)
        total.update(b"".join(texts))
    elif pa.types.is_primitive(kind):
        zero = False if pa.types.is_boolean(kind) else 0
        values = array.fill_null(zero).to_numpy(zero_copy_only=False)
        total.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).data)
    else:
        raise TypeError(f"columns of type {kind} do not occur in a release")
