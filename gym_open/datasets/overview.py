"""Tables about releases: the contents of one, and a list of all below a folder. No file is hashed."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from rich import box
from rich.table import Table

from gym_open import artefacts
from gym_open.datasets.compare import payload
from gym_open.datasets.compare.versions import parse
from gym_open.errors import ArtefactError
from gym_open.formats.compact import open_compact
from gym_open.formats.compact.reader import is_compact
from gym_open.formats.releases import Release
from gym_open.formats.releases.content import payload_digest
from gym_open.formats.releases.features import fps
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import INFO_PATH, SPLITS
from gym_open.replay.compact.release import CompactRelease
from gym_open.terminal import markup, titled_table


def info_tables(root: Path) -> list[Table]:
    """Describe the release at `root`: names and digests, splits, explorers, features.

    Raises:
        ArtefactError: if it is missing, is no release, or its records are not readable.
    """
    release = _look(root)
    return [_facts(release), _splits(release), _explorers(release), _features(release)]


def summary_tables(root: Path) -> list[Table]:
    """Summarise a release that was just made, by the first two of `info_tables`.

    Raises:
        ArtefactError: as `info_tables` does.
    """
    release = _look(root)
    return [_facts(release), _splits(release)]


def list_table(folder: Path) -> Table:
    """List all releases below `folder`, except in hidden folders. An unreadable one is listed with the reason.

    Raises:
        ArtefactError: if there is no such folder.
    """
    if not folder.is_dir():
        raise ArtefactError(f"{folder}: no such folder; give one with releases below it")
    numbers = ["frames", "episodes", "explorers", "MB"]
    table = titled_table(f"releases below {folder}", ["release", *numbers, "digest", "folder"], right=numbers)
    table.box, table.pad_edge = box.SIMPLE_HEAD, False
    rows = [_row(root, folder) for root in _roots(folder)]
    for _, row in sorted(rows):
        table.add_row(*row)
    return table


def _look(root: Path) -> Release:
    if is_compact(root):
        return CompactRelease(open_compact(root))
    found = artefacts.digest(root)
    if (kind := artefacts.lineage(root).kind) != "release":
        raise ArtefactError(f"{root}: expected an artefact of kind 'release', got {kind!r}")
    return Release(root, found, read_info(root))


def _facts(release: Release) -> Table:
    ours, episodes = release.info["gym_open"], release.episodes
    entries = artefacts.manifest(release.root)
    steps = int(episodes["steps"].sum())
    parents = artefacts.lineage(release.root).parents
    table = Table.grid(padding=(0, 1))  # a digest fits into 80 columns
    table.title, table.title_justify = markup(f"{release.name} {release.version}"), "left"
    for name, value in (
        ("frames", f"{len(release):,} in {len(episodes):,} episodes"),
        ("actions", f"{steps:,}: {steps / fps() / 60:,.1f} simulated minutes"),
        ("streams", f"{episodes['stream'].nunique():,}"),
        ("worlds", f"{episodes['puzzle'].nunique():,} distinct layouts"),
        ("images", ours["pictures"]),
        ("size", f"{payload.total_bytes(entries) / 1e6:,.1f} MB in {len(entries):,} files"),
        ("form", "compact: its frames are simulated" if isinstance(release, CompactRelease) else "with frames"),
        ("batches", f"{ours['batches']}: one build" + f" and {ours['batches'] - 1} appended" * (ours["batches"] > 1)),
        ("licence", ours["license"]),
        ("published", ours["published"] or "no date"),
        ("digest", release.digest),
        ("payload digest", payload_digest(entries)),
        ("content digest", payload.digests(release.records).release),
        ("made from", "\n".join(f"{parent.lineage.kind} {parent.digest[:16]}" for parent in parents)),
        ("code", artefacts.lineage(release.root).code),
    ):
        table.add_row(name, markup(value))
    return table


def _splits(release: Release) -> Table:
    numbers = ["episodes", "frames", "worlds"]
    table = titled_table(f"splits, by {release.info['gym_open']['split_by']}", ["split", *numbers], right=numbers)
    for split in SPLITS:
        rows = release.episodes[release.episodes["split"] == split]
        table.add_row(split, f"{len(rows):,}", f"{rows['length'].sum():,}", f"{rows['puzzle'].nunique():,}")
    return table


def _explorers(release: Release) -> Table:
    numbers = ["streams", "episodes", "frames", "worlds"]
    table = titled_table("explorers", ["explorer", *numbers, "episodes ended by"], right=numbers)
    for name, rows in release.episodes.groupby("explorer"):
        ended = ", ".join(f"{reason} {count}" for reason, count in sorted(Counter(rows["ended"]).items()))
        table.add_row(
            markup(str(name)), f"{rows['stream'].nunique():,}", f"{len(rows):,}", f"{rows['length'].sum():,}",
            f"{rows['puzzle'].nunique():,}", markup(ended),
        )  # fmt: skip
    return table


def _features(release: Release) -> Table:
    table = titled_table("features", ["feature", "type", "shape"], right=["shape"])
    for name, feature in release.info["features"].items():
        table.add_row(markup(name), markup(feature["dtype"]), "×".join(map(str, feature["shape"])))
    return table


def _roots(folder: Path) -> Iterator[Path]:
    """Folders that look like a release, whole or damaged. `folder` itself may be one."""
    if (folder / INFO_PATH).exists():
        yield folder
        return
    for item in sorted(folder.iterdir()):
        if not item.is_dir() or item.is_symlink() or item.name.startswith("."):
            continue
        if (item / INFO_PATH).exists() or _kind(item) in {"release", "compact"}:
            yield item
        elif _kind(item) is None:
            yield from _roots(item)


def _kind(root: Path) -> str | None:
    """Kind of the artefact at `root`, or None if it cannot be read."""
    try:
        return artefacts.lineage(root).kind
    except ArtefactError:
        return None


def _row(root: Path, folder: Path) -> tuple[tuple[str, tuple[int, int, int]], list[str]]:
    """The key to sort by, and the cells."""
    place = root.relative_to(folder).as_posix()
    try:
        release = _look(root)
        explorers = release.table("streams")["explorer"].nunique()
        size = payload.total_bytes(artefacts.manifest(root)) / 1e6
    except ArtefactError as error:
        return (place, (0, 0, 0)), [f"[red]damaged:[/] {markup(str(error))}", *[""] * 5, markup(place)]
    cells = [
        f"{release.name} {release.version}", f"{len(release):,}", f"{release.info['total_episodes']:,}",
        f"{explorers}", f"{size:,.1f}", release.digest[:8], place,
    ]  # fmt: skip
    return (release.name, parse(release.version) or (0, 0, 0)), [markup(cell) for cell in cells]
