"""Read streams from a release. A release does not record what was stuck; its states and actions determine it."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.stuck import Watch, position
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs import Stuck, Switch
from gym_open.formats.logs.logfile import check_nesting
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import IMAGE, Release
from gym_open.formats.releases.layout import PART as PART_COLUMN
from gym_open.viz.config import Choice
from gym_open.viz.streams.model import (
    ACTION,
    CONTACTS,
    ENTROPY,
    LOSS,
    PART,
    PREVIEW_STEPS,
    REWARD,
    SPAN_STEPS,
    VALUE,
    ShownSegment,
    ShownStream,
    Span,
    known_of,
    overlap,
)

_COLUMNS = {
    REWARD: "reward.intrinsic",
    LOSS: "world_model.loss",
    ENTROPY: "policy.entropy",
    VALUE: "policy.value",
    CONTACTS: "contact.count",
    ACTION: "action.index",
}


class _EpisodeRange(NamedTuple):
    """An episode of the release: consecutive steps of one segment."""

    segment: int
    world: int
    puzzle: str
    continued: bool
    begins: bool
    """Whether it is the first episode of its segment."""
    ends: bool
    """Whether it is the last episode of its segment."""
    steps: range
    first_frame: int
    """Frame of the first observation; an episode of T steps has T + 1 frames."""


def open_streams(release: Release) -> list[ShownStream]:
    """Open the streams of a release; this reads only the first frames.

    Raises:
        ArtefactError: if the release is damaged, or its tables are inconsistent.
    """
    try:
        return _streams(release)
    except (KeyError, ValueError, RecursionError) as error:
        what = f"{type(error).__name__}: {error}"
        raise ArtefactError(
            f"{release.root}: its tables are inconsistent ({what}); `gym-open dataset verify` shows the reason"
        ) from None


def _streams(release: Release) -> list[ShownStream]:
    rows = release.arrow_table("streams").to_pylist()
    names = ("switches", "segments", "worlds")
    switches, segments, worlds = (release.arrow_table(name).to_pylist() for name in names)
    found: list[ShownStream] = []
    for row in rows:
        number = row["stream"]
        own = [_switch(item) for item in switches if item["stream"] == number]
        pool = sum(world["stream"] == number for world in worlds)
        if "world_model.loss" in release.info["features"] and {len(item.world_losses) for item in own} - {pool}:
            raise ValueError(f"stream {number}: a switch does not have a loss for each world of the pool")
        shown = _segments([item for item in segments if item["stream"] == number], own)
        episodes = _episodes(release, number)
        if episodes:
            found.append(_stream(release, row, own, shown, episodes))
    return found


def narrowed(release: Release, choice: Choice) -> Choice:
    """Replace the episode of a choice by its stream and steps.

    Raises:
        UsageError: if there is no such episode, or it belongs to another stream than the selected one.
    """
    if choice.episode is None:
        return choice
    rows = release.episodes[release.episodes["episode_index"] == choice.episode]
    if rows.empty:
        raise UsageError(
            f"--episode: {release.root} has the episodes 0 to {len(release.episodes) - 1}, got {choice.episode}"
        )
    row = rows.iloc[0]
    stream, first = int(row["stream"]), int(row["first_step"])
    if choice.stream not in (None, stream):
        raise UsageError(f"--stream: episode {choice.episode} belongs to stream {stream}, got {choice.stream}")
    steps = range(first, first + int(row["steps"]))
    return msgspec.structs.replace(
        choice, episode=None, stream=stream, steps=steps if choice.steps is None else overlap(steps, choice.steps)
    )


def _switch(row: Mapping[str, Any]) -> Switch:
    losses = [float(loss) for loss in row.get("world_losses", ())]
    names = ("step", "from_world", "to_world", "reason")
    return msgspec.convert({**{name: row[name] for name in names}, "world_losses": losses}, Switch)


def _segments(rows: list[dict[str, Any]], switches: list[Switch]) -> list[ShownSegment]:
    at = {item.step: item.world_losses for item in switches}

    def loss(step: int, world: int) -> float:
        losses = at.get(step, [])
        return losses[world] if world < len(losses) else math.nan

    found: list[ShownSegment] = []
    for row in sorted(rows, key=lambda row: row["segment"]):
        steps = range(row["first_step"], row["first_step"] + row["steps"])
        world = row["world"]
        entry, left = loss(steps.start, world), loss(steps.stop, world)
        found.append(ShownSegment(row["segment"], world, steps, row["ended"], entry, left))
    return found


def _episodes(release: Release, stream: int) -> list[_EpisodeRange]:
    table = release.episodes
    rows = table[table["stream"] == stream].sort_values("first_step").to_dict("records")
    found: list[_EpisodeRange] = []
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        first = row["first_step"]
        found.append(
            _EpisodeRange(
                row["segment"], row["world"], row["puzzle"], row["continued"], row["piece"] == 0,
                following is None or following["segment"] != row["segment"],
                range(first, first + row["steps"]), row["dataset_from_index"],
            )
        )  # fmt: skip
    return found


def _stream(
    release: Release,
    row: Mapping[str, Any],
    switches: list[Switch],
    segments: list[ShownSegment],
    episodes: list[_EpisodeRange],
) -> ShownStream:
    parts = tuple(name.removeprefix(PART_COLUMN) for name in release.info["features"] if name.startswith(PART_COLUMN))
    worlds = release.arrow_table("worlds").to_pylist()
    puzzles = {item["puzzle"]: Puzzle.from_json(item["json"]) for item in worlds if item["stream"] == row["stream"]}
    if strange := {episode.puzzle for episode in episodes} - puzzles.keys():
        raise KeyError(min(strange))
    begin = episodes[0].first_frame
    beginning = _series(release.numbers(begin, begin + min(PREVIEW_STEPS, len(episodes[0].steps))), parts)
    return ShownStream(
        number=row["stream"],
        steps=range(episodes[0].steps.start, episodes[-1].steps.stop),
        config=_config(row["config"]),
        worlds=sum(item["stream"] == row["stream"] for item in worlds),
        reward_parts=parts,
        switches=switches,
        segments=segments,
        known=known_of(beginning),
        spans=lambda wanted: _spans(release, episodes, puzzles, parts, wanted),
    )


def _config(text: str) -> dict[str, Any]:
    config = msgspec.json.decode(text, type=dict[str, Any])
    check_nesting(config)
    return config


def _spans(
    release: Release,
    episodes: list[_EpisodeRange],
    puzzles: Mapping[str, Puzzle],
    parts: tuple[str, ...],
    wanted: range,
) -> Iterator[Span]:
    names = tuple(release.info["gym_open"]["objects"])
    shown = {episode.segment for episode in episodes if overlap(episode.steps, wanted)}
    watch: Watch | None = None
    for episode in episodes:
        if episode.segment not in shown or episode.steps.start >= wanted.stop:
            continue
        # This also reads steps that are not wanted, because they decide what is stuck.
        for start in range(episode.steps.start, episode.steps.stop, SPAN_STEPS):
            steps = overlap(episode.steps, range(start, start + SPAN_STEPS))
            first = episode.first_frame + steps.start - episode.steps.start
            values = release.numbers(first, first + len(steps) + 1)
            states = values["observation.environment_state"].reshape(len(steps) + 1, len(names), -1)
            if watch is None or watch.segment != episode.segment:
                watch = Watch(episode.segment, position(states[0]))
            actions = values[_COLUMNS[ACTION]][:-1]
            if not ((actions >= 0) & (actions < N_ACTIONS)).all():
                raise ArtefactError(f"{release.root}: an action outside 0 to {N_ACTIONS - 1}; do not use this release")
            stuck = _watched(watch, states, actions, steps)
            if episode.ends and steps.stop == episode.steps.stop:
                stuck += watch.leave(states[-1], steps.stop)
            cut = overlap(steps, wanted)
            if not cut:
                continue
            low, high = cut.start - steps.start, cut.stop - steps.start
            yield Span(
                segment=episode.segment,
                world=episode.world,
                puzzle=puzzles[episode.puzzle],
                continued=episode.continued,
                first_step=cut.start,
                names=names,
                states=states[low : high + 1],
                series={name: found[low:high] for name, found in _series(values, parts).items()},
                pngs=_png_reader(release, first + low),
                stuck=[change for change in stuck if cut.start < change.step <= cut.stop],
                begins=cut.start == wanted.start or (episode.begins and cut.start == episode.steps.start),
            )


def _watched(watch: Watch, states: np.ndarray, actions: np.ndarray, steps: range) -> list[Stuck]:
    """Objects that got stuck or free again; `states` (T + 1, objects, 13) are before and after each action (T,)."""
    found: list[Stuck] = []
    for number in np.flatnonzero(actions).tolist():  # with action 0, no time passes
        found += watch.push(states[number + 1], steps.start + number + 1)
    return found


def _series(values: Mapping[str, np.ndarray], parts: tuple[str, ...]) -> dict[str, np.ndarray]:
    columns = {**_COLUMNS, **{PART + name: PART_COLUMN + name for name in parts}}
    left_out = np.full(len(values["action.index"]), np.nan)
    return {name: values.get(column, left_out).astype(np.float64) for name, column in columns.items()}


def _png_reader(release: Release, first: int) -> Callable[[np.ndarray], list[bytes]]:
    if release.info["features"][IMAGE]["dtype"] == "image":
        return lambda numbers: release.pngs(first + numbers)
    return lambda numbers: encode_pngs(release.images(first + numbers))
