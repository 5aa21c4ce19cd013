"""Find what changed between two releases, by file and by meaning, and the version bump that follows.

The comparison uses the content digests in the releases (`meta/content`, `meta/digests.json`): it decodes no frame. It
trusts these digests; `gym-open dataset verify` computes them again.
"""

from collections.abc import Iterator
from typing import Any, Literal

import msgspec
from rich.table import Table as Shown

from gym_open import artefacts
from gym_open.datasets.compare import payload
from gym_open.datasets.compare.document_diff import same_but_for_version
from gym_open.datasets.compare.episode_diff import episode_meanings
from gym_open.datasets.compare.versions import RANK, Bump, Meaning, implied
from gym_open.errors import RefusedError
from gym_open.formats.releases import Release
from gym_open.formats.releases.content import table_digest
from gym_open.formats.releases.layout import BOOKKEEPING, CHANGELOG, STATS_PATH, TABLES, TASKS_PATH
from gym_open.terminal import markup, titled_table

How = Literal["added", "removed", "changed", "serialisation"]
_NAMING = {"name", "version", "published", "license", "batches"}
"""Keys of our part of `meta/info.json` that are ignored or compared separately."""
_COUNTS = {"features", "splits", "total_episodes", "total_frames"}
"""Keys of LeRobot's part that follow from features and episodes."""


class FileChange(msgspec.Struct, frozen=True):
    """A file that differs between the releases."""

    path: str
    how: How
    """`serialisation`: the same content in other bytes."""


class Diff(msgspec.Struct, frozen=True):
    """The changes from one release to another."""

    old: str
    """Name and version."""
    new: str
    bump: Bump
    next_version: str
    """Version that the new release must have as the successor of the old one."""
    files: list[FileChange]
    meanings: list[Meaning]
    """Largest bump first. The texts come from files: escape them before a terminal shows them."""


def diff_releases(a: Release, b: Release) -> Diff:
    """Compare `a` with its successor `b`, which may still lack its manifest.

    Raises:
        ArtefactError: if one of them is not a readable release (naming the file).
    """
    files = list(_file_changes(a, b))
    common = sorted(name for name, form in _forms(a).items() if _forms(b).get(name) == form)
    data = [*_feature_meanings(a, b), *episode_meanings(a, b, common), *_table_meanings(a, b)]
    if not data and payload.digests(a.records).release != payload.digests(b.records).release:
        data = [Meaning("major", "the content digest changed, but no feature, episode or table did")]
    rest = [*_setting_meanings(a, b, files), *_file_meanings(a, b, files, alone=not data)]
    meanings = sorted([*data, *rest], key=lambda item: -RANK[item.bump])
    bump = meanings[0].bump if meanings else "none"
    if a.name != b.name:
        meanings.append(Meaning("none", f"name: {a.name} → {b.name}"))
    return Diff(f"{a.name} {a.version}", f"{b.name} {b.version}", bump, implied(a.version, bump), files, meanings)


def check_version(previous: Release, new: Release) -> Diff:
    """Check that the version of `new` follows from what changed since `previous`, and return the changes.

    `new` may still lack its manifest, as a release does before it is sealed.

    Raises:
        RefusedError: if nothing changed, if another version follows (naming it), or if the names of the two differ.
    """
    if previous.name != new.name:
        raise RefusedError(
            f"{previous.root}: holds {previous.name!r}, so it is no earlier version of {new.name!r}; give another "
            "--out, or the right --previous"
        )
    diff = diff_releases(previous, new)
    if diff.bump == "none":
        raise RefusedError(
            f"{new.name} {new.version}: nothing but version and date differs from {previous.version} "
            f"({previous.root}); a version without a change is refused: keep {previous.version}"
        )
    honest = implied(previous.version, diff.bump)
    if new.version != honest:
        raise RefusedError(
            f"{new.name}: version {new.version} does not follow from what changed since {previous.version} "
            f"({previous.root}); a {diff.bump} change ({diff.meanings[0].text}) makes it {honest}: give "
            f"--version {honest}"
        )
    return diff


def _file_changes(a: Release, b: Release) -> Iterator[FileChange]:
    old, new = payload.entries(a.records), payload.entries(b.records)
    old_content, new_content = payload.digests(a.records).files, payload.digests(b.records).files
    for path in sorted(old.keys() | new.keys()):
        if path not in old:
            yield FileChange(path, "added")
        elif path not in new:
            yield FileChange(path, "removed")
        elif old[path] != new[path]:
            same = path in old_content and old_content[path] == new_content.get(path)
            yield FileChange(path, "serialisation" if same else "changed")


def _forms(release: Release) -> dict[str, Any]:
    """The properties of each feature that give its numbers their meaning."""
    return {
        name: (item.get("dtype"), item.get("shape"), item.get("names"))
        for name, item in release.info["features"].items()
        if name not in BOOKKEEPING
    }


def _feature_meanings(a: Release, b: Release) -> Iterator[Meaning]:
    old, new = _forms(a), _forms(b)
    found: list[tuple[Bump, str, list[str]]] = [
        ("major", "removed", sorted(old.keys() - new.keys())),
        ("major", "retyped", sorted(name for name in old.keys() & new.keys() if old[name] != new[name])),
        ("minor", "added", sorted(new.keys() - old.keys())),
    ]
    for bump, what, names in found:
        if names:
            yield Meaning(bump, f"feature{'s' * (len(names) > 1)} {what}: {', '.join(names)}")


def _table_meanings(a: Release, b: Release) -> Iterator[Meaning]:
    """Changes of our own tables: rows added after the old ones, or any other change."""
    for name in TABLES:
        if name == "content" or _table_digests(a, name) == _table_digests(b, name):
            continue  # changes of the episodes' content are reported by feature
        old, new = a.arrow_table(name), b.arrow_table(name)
        if table_digest(new.slice(0, len(old))) == table_digest(old):
            if len(new) > len(old):
                yield Meaning("minor", f"table {name}: {len(new) - len(old):,} rows added after the old ones")
        else:
            yield Meaning("major", f"table {name}: its content changed")


def _table_digests(release: Release, name: str) -> list[str]:
    found = payload.digests(release.records).files
    return [found[path] for path in sorted(found) if path.startswith(f"meta/{name}/")]


def _setting_meanings(a: Release, b: Release, files: list[FileChange]) -> Iterator[Meaning]:
    """Changes in the description of the whole release in `meta/`."""
    old, new = dict(a.info), dict(b.info)
    ours_old, ours_new = old.pop("gym_open"), new.pop("gym_open")
    if ours_old.get("license") != ours_new.get("license"):
        yield Meaning("patch", f"licence: {ours_old.get('license')} → {ours_new.get('license')}")
    settings = [*_differing(ours_old, ours_new, _NAMING), *_differing(old, new, _COUNTS)]
    changed = {item.path for item in files}
    settings += ["tasks"] * (TASKS_PATH in changed)
    if settings:
        yield Meaning("patch", f"settings: {', '.join(settings)}")
    if STATS_PATH in changed:
        yield Meaning("patch", "statistics")


def _differing(old: dict[str, Any], new: dict[str, Any], ignored: set[str]) -> list[str]:
    return sorted(key for key in (old.keys() | new.keys()) - ignored if old.get(key) != new.get(key))


def _file_meanings(a: Release, b: Release, files: list[FileChange], *, alone: bool) -> Iterator[Meaning]:
    """Changes of files. If data changed (not `alone`), other boundaries of data files are no change of their own."""
    rewritten = [item.path for item in files if item.how == "serialisation"]
    if rewritten:
        yield Meaning("patch", f"serialisation only: {len(rewritten):,} file(s) with the same content in other bytes")
    cut = [item for item in files if item.how != "serialisation" and item.path.startswith(("data/", "videos/"))]
    if alone and cut:
        yield Meaning(
            "patch", f"serialisation only: the same episodes are cut into files otherwise ({len(cut):,} files)"
        )
    unsealed = not (b.records / artefacts.MANIFEST).exists()
    changed = any(item.path.endswith((".parquet", ".mp4")) for item in files)
    documents = [
        item.path
        for item in files
        if not item.path.startswith(("data/", "videos/", "meta/"))
        and not (item.how == "changed" and same_but_for_version(a, b, item.path, data_changed=changed))
        and not (item.path == CHANGELOG and item.how == "removed" and unsealed)  # it is written later
    ]
    if documents:
        yield Meaning("patch", f"card: {', '.join(documents)}")


def diff_tables(diff: Diff) -> list[Shown]:
    """Tables for a person: what changed, and which files differ."""
    verdict = "nothing but version and date" if diff.bump == "none" else f"{diff.bump}, so {diff.next_version} follows"
    meanings = titled_table(f"{diff.old} → {diff.new}: {verdict}", ["asks for", "what changed"])
    for item in diff.meanings:
        meanings.add_row(item.bump, markup(item.text))
    files = titled_table(f"{len(diff.files):,} files differ", ["file", "how"], unbroken=["how"])
    for change in diff.files:
        how = "same content, other bytes" if change.how == "serialisation" else change.how
        files.add_row(markup(change.path), how)
    return [table for table in (meanings, files) if table.row_count]
