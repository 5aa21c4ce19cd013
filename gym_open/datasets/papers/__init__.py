"""The papers of a release: card, licence, changelog, Croissant metadata, figures, the way to make it again, provenance.

All are written from the data, without dates (but a day of publication that was given), paths, hosts or users.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from gym_open import artefacts
from gym_open.datasets.config import Header
from gym_open.datasets.papers.card import card, description
from gym_open.datasets.papers.changelog import changelog
from gym_open.datasets.papers.croissant import croissant
from gym_open.datasets.papers.facts import gather
from gym_open.datasets.papers.figures import draw
from gym_open.datasets.papers.licences import licence_text
from gym_open.datasets.papers.provenance import write_provenance
from gym_open.datasets.papers.rebuild import rebuild_files
from gym_open.formats.releases import Release
from gym_open.formats.releases.layout import CARD, CHANGELOG, CROISSANT, LICENSE

__all__ = ["Command", "write_papers", "write_provenance"]

Command = Literal["build", "append", "merge", "filter"]


def write_papers(
    release: Release, config: Header, *, command: Command, previous: Release | None, parents: Sequence[Path]
) -> None:
    """Write all papers but `provenance.json` into a release whose `data`, `videos` and `meta` are there.

    Args:
        release: not sealed yet.
        config: all that decided it.
        command: what makes it.
        previous: the release that this one follows, or takes over.
        parents: artefacts that it is made of: logs, releases, and `previous` last, if there is one.

    Raises:
        ArtefactError: if `previous` is not readable.
    """
    facts = gather(release)
    releases = [path for path in parents if artefacts.lineage(path).kind == "release"]
    sources = releases[:-1] if previous else releases
    newest = max((log.batch for log in facts.logs), default=0)
    logs = [log for log in facts.logs if log.batch == newest] if command in {"build", "append"} else []
    rebuild = rebuild_files(config, command, logs, sources, previous.root if previous else None)
    papers = {
        CARD: card(config, facts).encode(),
        LICENSE: licence_text(config).encode(),
        CROISSANT: artefacts.canonical_json(croissant(config, release, description(facts))),
        **{f"figures/{name}": data for name, data in draw(facts).items()},
        **{f"rebuild/{name}": data for name, data in rebuild.items()},
    }
    for name, data in papers.items():
        path = release.root / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    text = changelog(config, release, previous)  # last: it says whether the card changed too
    (release.root / CHANGELOG).write_text(text, encoding="utf-8")
