"""Logs become a release: `build_release(config, logs, out)`.

Logs are read an episode at a time, train's first, so that each split is a range of episodes as LeRobot has it.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gym_open import artefacts, progress
from gym_open.datasets.card import card
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.frames import LENGTH_CAP, encode_pngs, numbers
from gym_open.datasets.lerobot_files import DataFiles, write_episodes, write_info, write_stats, write_tasks
from gym_open.datasets.splits import Split, held_out, split_of
from gym_open.datasets.statistics import Moments, PictureMoments
from gym_open.datasets.tables import segment_row, write_tables
from gym_open.errors import ArtefactError
from gym_open.formats.pictures import workers
from gym_open.formats.releases.features import Features, features
from gym_open.formats.releases.layout import IMAGE

if TYPE_CHECKING:
    from gym_open.formats.logs.reader import Log
    from gym_open.formats.logs.schemas import Segment

SPLITS: tuple[Split, ...] = ("train", "val")


def build_release(config: ReleaseConfig, logs: Path, out: Path) -> artefacts.Outcome:
    """Build the release `out` from the log artefact `logs`.

    The same logs and configuration give the same bytes in any folder, with any number of threads.

    Args:
        config: all that decides the release.
        logs: folder of a log artefact.
        out: folder of the release.

    Raises:
        ArtefactError: if a log is missing, damaged, empty, or not of free play in the sandbox (naming the file); no
            release is left behind.
    """
    from gym_open.formats.logs.reader import open_logs

    def work(folder: Path) -> Mapping[str, Any]:
        if (kind := artefacts.lineage(logs).kind) != "log":
            raise ArtefactError(
                f"{logs}: expected an artefact of kind 'log', got {kind!r}; give one of `gym-open collect`"
            )
        for item in folder.iterdir():  # what an interrupted build left: begin again
            if item.name != artefacts.SCRATCH:
                shutil.rmtree(item) if item.is_dir() else item.unlink()
        return write_release(config, [_task_free(log) for log in open_logs(logs)], folder)

    return artefacts.build(out, kind="release", config=config, parents=[logs], work=work)


def _task_free(log: "Log") -> "Log":
    """The log, if it was played without a task: what a person played on test puzzles must never train an encoder."""
    if tasks := {puzzle.task for puzzle in log.puzzles} - {"sandbox"}:
        raise ArtefactError(
            f"{log.path}: holds puzzles of {', '.join(sorted(tasks))}; a release is made of play in the sandbox alone"
        )
    return log


def write_release(config: ReleaseConfig, logs: "Sequence[Log]", folder: Path) -> dict[str, int]:
    """Write a release's payload into `folder` and return its facts: frames, episodes, steps.

    Raises:
        ArtefactError: if the logs hold no segment.
    """
    val = held_out(config, logs)
    with ThreadPoolExecutor(workers()) as pool, progress.bar("dataset build", sum(log.n_steps for log in logs)) as bar:
        writer: _Writer | None = None
        for split in SPLITS:
            for segment in _segments(config, logs, val, split):
                writer = writer or _Writer(folder, config, features(segment.object_names), pool)
                writer.add(segment, split)
                bar.advance(len(segment.actions))
        if writer is None:
            places = ", ".join(str(log.path) for log in logs) or "no log file"
            raise ArtefactError(f"{places}: no segment to make a release of; collect some steps first")
        writer.close()
    ours = {
        "name": config.name,
        "split_by": config.split_by,
        "val": sorted(val),
        "max_episode_steps": config.max_episode_steps,
        "objects": list(writer.objects),
    }
    facts = writer.finish(ours)
    write_tables(folder, config, logs, val, writer.segments)
    (folder / "README.md").write_text(card(config, facts, writer.episodes, writer.described), encoding="utf-8")
    return facts


def _segments(config: ReleaseConfig, logs: "Sequence[Log]", val: frozenset[str], split: Split) -> "Iterator[Segment]":
    """Segments of a split, in pieces of an episode's length."""
    for log in logs:
        visited = [log.puzzles[switch.to_world].digest for switch in log.switches if switch.to_world >= 0]
        if all(split_of(config, log.stream, puzzle, val) != split for puzzle in visited):
            continue  # spares reading the whole log again
        for segment in log.segments(config.max_episode_steps):
            if split_of(config, log.stream, segment.puzzle.digest, val) == split:
                yield segment


class _Writer:
    """Counts frames and episodes while the files grow."""

    def __init__(self, folder: Path, config: ReleaseConfig, described: Features, pool: Executor) -> None:
        self.described = described
        self.episodes: list[dict[str, Any]] = []
        self.segments: list[dict[str, Any]] = []
        self.objects: tuple[str, ...] = ()
        self._folder, self._config, self._pool = folder, config, pool
        self._files = DataFiles(folder, described, config.data_file_mb * 2**20)
        self._moments = {name: Moments(item["shape"][0]) for name, item in described.items() if name != IMAGE}
        self._pictures = PictureMoments()
        self._frames = 0

    def add(self, segment: "Segment", split: Split) -> None:
        """Add a segment, or the next piece of one, as an episode."""
        self.objects = self.objects or segment.object_names
        if segment.object_names != self.objects:
            raise ArtefactError(
                f"stream {segment.stream}, segment {segment.index}: objects {segment.object_names}, other segments "
                f"have {self.objects}; logs of different models do not go into one release"
            )
        if segment.segment_step == 0:
            self.segments.append(segment_row(segment))
        steps, images = len(segment.actions), segment.images
        self.segments[-1].update(steps=segment.segment_step + steps, ended=segment.ended)
        values = numbers(segment, episode=len(self.episodes), start=self._frames)
        for name, moments in self._moments.items():
            moments.update(values[name])
        self._pictures.update(images)
        chunk, file = self._files.add(values, encode_pngs(images, self._pool))
        self.episodes.append(
            {
                "episode_index": len(self.episodes),
                "length": len(images),
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + len(images),
                "data/chunk_index": chunk,
                "data/file_index": file,
                "stream": segment.stream,
                "segment": segment.index,
                "piece": segment.segment_step // self._config.max_episode_steps,
                "world": segment.world,
                "puzzle": segment.puzzle.digest,
                "first_step": segment.first_step,
                "steps": steps,
                "continued": segment.continued or segment.segment_step > 0,
                "ended": segment.ended or LENGTH_CAP,
                "split": split,
            }
        )
        self._frames += len(images)

    def close(self) -> None:
        """Finish the data files."""
        self._files.close()

    def finish(self, ours: dict[str, Any]) -> dict[str, int]:
        """Write LeRobot's records of what was added."""
        train = sum(row["split"] == "train" for row in self.episodes)
        count = len(self.episodes)
        splits = {"train": f"0:{train}"} | ({"val": f"{train}:{count}"} if train < count else {})
        write_info(
            self._folder, self.described, episodes=count, frames=self._frames, splits=splits,
            data_file_mb=self._config.data_file_mb, ours=ours,
        )  # fmt: skip
        stats = {name: moments.result() for name, moments in self._moments.items()}
        write_stats({**stats, IMAGE: self._pictures.result()}, self._folder)
        write_tasks(self._folder)
        write_episodes(self.episodes, self._folder)
        return {"frames": self._frames, "episodes": count, "steps": sum(row["steps"] for row in self.episodes)}
