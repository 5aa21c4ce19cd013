"""Playing a release again: from every keyframe, the stored actions in a fresh simulation, down to the pixel."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np
from rich.table import Table

from gym_open import progress
from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.datasets.verify.tables import puzzles_of
from gym_open.datasets.writing.frames import LENGTH_CAP
from gym_open.envs.physics.contacts import Contact
from gym_open.errors import GymOpenError
from gym_open.formats.releases.features import STATE_FIELDS
from gym_open.formats.releases.layout import data_path
from gym_open.formats.releases.reader import Release
from gym_open.replay.player import Player, RecordedObservation, ReplayWindow
from gym_open.replay.table import replay_tables, worst_verdict


class ReplayResult(msgspec.Struct):
    """What came of it."""

    windows: list[ReplayWindow]
    steps: int = 0
    """Steps that were played again."""
    skipped: int = 0
    """Steps before the first keyframe of their episode."""

    @property
    def outcome(self) -> str:
        """In words."""
        left = f", {self.skipped:,} not replayed (before the first state of their episode)" if self.skipped else ""
        if not self.windows:
            return f"nothing to replay{left}"
        return f"{worst_verdict(self.windows)} ({self.steps:,} steps in {len(self.windows):,} windows{left})"

    def tables(self, tolerance: float) -> list[Table]:
        """One row per stream, and the windows that are not identical."""
        return replay_tables(self.windows, tolerance)


def replay_release(release: Release, tolerance: float, findings: Findings) -> ReplayResult:
    """Play all episodes again and note those that went another way. Memory is that of one episode and all states."""
    done = ReplayResult([])
    names = tuple(release.info["gym_open"]["objects"])
    player = Player(tolerance)
    if names != player.world.inventory:
        findings.add(
            "meta/info.json",
            f"its {len(names)} objects are not the {len(player.world.inventory)} of this version's world; replay it "
            "with the version that its provenance names",
        )
        return done
    played = _EpisodeReplayer(release, player)
    with progress.bar("replaying", int(release.episodes["steps"].sum())) as bar:
        for row in rows_of(release.episodes):
            try:
                done.windows += played.episode(row)
            except GymOpenError as error:
                findings.add(played.file, f"episode {row['episode_index']}: cannot be replayed: {error}")
                player.finish()
            bar.advance(row["steps"], f"episode {row['episode_index']}")
    done.windows += played.finish()
    done.steps = sum(window.steps for window in done.windows)
    for window in done.windows:
        if window.verdict == "diverged":
            findings.add(*_difference(window, release))
    done.skipped = played.skipped
    if done.skipped and not done.steps:
        findings.add(
            "meta/keyframes",
            f"none of {done.skipped:,} steps has a stored state before it: nothing can be replayed; get a release with "
            "them, or check all but the replay",
        )
    return done


def _difference(window: ReplayWindow, release: Release) -> tuple[str, str]:
    """In which file a window diverged, and where and by how much, in words."""
    rows = release.episodes
    rows = rows[(rows["stream"] == window.stream) & (rows["segment"] == window.segment)].sort_values("piece")
    (row,) = rows_of(rows[rows["first_step"] <= (window.first_diverged or 0)].tail(1))
    off = max(window.state_error, key=window.state_error.__getitem__, default=None)
    parts = [] if off is None else [f"{off} off by {window.state_error[off]:.2g}"]
    parts += [f"contacts off in {window.contact_steps} step(s)"] if window.contact_steps else []
    parts += [f"{window.pixels:,} pixel(s) of {window.images} picture(s)"] if window.pixels else []
    where = f"episode {row['episode_index']}: diverged in the replay at step {window.first_diverged} of its stream"
    return data_path(row["data/chunk_index"], row["data/file_index"]), f"{where} ({', '.join(parts)})"


class _EpisodeReplayer:
    """Episodes, one at a time, with what a replay needs to know of all of them."""

    def __init__(self, release: Release, player: Player) -> None:
        self._release, self._player = release, player
        self._puzzles = puzzles_of(release)
        frames = release.table("keyframes")
        places = zip(frames["episode_index"].tolist(), frames["frame_index"].tolist(), strict=True)
        self._rows = {place: i for i, place in enumerate(places)}
        self._states = frames["integration_state"].tolist()
        self.skipped = 0
        self.file = ""
        """Where the episode in hand lies."""
        self._next: tuple[int, int, int] | None = None
        """Stream, segment and piece that would go on from where the world is now."""

    def episode(self, row: dict[str, Any]) -> Iterator[ReplayWindow]:
        """Play an episode; every window that ends in it. One goes on in the next episode, if that is the next piece.

        Raises:
            GymOpenError: if something of it cannot be played by this version.
        """
        player, number, steps = self._player, row["episode_index"], row["steps"]
        place = row["stream"], row["segment"], row["piece"]
        self.file = data_path(row["data/chunk_index"], row["data/file_index"])
        if place != self._next:
            yield from self.finish()
        self._next = (*place[:2], place[2] + 1) if row["ended"] == LENGTH_CAP else None
        names = player.world.inventory
        values = self._release.numbers(row["dataset_from_index"], row["dataset_to_index"])
        images = self._release.images(range(row["dataset_from_index"], row["dataset_to_index"]))
        states = values["observation.environment_state"].reshape(steps + 1, -1, len(STATE_FIELDS))
        player.compare(RecordedObservation(states[0], images[0]), names)
        for i in range(steps + 1):
            if (frame := self._rows.get((number, i))) is not None:
                yield from self._restart(row, i, self._states[frame], RecordedObservation(states[i], images[i]))
            if i < steps and player.window is None:
                self.skipped += 1
            elif i < steps:
                against = _against(*(values[f"contact.{name}"][i] for name in ("count", "agent", "impulse")))
                player.step(
                    int(values["action.index"][i]), against, RecordedObservation(states[i + 1], images[i + 1]), names
                )

    def finish(self) -> list[ReplayWindow]:
        """The window that was going on, if there is one."""
        window = self._player.finish()
        return [] if window is None else [window]

    def _restart(
        self, row: dict[str, Any], i: int, state: np.ndarray, seen: RecordedObservation
    ) -> Iterator[ReplayWindow]:
        """End a window at frame `i` of an episode, and begin the next one in the stored state."""
        player = self._player
        if player.window is None:
            player.load(self._puzzles[row["stream"], row["world"]])
        player.check_state(state)
        yield from self.finish()
        player.begin(
            ReplayWindow(row["stream"], row["segment"], row["first_step"] + i), state, seen, player.world.inventory
        )


def _against(count: int, agent: int, impulse: np.float32) -> Callable[[tuple[Contact, ...]], float | None]:
    """How far a step's contacts are from the three numbers of a release (N s); infinite if there are not as many."""

    def error(found: tuple[Contact, ...]) -> float | None:
        total = np.float32(sum(contact.impulse for contact in found))
        touching = sum("agent" in (contact.a, contact.b) for contact in found)
        if (len(found), touching) != (count, agent):
            return math.inf
        return None if total == impulse else abs(float(total) - float(impulse))

    return error
