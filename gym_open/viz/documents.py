"""Documents of a recording, in Markdown: configuration and lineage as tables, the raw JSON below them.

Text from files is shown as it is: Markdown finds no markup in it.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from gym_open.artefacts import Lineage
from gym_open.markdown import cell, table
from gym_open.terminal import printable

_MOST_RAW = 20_000
"""Characters of raw JSON that are shown: Rerun draws all of a document in every frame."""
_MOST_ROWS = 500
"""Settings that are shown in the table: ten times as many as a stage has."""
_SHORT = 12
"""Characters of a digest that are shown in a table."""


def settings(title: str, facts: Mapping[str, object], config: Mapping[str, Any]) -> str:
    """What is worth knowing first, all settings as a table, and the configuration as it is.

    Args:
        title: heading.
        facts: a few words each, by name.
        config: plain data, from a file.
    """
    every = list(flattened(config))
    rows = [[cell(name), cell(value)] for name, value in every[:_MOST_ROWS]]
    if len(every) > _MOST_ROWS:
        rows.append(["…", f"{len(every) - _MOST_ROWS:,} more are in the file"])
    lines = [
        f"# {cell(title)}",
        *([*table(["", ""], [[cell(name), cell(value)] for name, value in facts.items()]), ""] if facts else []),
        "## Settings",
        *(table(["setting", "value"], rows) if rows else ["none are told"]),
        "## As it is written",
        raw_json(config),
    ]
    return "\n".join(lines)


def lineage(title: str, record: Lineage | None, facts: Mapping[str, object]) -> str:
    """Where an artefact comes from: itself and all its ancestors, with digests; of what is none, the `facts`."""
    if record is None:
        rows = [[cell(name), cell(value)] for name, value in facts.items()]
        return "\n".join([f"# {cell(title)}", *table(["", ""], rows)])
    rows = [
        [f"{'·' * depth} {cell(one.kind)}", cell(digest[:_SHORT]), cell(one.code)]
        for depth, digest, one in _ancestors(record)
    ]
    told = [
        [cell(name.replace("_", " ")), cell(_short(value)), cell(one.kind)]
        for _, _, one in _ancestors(record)
        for name, value in one.facts.items()
    ]
    packages = [[cell(name), cell(version)] for name, version in record.packages.items()]
    lines = [
        f"# {cell(title)}",
        "Made of what stands below it; a digest names its bytes.",
        "",
        *table(["artefact", "digest", "code"], rows),
        "## Facts",
        *table(["fact", "", "of the"], told),
        "## Packages",
        *table(["package", "version"], packages),
        "## As it is written, without the ancestors",
        raw_json({"kind": record.kind, "key": record.key, "code": record.code, "facts": record.facts}),
    ]
    return "\n".join(lines)


def flattened(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every setting, by its name with dots; numbers and names first, then what they are grouped under."""
    groups = {name: value for name, value in config.items() if isinstance(value, Mapping)}
    yield from ((prefix + name, value) for name, value in config.items() if name not in groups)
    for name, group in groups.items():
        yield from flattened(group, f"{prefix}{name}.")


def raw_json(value: Mapping[str, Any]) -> str:
    """A block of code that holds the JSON, whatever is in it, up to a length that can be drawn."""
    text = printable(json.dumps(value, indent=1, ensure_ascii=False))
    if len(text) > _MOST_RAW:
        text = f"{text[:_MOST_RAW]}\n… {len(text) - _MOST_RAW:,} more characters are in the file"
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}json\n{text}\n{fence}"


def _ancestors(record: Lineage, depth: int = 0, digest: str = "this one") -> Iterator[tuple[int, str, Lineage]]:
    yield depth, digest, record
    for parent in record.parents:
        yield from _ancestors(parent.lineage, depth + 1, parent.digest)


def _short(value: object) -> object:
    """The beginning of a digest; of many things, how many there are; all else as it is."""
    if isinstance(value, list | dict):
        return f"{len(value)} of them" if value else "none"
    return value[:_SHORT] if isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) else value
