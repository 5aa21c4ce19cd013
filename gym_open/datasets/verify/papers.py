"""Whether what a release says of itself for others agrees with its manifest: Croissant, provenance, lineage, config."""

from pathlib import Path
from typing import Any

from gym_open import artefacts
from gym_open.artefacts import Entry
from gym_open.datasets.verify.report import Findings
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

_PAPERS = (CARD, LICENSE, CHANGELOG, CROISSANT, PROVENANCE)


def check_papers(root: Path, findings: Findings) -> str:
    """Digests, names and versions are the same wherever they stand."""
    manifest = artefacts.manifest(root)
    missing = [name for name in _PAPERS if name not in manifest]
    for name in missing:
        findings.add(name, "missing: every release has it")
    if missing:
        return ""
    info = read_json(root / INFO_PATH, dict[str, Any])
    _check_croissant(root, manifest, info["gym_open"], findings)
    _check_provenance(root, manifest, findings)
    _check_records(root, info, findings)
    return "Croissant, provenance, lineage and configuration agree with the manifest"


def _check_croissant(root: Path, manifest: dict[str, Entry], ours: dict[str, Any], findings: Findings) -> None:
    said = read_json(root / CROISSANT, dict[str, Any])
    listed = [item for item in _items(said.get("distribution")) if item.get("@type") == "cr:FileObject"]
    found = {str(item.get("contentUrl")): item.get("sha256") for item in listed}
    expected = {name: entry.sha256 for name, entry in manifest.items() if name.endswith((".parquet", ".mp4"))}
    for name in _unlike(expected, found):
        findings.add(CROISSANT, f"the SHA-256 of {name} is not that of the manifest")
    good = said.get("version") == ours["version"] and said.get("name") == ours["name"].replace("/", "-")
    findings.expect(good, CROISSANT, f"its name or version is not that of {INFO_PATH}")


def _check_provenance(root: Path, manifest: dict[str, Entry], findings: Findings) -> None:
    said = read_json(root / PROVENANCE, dict[str, Any])
    found = {str(item.get("name")): _sha256(item) for item in _items(said.get("subject"))}
    expected = {name: entry.sha256 for name, entry in manifest.items() if name not in RECORDS}
    for name in _unlike(expected, found):
        findings.add(PROVENANCE, f"the SHA-256 of {name} is not that of the manifest")
    build: Any = said.get("predicate")
    for key in ("buildDefinition", "resolvedDependencies"):
        build = build.get(key) if isinstance(build, dict) else None
    parents = artefacts.lineage(root).parents
    same = [_sha256(item) for item in _items(build)] == [parent.digest for parent in parents]
    findings.expect(same, PROVENANCE, f"its dependencies are not the parents of {artefacts.LINEAGE}")
    for number, parent in enumerate(parents):
        findings.expect(parent.is_consistent(), artefacts.LINEAGE, f"the records of parent {number} are not its own")


def _check_records(root: Path, info: dict[str, Any], findings: Findings) -> None:
    ours, config = info["gym_open"], artefacts.config_of(root)
    for name in ("name", "version", "license", "published"):
        good = config.get(name) == ours[name]
        findings.expect(good, artefacts.CONFIG, f"{name} is {config.get(name)!r}, {INFO_PATH} says {ours[name]!r}")
    facts = artefacts.lineage(root).facts
    expected = {
        "frames": info["total_frames"],
        "episodes": info["total_episodes"],
        "content": read_json(root / DIGESTS_PATH, dict[str, Any]).get("release"),
    }
    for name, value in expected.items():
        findings.expect(facts.get(name) == value, artefacts.LINEAGE, f"{name} is not that of the release")


def _items(value: Any) -> list[dict[str, Any]]:
    """The objects in a list that may be anything."""
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _sha256(item: dict[str, Any]) -> Any:
    digest = item.get("digest")
    return digest.get("sha256") if isinstance(digest, dict) else None


def _unlike(expected: dict[str, str], found: dict[str, Any]) -> list[str]:
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
