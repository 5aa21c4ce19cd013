"""Documents of a recording, in Markdown: configuration and lineage as tables, with the raw JSON below.

Text from files is escaped, so that Markdown shows it as it is.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from gym_open.artefacts import Lineage
from gym_open.markdown import cell, table
from gym_open.terminal import printable

_MOST_RAW = 20_000
"""Limit of characters of raw JSON: Rerun draws a whole document in every frame."""
_MOST_ROWS = 500
"""Limit of rows of the table of settings; a stage has about 50 settings."""
_SHORT = 12
"""Characters of a digest in a table."""


def settings(title: str, facts: Mapping[str, object], config: Mapping[str, Any]) -> str:
    """Write the main facts, a table of all settings, and the configuration as JSON.

    Args:
        title: heading.
        facts: short texts by name.
        config: plain data from a file.
    """
    every = list(flattened(config))
    rows = [[cell(name), cell(value)] for name, value in every[:_MOST_ROWS]]
    if len(every) > _MOST_ROWS:
        rows.append(["…", f"the file has {len(every) - _MOST_ROWS:,} more"])
    lines = [
        f"# {cell(title)}",
        *([*table(["", ""], [[cell(name), cell(value)] for name, value in facts.items()]), ""] if facts else []),
        "## Settings",
        *(table(["setting", "value"], rows) if rows else ["no settings"]),
        "## JSON",
        raw_json(config),
    ]
    return "\n".join(lines)


def lineage(title: str, record: Lineage | None, facts: Mapping[str, object]) -> str:
    """Write an artefact's lineage with the digests of all ancestors; without a record, only the `facts`."""
    if record is None:
        rows = [[cell(name), cell(value)] for name, value in facts.items()]
        return "\n".join([f"# {cell(title)}", *table(["", ""], rows)])
    rows = [
        [f"{'·' * depth} {cell(item.kind)}", cell(digest[:_SHORT]), cell(item.code)]
        for depth, digest, item in _ancestors(record)
    ]
    about = [
        [cell(name.replace("_", " ")), cell(_short(value)), cell(item.kind)]
        for _, _, item in _ancestors(record)
        for name, value in item.facts.items()
    ]
    packages = [[cell(name), cell(version)] for name, version in record.packages.items()]
    lines = [
        f"# {cell(title)}",
        "Each artefact was made from those below it. A digest identifies the bytes of an artefact.",
        "",
        *table(["artefact", "digest", "code"], rows),
        "## Facts",
        *table(["fact", "", "of the"], about),
        "## Packages",
        *table(["package", "version"], packages),
        "## JSON, without the ancestors",
        raw_json({"kind": record.kind, "key": record.key, "code": record.code, "facts": record.facts}),
    ]
    return "\n".join(lines)


def flattened(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """All settings by their dotted names; settings of a group come after those without a group."""
    groups = {name: value for name, value in config.items() if isinstance(value, Mapping)}
    yield from ((prefix + name, value) for name, value in config.items() if name not in groups)
    for name, group in groups.items():
        yield from flattened(group, f"{prefix}{name}.")


def raw_json(value: Mapping[str, Any]) -> str:
    """A Markdown code block with the JSON, shortened to a length that Rerun can draw."""
    text = printable(json.dumps(value, indent=1, ensure_ascii=False))
    if len(text) > _MOST_RAW:
        text = f"{text[:_MOST_RAW]}\n… {len(text) - _MOST_RAW:,} more characters in the file"
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}json\n{text}\n{fence}"


def _ancestors(record: Lineage, depth: int = 0, digest: str = "(itself)") -> Iterator[tuple[int, str, Lineage]]:
    yield depth, digest, record
    for parent in record.parents:
        yield from _ancestors(parent.lineage, depth + 1, parent.digest)


def _short(value: object) -> object:
    """Shorten a value: the start of a digest, the number of items of a collection, any other value unchanged."""
    if isinstance(value, list | dict):
        return f"{len(value)} items" if value else "none"
    return value[:_SHORT] if isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) else value
