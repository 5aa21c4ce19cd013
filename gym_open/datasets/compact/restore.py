"""Make a release again from a compact release: `restore_release(compact, out)`."""

import functools
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from gym_open import artefacts, progress
from gym_open.artefacts import SCRATCH
from gym_open.datasets.compact.check import wrong_content, wrong_tables
from gym_open.datasets.config import Header
from gym_open.datasets.documents import write_provenance
from gym_open.datasets.writing.prepare import Prepared
from gym_open.datasets.writing.sources import KeyframeAt, SourceEpisode
from gym_open.datasets.writing.splits import Share
from gym_open.datasets.writing.writer import ReleaseWriter, check_workers
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import sha256_file
from gym_open.formats.compact import Compact, open_compact
from gym_open.formats.compact.layout import RELEASE
from gym_open.formats.releases import Release
from gym_open.formats.releases.content import episode_digest
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import INFO_PATH, SPLITS, Split, Table
from gym_open.formats.releases.schemas import EPISODE_ROW
from gym_open.replay.compact.player import CompactPlayer, Stored, stored_episodes
from gym_open.replay.compact.release import CompactRelease, keyframe_rows
from gym_open.replay.compact.tables import stored_tables

if TYPE_CHECKING:
    import pyarrow as pa

_WRITTEN = ("meta/", "data/", "videos/")


class RestoredConfig(Header, frozen=True):
    """Configuration of a restored release whose bytes are not those of the packed one."""

    packed: str = ""
    """Digest of the release that was packed."""


class Restored(msgspec.Struct, frozen=True):
    """The result of a restoration."""

    path: Path
    made: bool
    """False if it was there already."""
    different: list[str]
    """Files with the same content as in the packed release, but with other bytes, because other packages wrote them."""


def restore_release(root: Path, out: Path, *, workers: int | None = None) -> Restored:
    """Make the release that was packed at `root` again, at `out`. Every frame is simulated and compared with a digest.

    With the same versions of pyarrow and PyAV, the result is the packed release in every byte, records included.
    Otherwise it has the same content, and records of its own. A killed run continues when it is run again.

    Args:
        root: folder of a compact release.
        out: folder of the release.
        workers: number of threads; by default one per core. The result does not depend on it.

    Raises:
        ArtefactError: if the compact release is damaged or was changed (names the first such episode).
        UsageError: if something else is at `out`, another process writes it, or `workers` is below 1.
    """
    check_workers(workers)
    compact = open_compact(root)
    there = _there(compact, out)
    if there is not None:
        return there
    different: list[str] = []

    def work(folder: Path) -> "tuple[Header, dict[str, object]] | None":
        facts = _write(compact, folder, workers)
        for name in artefacts.manifest(root):
            inner = name.removeprefix(RELEASE)
            if inner != name and not inner.startswith(_WRITTEN):
                target = folder / inner
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(root / name, target)
        different.extend(_different(compact, folder))
        if not different:
            return None
        for name in (artefacts.MANIFEST, artefacts.SIGNATURE):
            (folder / name).unlink(missing_ok=True)
        config = RestoredConfig(**_header(compact), packed=compact.info.release)
        write_provenance(folder, config, [root], "restore")
        return config, facts

    made = artefacts.remake(out, kind="release", parents=[root], work=work)
    return Restored(made, True, different)


def _there(compact: Compact, out: Path) -> Restored | None:
    """The restored release if it is at `out` already. Raises UsageError if something else is there."""
    if not out.exists():
        return None
    try:
        found = artefacts.verify(out, "release")
        parents = [parent.digest for parent in artefacts.lineage(out).parents]
    except ArtefactError as error:
        raise UsageError(f"{out}: exists and is not a whole release ({error}); give another --out") from None
    if found == compact.info.release:
        return Restored(out, False, [])
    if parents == [compact.digest]:
        return Restored(out, False, list(_different(compact, out)))
    raise UsageError(f"{out}: exists and is another release; give another --out")


def _header(compact: Compact) -> dict[str, Any]:
    ours = compact.release_info["gym_open"]
    return {name: ours[name] for name in ("name", "version", "license", "published")}


def _write(compact: Compact, folder: Path, workers: int | None) -> dict[str, object]:
    """Write data, videos and `meta`, batch after batch, and return the facts.

    Raises:
        ArtefactError: if the content is not that of the packed release.
    """
    batches = compact.release_info["gym_open"]["batches"]
    before: Release | None = None
    facts: dict[str, object] = {}
    with progress.bar("restoring", compact.info.steps) as bar:
        for batch, tables in enumerate(stored_tables(compact)):
            place = folder if batch == batches - 1 else folder / SCRATCH / f"batch-{batch:03d}"
            if place == folder or not (place / INFO_PATH).exists():
                place.mkdir(parents=True, exist_ok=True)
                facts = _write_batch(compact, batch, tables, place, before, workers, bar.advance)
            before = Release(place, "", read_info(place))
    for batch in range(batches - 1):
        shutil.rmtree(folder / SCRATCH / f"batch-{batch:03d}")
    if facts["content"] != compact.info.content:
        raise ArtefactError(wrong_tables(compact, str(facts["content"])))
    return facts


def _write_batch(  # noqa: PLR0917
    compact: Compact, batch: int, tables: Mapping[Table, "pa.Table"], folder: Path, before: Release | None,
    workers: int | None, advance: Callable[[int], None],
) -> dict[str, object]:  # fmt: skip
    info = compact.release_info
    ours = {name: info["gym_open"][name] for name in ("split_by", "val", "max_episode_steps", "pictures")}
    own = [stored for stored in stored_episodes(compact) if stored.row.batch == batch]
    rows = CompactRelease(compact).rows
    player = CompactPlayer(compact)
    expected = {(row.stream, row.segment, row.piece): row.digest for row in compact.episodes}

    def check(made: Prepared) -> None:
        row = made.episode.row
        place = row["stream"], row["segment"], row["piece"]
        if episode_digest(made.content, row) != expected[place]:
            raise ArtefactError(wrong_content(compact, *place, row["first_step"]))

    with ReleaseWriter(
        folder, Header(**_header(compact)), info["features"], _shares(own),
        ours=ours, data_file_mb=info["data_files_size_in_mb"], after=before, workers=workers, check=check,
    ) as writer:  # fmt: skip
        for stream in sorted({stored.row.stream for stored in own}):
            episodes = [stored for stored in own if stored.row.stream == stream]
            skipped = writer.skip(_shares(episodes))
            for stored in episodes:
                if not skipped:
                    row = rows[compact.numbers[stored.number][0]]
                    writer.add_later(stored.row.split, functools.partial(_episode, compact, player, stored, row))
                advance(stored.row.steps)
        return writer.close(tables)


def _shares(episodes: Iterable[Stored]) -> dict[Split, Share]:
    shares: dict[Split, Share] = {split: Share() for split in SPLITS}
    for stored in episodes:
        shares[stored.row.split] = shares[stored.row.split].plus(1, stored.row.steps + 1)
    return shares


def _episode(
    compact: Compact, player: CompactPlayer, stored: Stored, row: Mapping[str, Any], wanted: bool
) -> SourceEpisode | None:
    """Simulate an episode for the writer; if it is not wanted, only for those that continue it."""
    played = player.play(stored, images=wanted)
    if not wanted:
        return None
    keyframes = [
        KeyframeAt(one["segment_step"], one["frame_index"], one["integration_state"])
        for one in keyframe_rows(compact, played)
    ]
    return SourceEpisode(played.numbers, {name: row[name] for name, _ in EPISODE_ROW}, keyframes, images=played.images)


def _different(compact: Compact, folder: Path) -> Iterator[str]:
    """Files whose bytes are not those of the packed release."""
    for name, entry in artefacts.manifest(compact.root / RELEASE).items():
        path = folder / name
        if not path.is_file() or path.stat().st_size != entry.bytes or sha256_file(path) != entry.sha256:
            yield name
