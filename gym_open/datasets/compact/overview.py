"""Tables about a compact release."""

from pathlib import Path

from rich.table import Table

from gym_open import artefacts
from gym_open.formats.compact import Compact, open_compact
from gym_open.formats.compact.layout import CARD, COLUMNS, RELEASE
from gym_open.terminal import markup, titled_table

_CORE = "needed for images and states"


def compact_table(root: Path) -> Table:
    """Bytes of the compact release at `root`, by what they are for.

    Raises:
        ArtefactError: if it is missing, damaged or no compact release.
    """
    compact = open_compact(root)
    info = compact.info
    title = f"{info.name} {info.version}, compact: {info.steps:,} steps in {info.episodes:,} episodes"
    table = titled_table(markup(title), ("part", "bytes", "bytes per step"), right=("bytes", "bytes per step"))
    sizes = sizes_of(compact)
    for part, size in sizes.items():
        table.add_row(markup(part), f"{size:,}", f"{size / max(info.steps, 1):.3f}")
    table.add_row("all", f"{sum(sizes.values()):,}", f"{sum(sizes.values()) / max(info.steps, 1):.3f}")
    return table


def sizes_of(compact: Compact) -> dict[str, int]:
    """Bytes of the files by what they are for."""
    sizes = {_CORE: 0, "the explorer's own values": 0, "documents and records": 0}
    records = {artefacts.CONFIG, artefacts.LINEAGE, CARD}
    for name, entry in artefacts.manifest(compact.root).items():
        if name.startswith(COLUMNS):
            sizes["the explorer's own values"] += entry.bytes
        elif name.startswith(RELEASE) or name in records:
            sizes["documents and records"] += entry.bytes
        else:
            sizes[_CORE] += entry.bytes
    return sizes
