"""The table `segments` of a release, which follows from its episodes."""

from typing import TYPE_CHECKING

from gym_open.formats.releases.schemas import table_schema

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pandas as pd
    import pyarrow as pa


def segments_of_episodes(episodes: "pd.DataFrame") -> "pa.Table":
    """Table with one row per segment, from `Release.episodes`: the part in the release, and how it ended."""
    import pyarrow as pa

    frame = episodes.sort_values(["stream", "segment", "piece"])
    merged = frame.groupby(["stream", "segment"], as_index=False).agg(
        world=("world", "first"), puzzle=("puzzle", "first"), first_step=("first_step", "first"),
        steps=("steps", "sum"), continued=("continued", "first"), ended=("ended", "last"),
    )  # fmt: skip
    return pa.Table.from_pandas(
        merged, schema=table_schema("segments", {}), preserve_index=False
    ).replace_schema_metadata()
