"""The tables of a release that a compact release stores as rows: streams, worlds and switches."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from gym_open.formats.compact import Compact
from gym_open.formats.releases.schemas import table_schema

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pyarrow as pa

    from gym_open.formats.releases.layout import Table


def stored_tables(compact: Compact) -> "Iterator[dict[Table, pa.Table]]":
    """The tables of each batch of the release.

    Raises:
        ArtefactError: if a file is damaged.
    """
    import pyarrow as pa

    batches = {row.stream: row.batch for row in compact.streams}
    switches = list(_switches(compact))
    worlds = [
        {"stream": place.stream, "world": place.world, "puzzle": compact.puzzles[place.stream, place.world].digest,
         "split": place.split, "json": text}
        for text, place in compact.worlds
    ]  # fmt: skip
    for batch in range(compact.release_info["gym_open"]["batches"]):
        rows: dict[Table, list[dict[str, Any]]] = {
            "streams": [_plain(row, "batch") for row in compact.streams if row.batch == batch],
            "worlds": [row for row in worlds if batches.get(row["stream"]) == batch],
            "switches": [row for row in switches if batches.get(row["stream"]) == batch],
        }
        features = compact.release_info["features"]
        yield {name: pa.Table.from_pylist(found, schema=table_schema(name, features)) for name, found in rows.items()}


def _switches(compact: Compact) -> Iterator[dict[str, Any]]:
    losses = compact.losses() if "world_model.loss" in compact.columns else None
    at = 0
    for row in compact.switches:
        own = {} if losses is None else {"world_losses": losses[at : at + row.losses].tolist()}
        yield {**_plain(row, "losses"), **own}
        at += row.losses


def _plain(row: msgspec.Struct, without: str) -> dict[str, Any]:
    return {name: value for name, value in msgspec.structs.asdict(row).items() if name != without}
