"""A compact release that is read like a release: its frames are simulated when they are wanted."""

import functools
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gym_open.formats.compact import Compact, open_compact
from gym_open.formats.compact.layout import EpisodeRow
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import IMAGE, Release
from gym_open.formats.releases.content import feature_digest
from gym_open.formats.releases.frames import frame_numbers
from gym_open.formats.releases.schemas import EPISODE_ROW, table_schema
from gym_open.formats.releases.segments import segments_of_episodes
from gym_open.replay.compact.player import CompactPlayer, PlayedEpisode, Stored, in_order, stored_episodes
from gym_open.replay.compact.tables import stored_tables

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from gym_open.formats.releases.layout import Table

_CACHED_EPISODES = 8
"""Simulated episodes that stay in memory: 22 MB each at 1,024 steps."""


class CompactRelease(Release):
    """The release that a compact release stands for.

    To read an episode, it simulates the episodes that it continues, without images. Reading in order is fast.
    """

    def __init__(self, compact: Compact) -> None:
        super().__init__(compact.root, compact.digest, compact.release_info)
        self.compact = compact
        self._cache: OrderedDict[int, PlayedEpisode] = OrderedDict()

    @staticmethod
    def opener(root: Path) -> Release:
        """Open a compact release, for copies in other processes."""
        return CompactRelease(open_compact(root))

    @property
    def records(self) -> Path:
        """Folder of the release's records and documents."""
        return self.root / "release"

    @functools.cached_property
    def episodes(self) -> "pd.DataFrame":
        """As `Release.episodes`, without the numbers of data files."""
        import pandas as pd

        return pd.DataFrame(self.rows)

    @functools.cached_property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of `episodes`."""
        found = {number: self._row(row, number, first) for row, (number, first) in self._numbered()}
        return [found[number] for number in range(len(found))]

    def column(self, name: str) -> np.ndarray:
        """As `Release.column`. What is not stored is simulated, without images."""
        if name not in self._numbers:
            return super().column(name)
        feature = self._numbers[name]
        shape = [] if feature["shape"] == [1] else feature["shape"]
        out = np.empty((len(self), *shape), feature["dtype"])
        simulated = name not in {"action.index", *self.compact.columns}
        for first, values in self._all_numbers(simulate=simulated):
            out[first : first + len(values[name])] = values[name]
        return out

    @functools.cached_property
    def frames(self) -> "pd.DataFrame":
        """As `Release.frames`; the whole release is simulated, without images."""
        import pandas as pd

        names = [name for name, feature in self._numbers.items() if feature["shape"] == [1]]
        found = sorted(self._all_numbers(simulate=True), key=lambda item: item[0])
        return pd.DataFrame({name: np.concatenate([values[name] for _, values in found]) for name in names})

    def numbers(self, first: int, stop: int) -> dict[str, np.ndarray]:
        """As `Release.numbers`."""
        if not 0 <= first < stop <= len(self):
            raise IndexError(f"{self.root}: expected frames within [0, {len(self)}), got {first} to {stop}")
        pieces = []
        for start, played in self._played(first, stop):
            values = self._all_of(played)
            cut = slice(max(first - start, 0), stop - start)
            pieces.append({name: values[name][cut] for name in self._numbers})
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in self._numbers}

    def images(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        """As `Release.images`."""
        wanted = self._checked(indices)
        out = np.empty((len(wanted), *self.info["features"][IMAGE]["shape"]), dtype=np.uint8)
        numbers = np.searchsorted(self._firsts, wanted, side="right") - 1
        for number in np.unique(numbers):
            own = numbers == number
            out[own] = self._episode(int(number)).images[wanted[own] - self._firsts[number]]
        return out

    def image_pieces(self, count: int) -> Iterator[np.ndarray]:
        """As `Release.image_pieces`: the whole release is simulated once, in threads."""
        player = CompactPlayer(self.compact)
        rest = np.empty((0, *self.info["features"][IMAGE]["shape"]), np.uint8)
        for played in in_order(self._in_release_order(), player.play):
            rest = np.concatenate([rest, played.images])
            while len(rest) >= count:
                yield rest[:count]
                rest = rest[count:]
        if len(rest):
            yield rest

    def pngs(self, indices: Sequence[int] | np.ndarray) -> list[bytes]:
        """As `Release.pngs`."""
        return encode_pngs(self.images(indices))

    def arrow_table(self, name: "Table") -> "pa.Table":
        """As `Release.arrow_table`. For `keyframes` and `content`, the whole release is simulated."""
        import pyarrow as pa

        schema = table_schema(name, self.info["features"])
        if name in {"keyframes", "content"}:
            rows = self._keyframes() if name == "keyframes" else self._contents()
            return pa.Table.from_pylist(rows, schema=schema)
        if name == "segments":
            return segments_of_episodes(self.episodes)
        if name not in {"streams", "worlds", "switches"}:
            raise KeyError(f"{self.root}: no table {name!r}")
        return pa.concat_tables(tables[name] for tables in stored_tables(self.compact))

    def _keyframes(self) -> list[dict[str, Any]]:
        player = CompactPlayer(self.compact)
        found: list[dict[str, Any]] = []
        for played in in_order(self._in_release_order(), lambda one: player.play(one, images=False)):
            found += keyframe_rows(self.compact, played)
        return found

    def _contents(self) -> list[dict[str, Any]]:
        player = CompactPlayer(self.compact)

        def digests(stored: Stored) -> dict[str, Any]:
            number = self.compact.numbers[stored.number][0]
            return {"episode_index": number, **content_of(player.play(stored))}

        return list(in_order(self._in_release_order(), digests))

    def _numbered(self) -> Iterator[tuple[EpisodeRow, tuple[int, int]]]:
        return zip(self.compact.episodes, self.compact.numbers, strict=True)

    def _row(self, row: EpisodeRow, number: int, first: int) -> dict[str, Any]:
        ours = {name: getattr(row, name) for name, _ in EPISODE_ROW if hasattr(row, name)}
        return {
            "episode_index": number, "length": row.steps + 1,
            "dataset_from_index": first, "dataset_to_index": first + row.steps + 1,
            **ours, "puzzle": self.compact.puzzles[row.stream, row.world].digest,
            "explorer": self._explorers[row.stream], "meta/episodes/file_index": row.batch,
        }  # fmt: skip

    @functools.cached_property
    def _explorers(self) -> dict[int, str]:
        return {row.stream: row.explorer for row in self.compact.streams}

    @functools.cached_property
    def _stored(self) -> list[Stored]:
        """What is stored of all episodes, in the order of the release: a few bytes per step."""
        found = list(stored_episodes(self.compact))
        return sorted(found, key=lambda one: self.compact.numbers[one.number])

    def _in_release_order(self) -> Iterator[Stored]:
        yield from self._stored

    @functools.cached_property
    def _firsts(self) -> np.ndarray:
        return np.sort(np.array([first for _, first in self.compact.numbers]))

    def _played(self, first: int, stop: int) -> Iterator[tuple[int, PlayedEpisode]]:
        """First frame, and episode, of all episodes with frames from `first` to `stop`."""
        low = int(np.searchsorted(self._firsts, first, side="right")) - 1
        for number in range(low, int(np.searchsorted(self._firsts, stop))):
            yield int(self._firsts[number]), self._episode(number)

    def _episode(self, number: int) -> PlayedEpisode:
        """Simulate the episode with this number in the release, unless it is in memory."""
        if number not in self._cache:
            self._cache[number] = self._player.play(self._stored[number])
        self._cache.move_to_end(number)
        if len(self._cache) > _CACHED_EPISODES:
            self._cache.popitem(last=False)
        return self._cache[number]

    @functools.cached_property
    def _player(self) -> CompactPlayer:
        return CompactPlayer(self.compact)

    def _all_numbers(self, *, simulate: bool) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """First frame and numeric features of every episode; only stored ones unless `simulate`."""
        if simulate:
            player = CompactPlayer(self.compact)
            for played in in_order(self._in_release_order(), lambda one: player.play(one, images=False)):
                yield self.compact.numbers[played.stored.number][1], self._all_of(played)
            return
        for stored in self._stored:
            yield self.compact.numbers[stored.number][1], stored_numbers(stored)

    def _all_of(self, played: PlayedEpisode) -> dict[str, np.ndarray]:
        """All numeric features of an episode, with those that only number frames."""
        number, first = self.compact.numbers[played.stored.number]
        index = first + np.arange(played.stored.row.steps + 1)
        same = {"episode_index": np.full_like(index, number), "task_index": np.zeros_like(index)}
        return {**played.numbers, "index": index, **same}


def content_of(played: PlayedEpisode) -> dict[str, str]:
    """Content digest of each feature of an episode."""
    found = {name: feature_digest(values) for name, values in played.numbers.items()}
    return {**found, IMAGE: feature_digest(played.images)}


def keyframe_rows(compact: Compact, played: PlayedEpisode) -> list[dict[str, Any]]:
    """Rows of the table `keyframes` of an episode."""
    row, number = played.stored.row, compact.numbers[played.stored.number][0]
    begin = row.piece * compact.release_info["gym_open"]["max_episode_steps"]
    return [
        {
            "stream": row.stream, "segment": row.segment, "segment_step": begin + frame, "episode_index": number,
            "frame_index": frame, "integration_state": state,
        }
        for frame, state in zip(row.keyframes, played.states, strict=True)
    ]  # fmt: skip


def stored_numbers(stored: Stored) -> dict[str, np.ndarray]:
    """The features that follow from what is stored alone: actions and the explorer's own values."""
    steps = stored.row.steps
    nothing = np.zeros((steps + 1, 1, 13)), 0, np.zeros((steps, 2), np.int64), np.zeros(steps)
    values = frame_numbers(stored.actions.astype(np.int64), *nothing, stored.learned)
    return {name: values[name] for name in ("action.index", *stored.learned)}
