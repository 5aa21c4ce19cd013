"""provenance.json: how the release was made, as an in-toto statement with a SLSA provenance predicate.

<https://in-toto.io/Statement/v1>, <https://slsa.dev/spec/v1.0/provenance>. It is a record, like
lineage.json: it names code and packages, so it does not belong to the payload.
"""

import importlib.metadata
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from gym_open import artefacts
from gym_open.config import to_dict
from gym_open.datasets.compare import payload
from gym_open.datasets.config import Header
from gym_open.files import write_atomically
from gym_open.formats.releases.layout import PROVENANCE

STATEMENT, PREDICATE = "https://in-toto.io/Statement/v1", "https://slsa.dev/provenance/v1"
_BUILD_TYPE = "urn:gym-open:dataset:{command}:2"
_BUILDER = "urn:gym-open"
_DRAWN = ("av", "matplotlib", "pillow")
"""Packages that determine the bytes of images and figures, in addition to those that every artefact names."""


def write_provenance(folder: Path, config: Header, parents: Sequence[Path], command: str) -> None:
    """Write `provenance.json` over the payload in `folder`.

    Args:
        folder: folder of the release, not sealed yet.
        config: everything that determines it.
        parents: the artefacts from which it was made.
        command: `build`, `append`, `merge` or `filter`.
    """
    write_atomically(folder / PROVENANCE, artefacts.canonical_json(statement(folder, config, parents, command)))


def statement(folder: Path, config: Header, parents: Sequence[Path], command: str) -> dict[str, Any]:
    """The statement as plain data. It does not depend on place or time."""
    subject = [{"name": path, "digest": {"sha256": entry.sha256}} for path, entry in payload.entries(folder).items()]
    settings = to_dict(config)
    seeds = {"release": str(settings["seed"])} if "seed" in settings else {}
    return {
        "_type": STATEMENT,
        "subject": subject,
        "predicateType": PREDICATE,
        "predicate": {
            "buildDefinition": {
                "buildType": _BUILD_TYPE.format(command=command),
                "externalParameters": {"command": command, "config": settings},
                "internalParameters": {"seeds": {**seeds, "streams": list(_stream_seeds(folder))}},
                "resolvedDependencies": [_dependency(i, parent) for i, parent in enumerate(parents)],
            },
            "runDetails": {
                "builder": {"id": _BUILDER, "version": {"gym-open": artefacts.code_version("release"), **_packages()}},
                **({"metadata": {"finishedOn": f"{config.published}T00:00:00Z"}} if config.published else {}),
            },
        },
    }


def _dependency(number: int, parent: Path) -> dict[str, Any]:
    return {
        "name": f"parent-{number}/{artefacts.MANIFEST}",
        "digest": {"sha256": artefacts.digest(parent)},
        "annotations": {"kind": artefacts.lineage(parent).kind},
    }


def _stream_seeds(folder: Path) -> Iterator[str]:
    """Root seeds of the streams, as text because numbers in JSON are not exact."""
    import pandas as pd

    for path in sorted(folder.glob("meta/streams/file-*.parquet")):
        yield from pd.read_parquet(path, columns=["seed"])["seed"]


def _packages() -> dict[str, str]:
    found = {}
    for name in sorted({*artefacts.RECORDED_PACKAGES, *_DRAWN}):
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found
