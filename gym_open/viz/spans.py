"""Logs and releases as one thing to draw: streams of spans, a span being uninterrupted steps in one world."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open.envs.puzzles import Puzzle
from gym_open.formats.logs.reader import Log, open_log, open_logs
from gym_open.formats.logs.schemas import Segment, Switch
from gym_open.formats.pictures import encode_pngs
from gym_open.formats.releases import IMAGE, Release, open_release

SERIES: tuple[str, ...] = ("intrinsic_reward", "world_model_loss", "entropy", "value", "contacts", "action")
"""Numbers a step, by the names they have in a recording."""
_COLUMNS = ("reward.intrinsic", "world_model.loss", "policy.entropy", "policy.value", "contact.count", "action.index")

_PIECE = 1000
"""Steps of a log that are in memory at a time."""


class Span(msgspec.Struct, frozen=True, eq=False):
    """T steps and T + 1 states."""

    world: int
    puzzle: Puzzle
    first_step: int
    names: tuple[str, ...]
    states: np.ndarray
    """(T + 1, objects, 13)."""
    series: dict[str, np.ndarray]
    """Each of `SERIES`: (T,)."""
    pngs: Callable[[np.ndarray], list[bytes]]
    """PNG files of the observations of these numbers, 0…T."""

    @property
    def steps(self) -> int:
        """T."""
        return len(self.states) - 1


class Stream(msgspec.Struct, frozen=True, eq=False):
    """One stream of play."""

    number: int
    steps: int
    threshold: float | None
    """World-model loss under which a world is learned, if the configuration tells."""
    switches: list[Switch]
    spans: Callable[[], Iterator[Span]]

    @property
    def name(self) -> str:
        """Entity that all of the stream is under."""
        return f"stream_{self.number}"


def streams_of_log(source: Path) -> list[Stream]:
    """The streams of a log artefact, or the one of a single log file.

    Raises:
        ArtefactError: if there is no log, or one is damaged.
    """
    logs = [open_log(source)] if source.is_file() else open_logs(source)
    return [
        Stream(log.stream, log.n_steps, _threshold(log.config), log.switches, lambda log=log: _spans_of_log(log))
        for log in logs
    ]


def _spans_of_log(log: Log) -> Iterator[Span]:
    for item in log.segments(_PIECE):
        values = (
            item.intrinsic_reward,
            item.world_model_loss,
            item.policy_entropy,
            item.value,
            np.array([len(step) for step in item.contacts]),
            item.actions,
        )
        series = dict(zip(SERIES, values, strict=True))
        yield Span(
            item.world, item.puzzle, item.first_step, item.object_names, item.object_state, series, _encoder(item)
        )


def _encoder(segment: Segment) -> Callable[[np.ndarray], list[bytes]]:
    return lambda numbers: encode_pngs(segment.images[numbers])


def streams_of_release(source: Path) -> list[Stream]:
    """The streams of a release.

    Raises:
        ArtefactError: if it is missing, damaged or no release.
    """
    release = open_release(source)
    switches = release.arrow_table("switches").to_pylist()
    found = []
    for row in release.arrow_table("streams").to_pylist():
        number = row["stream"]
        own = [_switch(item) for item in switches if item["stream"] == number]
        threshold = _threshold(msgspec.json.decode(row["config"]))
        spans = _release_spans(release, number)
        found.append(Stream(number, row["steps"], threshold, own, spans))
    return found


def _switch(row: dict[str, Any]) -> Switch:
    losses = [float(loss) for loss in row["world_losses"]]
    return Switch(row["step"], row["from_world"], row["to_world"], row["reason"], losses)


def _release_spans(release: Release, number: int) -> Callable[[], Iterator[Span]]:
    names = tuple(release.info["gym_open"]["objects"])
    puzzles = {row["puzzle"]: Puzzle.from_json(row["json"]) for row in release.arrow_table("worlds").to_pylist()}

    def spans() -> Iterator[Span]:
        rows = [row for row in release.episodes.to_dict("records") if row["stream"] == number]
        for row in sorted(rows, key=lambda row: row["first_step"]):
            first, stop = row["dataset_from_index"], row["dataset_to_index"]
            values = release.numbers(first, stop)
            series = {name: values[column][:-1] for name, column in zip(SERIES, _COLUMNS, strict=True)}
            states = values["observation.environment_state"].reshape(stop - first, len(names), -1)
            yield Span(
                row["world"], puzzles[row["puzzle"]], row["first_step"], names, states, series,
                lambda numbers, first=first: _pngs(release, first + numbers),
            )  # fmt: skip

    return spans


def _pngs(release: Release, frames: np.ndarray) -> list[bytes]:
    if release.info["features"][IMAGE]["dtype"] == "image":
        return release.pngs(frames)
    return encode_pngs(release.images(frames))


def _threshold(config: dict[str, Any]) -> float | None:
    """Of a curriculum whose rule looks at it."""
    curriculum = config.get("curriculum", {})
    return float(curriculum["threshold"]) if curriculum.get("rule") == "loss" else None
