"""Reader of compact releases. A compact release is untrusted until it is verified, as a release is."""

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gym_open import artefacts, extras
from gym_open.envs.puzzles import Puzzle
from gym_open.errors import ArtefactError, GymOpenError
from gym_open.formats.compact.before import predecessors, visits_before
from gym_open.formats.compact.files import NumberReader, read_rows
from gym_open.formats.compact.layout import (
    ACTIONS,
    EPISODES,
    FORMAT,
    INFO,
    LOSSES,
    RELEASE,
    STATES,
    STREAMS,
    SWITCHES,
    WORLDS,
    CompactInfo,
    EpisodeRow,
    StateRow,
    StreamRow,
    SwitchRow,
    WorldPlace,
    WorldRow,
    belongs,
    column_path,
)
from gym_open.formats.releases.features import learned
from gym_open.formats.releases.info import read_info, read_json
from gym_open.formats.releases.layout import SPLITS

_REMEDY = "get the compact release again"


class Compact:
    """A compact release on disk whose bytes and rows were checked. Nothing is simulated here."""

    def __init__(self, root: Path, digest: str, info: CompactInfo) -> None:
        self.root = root
        self.digest = digest
        """Digest of the artefact."""
        self.info = info
        self.release_info: dict[str, Any] = read_info(root / RELEASE)
        """The release's `meta/info.json`."""
        self.columns = learned(self.release_info["features"])
        """Features with the explorer's own values."""

    @functools.cached_property
    def episodes(self) -> list[EpisodeRow]:
        """All episodes in the order in which they were played: by batch, stream and step."""
        return list(read_rows(self.root / EPISODES, EpisodeRow))

    @functools.cached_property
    def streams(self) -> list[StreamRow]:
        """All streams, by batch."""
        return list(read_rows(self.root / STREAMS, StreamRow))

    @functools.cached_property
    def worlds(self) -> list[tuple[str, WorldPlace]]:
        """Layout as JSON, and place, of every world of every stream, by place."""
        rows = read_rows(self.root / WORLDS, WorldRow)
        return sorted(((row.puzzle, place) for row in rows for place in row.places), key=_place_of)

    @functools.cached_property
    def puzzles(self) -> dict[tuple[int, int], Puzzle]:
        """The layout of every stream and world.

        Raises:
            ArtefactError: if one of them is no puzzle.
        """
        read = functools.cache(Puzzle.from_json)
        try:
            return {(place.stream, place.world): read(text) for text, place in self.worlds}
        except GymOpenError as error:
            raise ArtefactError(f"{self.root / WORLDS}: {error}; {_REMEDY}") from None

    @functools.cached_property
    def switches(self) -> list[SwitchRow]:
        """All switches, by batch and stream."""
        return list(read_rows(self.root / SWITCHES, SwitchRow))

    @functools.cached_property
    def states(self) -> list[np.ndarray]:
        """States for the episodes that begin with one, in their order."""
        if not (self.root / STATES).exists():
            return []
        return [np.array(row.values) for row in read_rows(self.root / STATES, StateRow)]

    @functools.cached_property
    def numbers(self) -> list[tuple[int, int]]:
        """For each episode, its number and the number of its first frame in the release."""
        found: list[tuple[int, int]] = [(0, 0)] * len(self.episodes)
        number = frame = 0
        place = {split: i for i, split in enumerate(SPLITS)}
        order = sorted(range(len(found)), key=lambda i: (self.episodes[i].batch, place[self.episodes[i].split], i))
        for i in order:
            found[i] = number, frame
            number, frame = number + 1, frame + self.episodes[i].steps + 1
        return found

    @functools.cached_property
    def before(self) -> list[int | None]:
        """For each episode, the number of the episode in whose last state it begins; None for another start."""
        streams = [(row.stream, (row.batch, row.log), row.log_stream) for row in self.streams]
        switches = [(row.stream, row.step, row.from_world, row.to_world) for row in self.switches]
        return predecessors(self.episodes, visits_before(streams, switches))

    @contextmanager
    def actions(self) -> Iterator[NumberReader]:
        """All actions, episode by episode."""
        with NumberReader(self.root / ACTIONS, np.uint8, self.info.steps) as file:
            yield file

    @contextmanager
    def column(self, name: str) -> Iterator[NumberReader]:
        """The values of a feature in `columns`, episode by episode."""
        with NumberReader(self.root / column_path(name), np.float32, self.info.steps) as file:
            yield file

    def losses(self) -> np.ndarray:
        """The losses of worlds at all switches, one after the other, float64."""
        with NumberReader(self.root / LOSSES, np.float64, sum(row.losses for row in self.switches)) as file:
            return file.take(sum(row.losses for row in self.switches))


def _place_of(item: tuple[str, WorldPlace]) -> tuple[int, int]:
    return item[1].stream, item[1].world


def open_compact(root: Path) -> Compact:
    """Open the compact release at `root`: every byte and every row is checked, but no frame is simulated.

    Raises:
        ArtefactError: if it is missing, damaged, or no compact release of this format (names the file).
        MissingExtraError: if the packages that read releases are not installed.
    """
    extras.check("releases")
    digest = artefacts.verify(root, "compact")
    for name in artefacts.manifest(root):
        if not belongs(name):
            raise ArtefactError(f"{root / name}: no compact release of this format has such a file; do not use it")
    path = root / INFO
    info = read_json(path, CompactInfo)
    if info.format != FORMAT:
        raise ArtefactError(f"{path}: format must be {FORMAT!r}, got {info.format!r}; use the version that wrote it")
    opened = Compact(root, digest, info)
    _check_release(opened)
    _check_rows(opened)
    return opened


def _check_release(opened: Compact) -> None:
    """Raises ArtefactError if the records of the release are not those that `compact.json` names."""
    info, there = opened.info, opened.release_info
    found = {
        "release": artefacts.digest(opened.root / RELEASE),
        "name": there["gym_open"]["name"],
        "version": there["gym_open"]["version"],
        "episodes": there["total_episodes"],
        "steps": there["total_frames"] - there["total_episodes"],
        "columns": opened.columns,
    }
    for field, value in found.items():
        if getattr(info, field) != value:
            raise ArtefactError(
                f"{opened.root / INFO}: {field} is {getattr(info, field)!r}, its release says {value!r}; {_REMEDY}"
            )
    listed = artefacts.manifest(opened.root / RELEASE)
    own = artefacts.manifest(opened.root)
    for name, entry in own.items():
        inner = name.removeprefix(RELEASE)
        if inner != name and inner not in {artefacts.MANIFEST, artefacts.SIGNATURE} and listed.get(inner) != entry:
            raise ArtefactError(f"{opened.root / name}: not as the release's manifest says; {_REMEDY}")


def _check_rows(opened: Compact) -> None:
    """Raises ArtefactError if a row contradicts another one."""
    rows, info = opened.episodes, opened.info
    path = opened.root / EPISODES

    def expect(good: bool, what: str) -> None:
        if not good:
            raise ArtefactError(f"{path}: {what}; {_REMEDY}")

    batches = {row.stream: row.batch for row in opened.streams}
    limit = opened.release_info["gym_open"]["max_episode_steps"]
    expect(len(rows) == info.episodes, f"{len(rows):,} episodes, {INFO} says {info.episodes:,}")
    expect(sum(row.steps for row in rows) == info.steps, f"not the {info.steps:,} steps of {INFO}")
    starts = Counter(row.start for row in rows)
    expect(starts["state"] == len(opened.states), f"{starts['state']} episodes begin with one of {STATES}")
    order = [(row.batch, row.stream, row.first_step, row.piece) for row in rows]
    expect(order == sorted(set(order)), "episodes are not in order")
    for i, row in enumerate(rows):
        where = f"episode {i}"
        expect(batches.get(row.stream) == row.batch, f"{where}: no stream {row.stream} in batch {row.batch}")
        expect((row.stream, row.world) in opened.puzzles, f"{where}: stream {row.stream} has no world {row.world}")
        expect(row.steps <= limit, f"{where}: more than {limit} steps")
        expect(_ascending(row.keyframes, row.steps), f"{where}: keyframes are not frames in order")
    for i, before in enumerate(opened.before):
        expect(rows[i].start not in {"episode", "world"} or before is not None, f"episode {i}: nothing comes before it")


def _ascending(frames: Sequence[int], last: int) -> bool:
    return list(frames) == sorted(set(frames)) and (not frames or 0 <= frames[0] <= frames[-1] <= last)


def is_compact(root: Path) -> bool:
    """Whether an artefact at `root` says that it is a compact release."""
    try:
        return artefacts.lineage(root).kind == "compact"
    except GymOpenError:
        return False
