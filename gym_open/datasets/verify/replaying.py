"""Replay a release: from every keyframe, simulate the stored actions again and compare every pixel."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np
from rich.table import Table

from gym_open import progress
from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.datasets.verify.tables import puzzles_of
from gym_open.envs.physics.contacts import Contact
from gym_open.errors import GymOpenError
from gym_open.formats.releases.features import STATE_FIELDS
from gym_open.formats.releases.frames import LENGTH_CAP
from gym_open.formats.releases.layout import data_path
from gym_open.formats.releases.reader import Release
from gym_open.replay.player import Player, RecordedObservation, ReplayWindow
from gym_open.replay.table import replay_tables, worst_verdict


class ReplayResult(msgspec.Struct):
    """Result of the replay of a release."""

    windows: list[ReplayWindow]
    steps: int = 0
    """Number of replayed steps."""
    skipped: int = 0
    """Number of steps before the first keyframe of their episode, which cannot be replayed."""

    @property
    def outcome(self) -> str:
        """The result in words."""
        left = f", {self.skipped:,} not replayed (before the first state of their episode)" if self.skipped else ""
        if not self.windows:
            return f"nothing to replay{left}"
        return f"{worst_verdict(self.windows)} ({self.steps:,} steps in {len(self.windows):,} windows{left})"

    def tables(self, tolerance: float) -> list[Table]:
        """Tables with one row per stream, and with the windows that are not identical."""
        return replay_tables(self.windows, tolerance)


def replay_release(release: Release, tolerance: float, findings: Findings) -> ReplayResult:
    """Replay all episodes and record those that diverge. Memory holds one episode and all keyframes."""
    done = ReplayResult([])
    names = tuple(release.info["gym_open"]["objects"])
    player = Player(tolerance)
    if names != player.world.inventory:
        findings.add(
            "meta/info.json",
            f"its {len(names)} objects are not the {len(player.world.inventory)} of this version's world; replay it "
            "with the version in its provenance",
        )
        return done
    replayer = _EpisodeReplayer(release, player)
    with progress.bar("replaying", int(release.episodes["steps"].sum())) as bar:
        for row in rows_of(release.episodes):
            try:
                done.windows += replayer.episode(row)
            except GymOpenError as error:
                findings.add(replayer.file, f"episode {row['episode_index']}: cannot be replayed: {error}")
                player.finish()
            bar.advance(row["steps"], f"episode {row['episode_index']}")
    done.windows += replayer.finish()
    done.steps = sum(window.steps for window in done.windows)
    for window in done.windows:
        if window.verdict == "diverged":
            findings.add(*_difference(window, release))
    done.skipped = replayer.skipped
    if done.skipped and not done.steps:
        findings.add(
            "meta/keyframes",
            f"none of {done.skipped:,} steps has a stored state before it: nothing can be replayed; get a release with "
            "stored states, or verify without the replay",
        )
    return done


def _difference(window: ReplayWindow, release: Release) -> tuple[str, str]:
    """The file in which a window diverged, and where and by how much, in words."""
    rows = release.episodes
    rows = rows[(rows["stream"] == window.stream) & (rows["segment"] == window.segment)].sort_values("piece")
    (row,) = rows_of(rows[rows["first_step"] <= (window.first_diverged or 0)].tail(1))
    off = max(window.state_error, key=window.state_error.__getitem__, default=None)
    parts = [] if off is None else [f"{off} off by {window.state_error[off]:.2g}"]
    parts += [f"contacts off in {window.contact_steps} step(s)"] if window.contact_steps else []
    parts += [f"{window.pixels:,} pixel(s) of {window.images} image(s)"] if window.pixels else []
    where = f"episode {row['episode_index']}: diverged in the replay at step {window.first_diverged} of its stream"
    return data_path(row["data/chunk_index"], row["data/file_index"]), f"{where} ({', '.join(parts)})"


class _EpisodeReplayer:
    """Replays episodes one at a time, with the keyframes of all of them in memory."""

    def __init__(self, release: Release, player: Player) -> None:
        self._release, self._player = release, player
        self._puzzles = puzzles_of(release)
        frames = release.table("keyframes")
        places = zip(frames["episode_index"].tolist(), frames["frame_index"].tolist(), strict=True)
        self._rows = {place: i for i, place in enumerate(places)}
        self._states = frames["integration_state"].tolist()
        self.skipped = 0
        self.file = ""
        """File of the current episode."""
        self._next: tuple[int, int, int] | None = None
        """Stream, segment and piece that continue from the current state of the world."""

    def episode(self, row: dict[str, Any]) -> Iterator[ReplayWindow]:
        """Replay an episode; yield every window that ends in it. A window can continue in the next piece.

        Raises:
            GymOpenError: if this version cannot replay a part of it.
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
        """End the current window and return it, if there is one."""
        window = self._player.finish()
        return [] if window is None else [window]

    def _restart(
        self, row: dict[str, Any], i: int, state: np.ndarray, seen: RecordedObservation
    ) -> Iterator[ReplayWindow]:
        """End the window at frame `i` of an episode, and begin the next one from the stored state."""
        player = self._player
        if player.window is None:
            player.load(self._puzzles[row["stream"], row["world"]])
        player.check_state(state)
        yield from self.finish()
        player.begin(
            ReplayWindow(row["stream"], row["segment"], row["first_step"] + i), state, seen, player.world.inventory
        )


def _against(count: int, agent: int, impulse: np.float32) -> Callable[[tuple[Contact, ...]], float | None]:
    """Make a function that compares contacts with the numbers in a release (N s); infinite if their number differs."""

    def error(found: tuple[Contact, ...]) -> float | None:
        total = np.float32(sum(contact.impulse for contact in found))
        touching = sum("agent" in (contact.a, contact.b) for contact in found)
        if (len(found), touching) != (count, agent):
            return math.inf
        return None if total == impulse else abs(float(total) - float(impulse))

    return error
