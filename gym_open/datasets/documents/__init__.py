"""The documents of a release: card, licence, changelog, Croissant metadata, figures, `rebuild/` and provenance.

All are written from the data. They hold no dates (except a given day of publication), paths, hosts or users.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from gym_open import artefacts
from gym_open.datasets.config import Header
from gym_open.datasets.documents.card import card, description
from gym_open.datasets.documents.changelog import write_changelog
from gym_open.datasets.documents.croissant import croissant
from gym_open.datasets.documents.facts import gather
from gym_open.datasets.documents.figures import draw
from gym_open.datasets.documents.licences import licence_text
from gym_open.datasets.documents.provenance import write_provenance
from gym_open.datasets.documents.rebuild import rebuild_files
from gym_open.formats.releases import Release
from gym_open.formats.releases.layout import CARD, CROISSANT, LICENSE

__all__ = ["Command", "write_changelog", "write_documents", "write_provenance"]

Command = Literal["build", "append", "merge", "filter"]


def write_documents(
    release: Release, config: Header, *, command: Command, previous: Release | None, parents: Sequence[Path]
) -> None:
    """Write the documents into a release whose `data`, `videos` and `meta` are there.

    The changelog and `provenance.json` come later: the changelog says whether these documents changed, and
    `provenance.json` lists all of them.

    Args:
        release: the release, not sealed yet.
        config: everything that determines it.
        command: the command that makes it.
        previous: the previous version, if there is one.
        parents: artefacts from which it is made: logs, releases, and `previous` last, if there is one.

    Raises:
        ArtefactError: if `previous` is not readable.
    """
    facts = gather(release)
    releases = [path for path in parents if artefacts.lineage(path).kind == "release"]
    sources = releases[:-1] if previous else releases
    newest = max((log.batch for log in facts.logs), default=0)
    logs = [log for log in facts.logs if log.batch == newest] if command in {"build", "append"} else []
    rebuild = rebuild_files(config, command, logs, sources, previous.root if previous else None)
    documents = {
        CARD: card(config, facts).encode(),
        LICENSE: licence_text(config).encode(),
        CROISSANT: artefacts.canonical_json(croissant(config, release, description(facts))),
        **{f"figures/{name}": data for name, data in draw(facts).items()},
        **{f"rebuild/{name}": data for name, data in rebuild.items()},
    }
    for name, data in documents.items():
        path = release.root / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
