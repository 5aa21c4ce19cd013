"""Whether the papers of a release are what this version of gym-open would write of what it holds."""

import hashlib

from gym_open import artefacts
from gym_open.datasets.papers.card import card, description
from gym_open.datasets.papers.changelog import changelog
from gym_open.datasets.papers.croissant import croissant
from gym_open.datasets.papers.facts import gather
from gym_open.datasets.papers.licences import licence_text
from gym_open.datasets.papers.rebuild import rebuild_files
from gym_open.datasets.verify.papers import made_by
from gym_open.datasets.verify.report import Findings
from gym_open.formats.releases.layout import CARD, CHANGELOG, CROISSANT, LICENSE
from gym_open.formats.releases.reader import Release

_SCRIPT = "rebuild/rebuild.sh"
_WITH_PARENTS = (_SCRIPT, CHANGELOG)
"""What tells of the releases that one is made of, or follows, and cannot be written without them."""


def check_texts(release: Release, findings: Findings) -> str:
    """Write the papers again, and hold the SHA-256 of each against the manifest; figures are left out.

    A difference is a problem only if this very version says that it wrote them: another may write other words.
    """
    root, lineage = release.root, artefacts.lineage(release.root)
    said = {name: entry.sha256 for name, entry in artefacts.manifest(root).items()}
    expected = {name: hashlib.sha256(data).hexdigest() for name, data in _written(release).items()}
    left = _WITH_PARENTS if any(parent.lineage.kind == "release" for parent in lineage.parents) else ()
    names = expected.keys() | {name for name in said if name.startswith("rebuild/")}
    wrong = sorted(name for name in names - set(left) if said.get(name) != expected.get(name))
    if wrong and lineage.code == artefacts.code_version("release"):
        for name in wrong:
            findings.add(name, "not what this version of gym-open writes of this release, and says that it wrote")
    words = (
        f"{', '.join(wrong)}: not what this version of gym-open would write, but {lineage.code} may" if wrong else ""
    )
    words = words or "card, licence, Croissant and rebuild/ are what this version of gym-open writes"
    return f"{words}; not checked: {', '.join(left)}, which tell of other releases" if left else words


def _written(release: Release) -> dict[str, bytes]:
    """Papers as they would be written now, as if the release were made of no other."""
    command, config = made_by(release.root)
    facts = gather(release)
    newest = max((log.batch for log in facts.logs), default=0)
    logs = [log for log in facts.logs if log.batch == newest] if command in {"build", "append"} else []
    return {
        CARD: card(config, facts).encode(),
        LICENSE: licence_text(config).encode(),
        CROISSANT: artefacts.canonical_json(croissant(config, release, description(facts))),
        CHANGELOG: changelog(config, release, None).encode(),
        **{f"rebuild/{name}": data for name, data in rebuild_files(config, command, logs, [], None).items()},
    }
