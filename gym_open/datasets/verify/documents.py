"""Whether the documents and records of a release agree with its manifest and with what it holds."""

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from gym_open import artefacts
from gym_open.artefacts import Entry
from gym_open.config import to_dict
from gym_open.datasets.config import FilterConfig, Header, MergeConfig, ReleaseConfig
from gym_open.datasets.documents import Command
from gym_open.datasets.documents.card import card, description
from gym_open.datasets.documents.changelog import changelog
from gym_open.datasets.documents.croissant import croissant
from gym_open.datasets.documents.facts import gather
from gym_open.datasets.documents.licences import licence_text
from gym_open.datasets.documents.rebuild import rebuild_files
from gym_open.datasets.verify.report import Findings
from gym_open.datasets.writing.sources import held_logs
from gym_open.datasets.writing.splits import assign, unit_of
from gym_open.errors import ArtefactError
from gym_open.formats.releases.info import read_json
from gym_open.formats.releases.layout import (
    CARD,
    CHANGELOG,
    CROISSANT,
    DIGESTS_PATH,
    INFO_PATH,
    LICENSE,
    PROVENANCE,
    RECORDS,
)
from gym_open.formats.releases.reader import Release

_DOCUMENTS = (CARD, LICENSE, CHANGELOG, CROISSANT, PROVENANCE)
_SCRIPT = "rebuild/rebuild.sh"
_WITH_PARENTS = (_SCRIPT, CHANGELOG)
"""Documents about the parents of a release, which cannot be written without the parents."""


def check_documents(release: Release, findings: Findings) -> str:
    """Check that digests, names, versions and settings agree in all documents and records."""
    root = release.root
    manifest = artefacts.manifest(root)
    missing = [name for name in _DOCUMENTS if name not in manifest]
    for name in missing:
        findings.add(name, "missing: every release has it; get the release again")
    if missing:
        return ""
    _check_croissant(root, manifest, release.info["gym_open"], findings)
    _check_provenance(root, manifest, findings)
    _check_records(release, findings)
    return "Croissant, provenance, lineage and configuration agree with the manifest"


def _check_croissant(root: Path, manifest: dict[str, Entry], ours: dict[str, Any], findings: Findings) -> None:
    said = read_json(root / CROISSANT, dict[str, Any])
    listed = [item for item in _items(said.get("distribution")) if item.get("@type") == "cr:FileObject"]
    found = {str(item.get("contentUrl")): item.get("sha256") for item in listed}
    expected = {name: entry.sha256 for name, entry in manifest.items() if name.endswith((".parquet", ".mp4"))}
    for name in _unlike(expected, found):
        findings.add(CROISSANT, f"the SHA-256 of {name} is not that in the manifest")
    good = said.get("version") == ours["version"] and said.get("name") == ours["name"].replace("/", "-")
    findings.expect(good, CROISSANT, f"its name or version is not that in {INFO_PATH}")


def _check_provenance(root: Path, manifest: dict[str, Entry], findings: Findings) -> None:
    said = read_json(root / PROVENANCE, dict[str, Any])
    found = {str(item.get("name")): _sha256(item) for item in _items(said.get("subject"))}
    expected = {name: entry.sha256 for name, entry in manifest.items() if name not in RECORDS}
    for name in _unlike(expected, found):
        findings.add(PROVENANCE, f"the SHA-256 of {name} is not that in the manifest")
    build: Any = said.get("predicate")
    for key in ("buildDefinition", "resolvedDependencies"):
        build = build.get(key) if isinstance(build, dict) else None
    parents = artefacts.lineage(root).parents
    same = [_sha256(item) for item in _items(build)] == [parent.digest for parent in parents]
    findings.expect(same, PROVENANCE, f"its dependencies are not the parents in {artefacts.LINEAGE}")
    for number, parent in enumerate(parents):
        findings.expect(parent.is_consistent(), artefacts.LINEAGE, f"parent {number}: records and digest differ")


def _check_records(release: Release, findings: Findings) -> None:
    root, info = release.root, release.info
    ours, config = info["gym_open"], artefacts.config_of(root)
    settings = ("split_by", "max_episode_steps", "pictures") if "split_by" in config else ()
    for name in ("name", "version", "license", "published", *settings):
        good = config.get(name) == ours[name]
        findings.expect(good, artefacts.CONFIG, f"{name} is {config.get(name)!r}, {INFO_PATH} says {ours[name]!r}")
    expected = {
        "frames": info["total_frames"],
        "episodes": info["total_episodes"],
        "steps": int(release.episodes["steps"].sum()),
        "content": read_json(root / DIGESTS_PATH, dict[str, Any]).get("release"),
    }
    command, built = made_by(root)
    lineage = artefacts.lineage(root)
    if command == "build":
        logs = [parent.digest for parent in lineage.parents if parent.lineage.kind == "log"]
        findings.expect(held_logs(lineage) == logs, artefacts.LINEAGE, "its list of logs is not that of its parents")
    for name, value in expected.items():
        findings.expect(lineage.facts.get(name) == value, artefacts.LINEAGE, f"{name} is not that of the release")
    said: Any = read_json(root / PROVENANCE, dict[str, Any])
    for key in ("predicate", "buildDefinition", "externalParameters"):
        said = said.get(key) if isinstance(said, dict) else None
    same = said == {"command": command, "config": config}
    findings.expect(same, PROVENANCE, f"its command or configuration is not that in {artefacts.CONFIG}")
    if command == "build" and isinstance(built, ReleaseConfig):
        _check_draw(release, built, findings)


def made_by(root: Path) -> tuple[Command, Header]:
    """Return the command that made the release at `root`, and its configuration.

    Raises:
        ArtefactError: if the configuration is not valid or not complete.
    """
    said = artefacts.config_of(root)
    settings = {name: value for name, value in said.items() if name != "append"}
    kinds: dict[Command, type[Header]] = {"build": ReleaseConfig, "filter": FilterConfig, "merge": MergeConfig}
    for command, kind in kinds.items():
        try:
            config = msgspec.convert(settings, kind)
        except msgspec.ValidationError:
            continue
        append = "append" in said and kind is ReleaseConfig
        whole = {**to_dict(config), "append": True} if append else to_dict(config)
        if artefacts.canonical_json(whole) == artefacts.canonical_json(said):
            return "append" if append else command, config
    raise ArtefactError(f"{root / artefacts.CONFIG}: not the configuration of a release; get the release again")


def _check_draw(release: Release, config: ReleaseConfig, findings: Findings) -> None:
    """Check that the seed gives the worlds or streams in val. An append also keeps those of the previous version."""
    worlds, switches = release.table("worlds"), release.table("switches")
    puzzles = dict(zip(zip(worlds["stream"], worlds["world"], strict=True), worlds["puzzle"], strict=True))
    entered = switches[switches["to_world"] >= 0]
    places = zip(entered["stream"].tolist(), entered["to_world"].tolist(), strict=True)
    units = {unit_of(config.split_by, stream, puzzles[stream, world]) for stream, world in places}
    drawn = assign(units, config.val_fraction, config.seed, {})
    val = sorted(unit for unit, split in drawn.items() if split == "val")
    same = val == release.info["gym_open"]["val"]
    findings.expect(same, artefacts.CONFIG, "its seed and val_fraction give other worlds or streams in val")


def _items(value: Any) -> list[dict[str, Any]]:
    """The objects in a value that may be anything."""
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _sha256(item: dict[str, Any]) -> Any:
    digest = item.get("digest")
    return digest.get("sha256") if isinstance(digest, dict) else None


def _unlike(expected: dict[str, str], found: dict[str, Any]) -> list[str]:
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))


def check_texts(release: Release, findings: Findings) -> str:
    """Write the documents again, except figures, and compare the SHA-256 of each with the manifest.

    A difference is a problem only if the lineage names this version of the code: another one may write other words.
    """
    root, lineage = release.root, artefacts.lineage(release.root)
    said = {name: entry.sha256 for name, entry in artefacts.manifest(root).items()}
    expected = {name: hashlib.sha256(data).hexdigest() for name, data in _written(release).items()}
    left = _WITH_PARENTS if any(parent.lineage.kind == "release" for parent in lineage.parents) else ()
    names = expected.keys() | {name for name in said if name.startswith("rebuild/")}
    wrong = sorted(name for name in names - set(left) if said.get(name) != expected.get(name))
    if wrong and lineage.code == artefacts.code_version("release"):
        for name in wrong:
            findings.add(
                name,
                "not what this version of gym-open, which lineage.json names, writes about it",
            )
    words = f"{', '.join(wrong)}: not what this version of gym-open writes, but {lineage.code} may" if wrong else ""
    words = words or "card, licence, Croissant and rebuild/ are what this version of gym-open writes"
    return f"{words}; not checked: {', '.join(left)}, which describe other releases" if left else words


def _written(release: Release) -> dict[str, bytes]:
    """Write the documents as this version does, as if the release had no other release as parent."""
    command, config = made_by(release.root)
    facts = gather(release)
    newest = max((log.batch for log in facts.logs), default=0)
    logs = [log for log in facts.logs if log.batch == newest] if command in {"build", "append"} else []
    return {
        CARD: card(config, facts).encode(),
        LICENSE: licence_text(config).encode(),
        CROISSANT: artefacts.canonical_json(croissant(config, release, description(facts))),
        CHANGELOG: changelog(config, release, None, None).encode(),
        **{f"rebuild/{name}": data for name, data in rebuild_files(config, command, logs, [], None).items()},
    }
