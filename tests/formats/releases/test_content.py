"""Content digests depend on every value and not on how it is stored."""

import hashlib
import io
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.formats.releases.content import (
    EPISODE_FACTS,
    EPISODE_PLACES,
    episode_digest,
    feature_digest,
    payload_digest,
    release_digest,
    table_digest,
)

TABLE = pa.table(
    {
        "number": pa.array([1, 2, None, 4], pa.int64()),
        "text": pa.array(["a", "", None, "bc"], pa.string()),
        "flag": pa.array([True, False, None, True], pa.bool_()),
        "state": pa.array([[1.0, float("nan")], [], None, [0.5]], pa.list_(pa.float64())),
        "vector": pa.array([[1.0, 2.0]] * 4, pa.list_(pa.float32(), 2)),
        "nested": pa.array([[[[1.0]]]] * 4, pa.list_(pa.list_(pa.list_(pa.float64())))),
        "picture": pa.array(
            [{"bytes": b"x", "path": None}] * 4, pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        ),
    }
)
ROW: dict[str, Any] = {
    "puzzle": "ab",
    "explorer": "icm",
    "world": 0,
    "steps": 3,
    "continued": False,
    "ended": "budget",
    "split": "train",
    "stream": 0,
    "segment": 0,
    "piece": 0,
    "first_step": 0,
}


def again(table: pa.Table, **how: Any) -> pa.Table:
    file = io.BytesIO()
    pq.write_table(table, file, **how)
    return pq.read_table(io.BytesIO(file.getvalue()))


def test_a_feature_is_hashed_as_the_docs_say() -> None:
    """Computed here independently: SHA-256 over canonical JSON of type and shape, then the bytes."""
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    head = b'{\n "dtype": "float32",\n "shape": [\n  2,\n  3\n ]\n}\n'
    assert json.loads(head) == {"dtype": "float32", "shape": [2, 3]}
    assert feature_digest(values) == hashlib.sha256(head + values.tobytes()).hexdigest()
    assert feature_digest(values.astype(">f4")) == feature_digest(values)
    assert feature_digest(np.asfortranarray(values)) == feature_digest(values)
    others = [values.reshape(3, 2), values.astype(np.float64), values.view(np.int32), values + np.float32(1e-6)]
    assert len({feature_digest(other) for other in [values, *others]}) == 5


@given(st.integers(0, 84 * 84 * 3 - 1), st.integers(1, 255))
def test_any_pixel_counts(place: int, change: int) -> None:
    image = np.zeros((1, 84, 84, 3), dtype=np.uint8)
    before = feature_digest(image)
    image.reshape(-1)[place] += np.uint8(change)
    assert feature_digest(image) != before


@pytest.mark.parametrize(
    "how", [{"compression": "zstd"}, {"compression": "none"}, {"row_group_size": 1}, {"use_dictionary": False}]
)
def test_a_table_is_the_same_however_it_is_written(how: Mapping[str, Any]) -> None:
    assert table_digest(again(TABLE, **how)) == table_digest(TABLE)
    chunks = pa.concat_tables([TABLE.slice(0, 1), TABLE.slice(1)])
    assert table_digest(chunks) == table_digest(TABLE)
    assert table_digest(TABLE.select(TABLE.column_names[::-1])) == table_digest(TABLE)
    assert table_digest(TABLE.set_column(1, "text", TABLE["text"].cast(pa.large_string()))) == table_digest(TABLE)


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("number", [1, 2, None, 5]),
        ("number", [1, 2, 0, 4]),
        ("text", ["a", "", "", "bc"]),
        ("text", ["a", "b", None, "c"]),
        ("flag", [True, False, False, True]),
        ("state", [[1.0], [float("nan")], None, [0.5]]),
        ("state", [[1.0, float("nan")], [], [], [0.5]]),
        ("nested", [[[[1.0]]], [[[1.0]]], [[[1.0], []]], [[[1.0]]]]),
        ("picture", [{"bytes": b"x", "path": None}] * 3 + [{"bytes": b"x", "path": ""}]),
    ],
)
def test_every_value_of_a_table_counts(column: str, values: list[Any]) -> None:
    place = TABLE.column_names.index(column)
    other = TABLE.set_column(place, column, pa.array(values, TABLE.schema.field(column).type))
    assert table_digest(other) != table_digest(TABLE)


def test_names_types_and_rows_count() -> None:
    digests = {
        table_digest(table)
        for table in (TABLE, TABLE.slice(1), TABLE.drop_columns(["flag"]), TABLE.rename_columns([*"abcdefg"]))
    }
    assert len(digests) == 4
    whole = pa.table({"number": [1, 2]})
    assert table_digest(whole) != table_digest(pa.table({"number": [1.0, 2.0]}))


@pytest.mark.parametrize("fact", EPISODE_FACTS)
def test_every_fact_of_an_episode_counts(fact: str) -> None:
    features = {"action": "1", "observation.image": "2"}
    assert episode_digest(features, {**ROW, fact: "another"}) != episode_digest(features, ROW)
    assert episode_digest(features | {"action": "3"}, ROW) != episode_digest(features, ROW)
    assert episode_digest(features, {**ROW, "stream": 7, "episode_index": 9}) == episode_digest(features, ROW)


def test_a_release_is_its_episodes_in_order_and_its_tables() -> None:
    places = pa.table({name: [0, 1] for name in EPISODE_PLACES})
    described = {"action": {"dtype": "float32", "shape": [9], "names": ["stay"], "info": {"codec": "h264"}}}
    plain = {"action": {"dtype": "float32", "shape": [9], "names": ["stay"]}}
    tables = {"worlds": pa.table({"world": [1]}), "content": pa.table({"action": ["x"]})}
    first = release_digest(described, ["a", "b"], places, tables)
    assert release_digest(plain, ["a", "b"], places, {**tables, "content": pa.table({"action": ["y"]})}) == first
    others = [
        release_digest(plain, ["b", "a"], places, tables),
        release_digest(plain, ["a", "b"], places.slice(0, 1), tables),
        release_digest(plain, ["a", "b"], places, {"worlds": pa.table({"world": [2]})}),
        release_digest({"action": {**plain["action"], "shape": [8]}}, ["a", "b"], places, tables),
    ]
    assert len({first, *others}) == 5


def test_the_payload_is_everything_except_the_records() -> None:
    manifest = {
        "data/chunk-000/file-000.parquet": {"sha256": "1", "bytes": 2},
        "README.md": {"sha256": "3", "bytes": 4},
    }
    records = {name: {"sha256": "9", "bytes": 1} for name in ("config.json", "lineage.json", "provenance.json")}
    assert payload_digest(manifest | records) == payload_digest(manifest)
    assert payload_digest({**manifest, "README.md": {"sha256": "4", "bytes": 4}}) != payload_digest(manifest)
