"""Simulate a compact release, and compare every episode with the digest of its content."""

import pyarrow as pa

from gym_open import progress
from gym_open.errors import ArtefactError
from gym_open.formats.compact import Compact
from gym_open.formats.compact.layout import EPISODES
from gym_open.formats.releases.content import EPISODE_PLACES, episode_digest, release_digest
from gym_open.formats.releases.schemas import table_schema
from gym_open.replay.compact.player import CompactPlayer, PlayedEpisode, Stored, in_order, stored_episodes
from gym_open.replay.compact.release import CompactRelease, content_of, keyframe_rows


def check_frames(compact: Compact, workers: int | None = None) -> None:
    """Simulate every frame, and check the content digests of all episodes and of the release.

    Memory holds a few episodes and all keyframes, 12 bytes per step.

    Raises:
        ArtefactError: naming the first episode that does not have its digest, or if the digest of the release differs.
    """
    release = CompactRelease(compact)
    player = CompactPlayer(compact)
    rows = release.rows

    def digest(stored: Stored) -> tuple[PlayedEpisode, str]:
        played = player.play(stored)
        row = rows[compact.numbers[stored.number][0]]
        return played, episode_digest(content_of(played), row)

    schema = table_schema("keyframes", compact.release_info["features"])
    keyframes: list[tuple[int, pa.Table]] = []
    with progress.bar("simulating", compact.info.steps) as bar:
        for played, found in in_order(stored_episodes(compact), digest, workers):
            number = compact.numbers[played.stored.number][0]
            if found != played.stored.row.digest:
                row = played.stored.row
                raise ArtefactError(wrong_content(compact, row.stream, row.segment, row.piece, row.first_step))
            keyframes.append((number, pa.Table.from_pylist(keyframe_rows(compact, played), schema=schema)))
            bar.advance(played.stored.row.steps)
    ordered = [table for _, table in sorted(keyframes, key=lambda item: item[0])]
    digests = {number: row.digest for row, (number, _) in zip(compact.episodes, compact.numbers, strict=True)}
    places = pa.Table.from_pandas(release.episodes[list(EPISODE_PLACES)], preserve_index=False)
    tables = {name: release.arrow_table(name) for name in ("streams", "worlds", "switches", "segments")}
    tables["keyframes"] = pa.concat_tables([schema.empty_table(), *ordered])
    found = release_digest(
        compact.release_info["features"], [digests[number] for number in range(len(digests))], places, tables
    )
    if found != compact.info.content:
        raise ArtefactError(wrong_tables(compact, found))


def wrong_tables(compact: Compact, found: str) -> str:
    """What to say about a release whose content digest is `found` although all episodes have theirs."""
    return (
        f"{compact.root}: all episodes have their digests, but the release has the content digest {found}, expected "
        f"{compact.info.content}: its tables were changed; get the compact release again"
    )


def wrong_content(compact: Compact, stream: int, segment: int, piece: int, first_step: int) -> str:
    """What to say about an episode that does not have its digest."""
    return (
        f"{compact.root / EPISODES}: stream {stream}, segment {segment}, piece {piece}, from step {first_step}: what "
        "is simulated is not what was packed: its actions, world or values were changed, or this version simulates "
        "another world than the one that played them; get it again, or use the version in its provenance"
    )
