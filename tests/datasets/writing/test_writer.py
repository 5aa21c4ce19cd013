"""A build that is killed goes on: finished data files stay, nothing in them is coded again, the bytes are the same."""

import json
import shutil
import signal
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.prepare import Prepared, prepare
from gym_open.datasets.writing.sources import SourceEpisode, SourceStream, episodes_of_logs, episodes_of_release
from gym_open.errors import ArtefactError
from gym_open.formats.releases.info import read_info
from tests.children import run

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
CONFIG = ReleaseConfig(data_file_mb=1, max_episode_steps=10, val_fraction=0.34)


class KilledError(Exception):
    pass


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log(lengths=((50, 35, 25), (40, 30)), keyframe_every=8)


@pytest.fixture(scope="module")
def release(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, [log], tmp_path_factory.mktemp("r") / "release").path)


def interrupted(log: Path, out: Path, after: int, config: ReleaseConfig = CONFIG) -> None:
    """Begin a build that dies as it prepares an episode."""
    prepared: list[SourceEpisode] = []

    def dies(episode: SourceEpisode, *, video: bool) -> Prepared:
        prepared.append(episode)
        if len(prepared) == after:
            raise KilledError
        return prepare(episode)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gym_open.datasets.writing.writer.prepare", dies)
        with pytest.raises(KilledError):
            build_release(config, [log], out, workers=1)
    assert not out.exists()


@pytest.mark.parametrize("after", [2, 17])
def test_an_interrupted_build_goes_on(
    after: int, log: Path, release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "release"
    interrupted(log, out, after)
    partial = tmp_path / ".release.partial"
    kept = sum(json.loads(path.read_text())[1]["episodes"] for path in partial.glob("checkpoint/parts/*.json"))
    assert bool(kept) == (after > 2)
    again: list[SourceEpisode] = []

    def counts(episode: SourceEpisode, *, video: bool) -> Prepared:
        again.append(episode)
        return prepare(episode)

    monkeypatch.setattr("gym_open.datasets.writing.writer.prepare", counts)
    assert artefacts.digest(build_release(CONFIG, [log], out).path) == release.digest
    assert len(again) == len(release.episodes) - kept


def test_what_is_damaged_of_a_finished_file_is_written_again(log: Path, release: Release, tmp_path: Path) -> None:
    out = tmp_path / "release"
    interrupted(log, out, after=17)
    mark = next((tmp_path / ".release.partial").glob("checkpoint/parts/*.json"))
    data = tmp_path / ".release.partial" / min(json.loads(mark.read_text())[1]["files"])
    data.write_bytes(data.read_bytes()[:-1] + b"?")
    assert artefacts.digest(build_release(CONFIG, [log], out).path) == release.digest


def test_a_stream_that_is_all_there_is_not_read_again(make_log: MakeLog, tmp_path: Path) -> None:
    """And the next one goes on where it ended: the first data file holds the first stream and some of the second."""
    config = ReleaseConfig(data_file_mb=1, max_episode_steps=10, val_fraction=0)
    log, out, read = make_log(lengths=((30,), (60,))), tmp_path / "release", []
    interrupted(log, out, 7, config)

    def tells(config: ReleaseConfig, streams: list[SourceStream], *rest: Any) -> Iterator[SourceEpisode]:
        read.extend(play.stream for play in streams)
        return episodes_of_logs(config, streams, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gym_open.datasets.build.episodes_of_logs", tells)
        made = open_release(build_release(config, [log], out).path)
    assert read == [1]
    assert made.episodes["stream"].tolist() == [0] * 3 + [1] * 6


def test_a_data_file_is_no_larger_than_was_asked(release: Release) -> None:
    paths = list(release.root.glob("data/*/*.parquet"))
    assert len(paths) > 3
    assert max(pq.read_table(path).nbytes for path in paths) <= 2**20


def test_killed_while_the_tables_are_written(log: Path, release: Release, tmp_path: Path) -> None:
    def killed(*_: object) -> None:
        raise KilledError

    out = tmp_path / "release"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gym_open.datasets.writing.writer.write_meta", killed)
        with pytest.raises(KilledError):
            build_release(CONFIG, [log], out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gym_open.datasets.build.episodes_of_logs", killed)  # nothing is read again
        assert artefacts.digest(build_release(CONFIG, [log], out).path) == release.digest


KILLED = """
import os, signal, sys
from pathlib import Path
from gym_open.datasets import documents
from gym_open.datasets.writing import writer
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig

prepared = []

def dies(episode, *, video):
    prepared.append(episode)
    if len(prepared) == 17:
        os.kill(os.getpid(), signal.SIGKILL)
    return prepare(episode)

prepare, writer.prepare, documents.draw = writer.prepare, dies, lambda _: {}
config = ReleaseConfig(data_file_mb=1, max_episode_steps=10, val_fraction=0.34)
build_release(config, [Path(sys.argv[1])], Path(sys.argv[2]), workers=2)
"""


@pytest.mark.slow
def test_a_killed_process_loses_nothing_that_was_finished(log: Path, release: Release, tmp_path: Path) -> None:
    script, out = tmp_path / "killed.py", tmp_path / "release"
    script.write_text(textwrap.dedent(KILLED))
    done = run([sys.executable, script, log, out])
    assert done.returncode == -signal.SIGKILL
    assert not out.exists()
    assert list((tmp_path / ".release.partial").glob("checkpoint/parts/train-000.json"))
    assert artefacts.digest(build_release(CONFIG, [log], out).path) == release.digest


def test_episodes_of_a_release_are_the_logs(release: Release, log: Path) -> None:
    from gym_open.formats.logs.reader import open_logs

    segments = {(item.stream, item.index): item for one in open_logs(log) for item in one.segments()}
    order = np.random.default_rng(0).permutation(len(release.episodes)).tolist()
    seen = []
    for number, episode in zip(order, episodes_of_release(release, order), strict=True):
        row = episode.row
        assert row == {name: release.episodes[name].iloc[number] for name in row}
        assert all(type(value) in (int, str, bool) for value in row.values())
        segment = segments[row["stream"], row["segment"]]
        first = row["first_step"] - segment.first_step
        assert np.array_equal(episode.numbers["action.index"][:-1], segment.actions[first : first + row["steps"]])
        state = segment.object_state[first : first + row["steps"] + 1].reshape(row["steps"] + 1, -1)
        assert np.array_equal(episode.numbers["observation.environment_state"], state.astype(np.float32))
        frames = range(
            release.episodes["dataset_from_index"].iloc[number], release.episodes["dataset_to_index"].iloc[number]
        )
        assert episode.pngs == release.pngs(frames)
        expected = {k.segment_step: k.integration_state for k in segment.keyframes}
        for keyframe in episode.keyframes:
            assert keyframe.segment_step == first + keyframe.frame_index
            assert np.array_equal(keyframe.integration_state, expected[keyframe.segment_step])
            seen.append((row["stream"], row["segment"], keyframe.segment_step))
    assert sorted(seen) == sorted((*key, k.segment_step) for key, item in segments.items() for k in item.keyframes)


def edit(path: Path, column: str, change: Callable[[list[Any]], list[Any]]) -> None:
    """Write a column of a parquet file anew."""
    table = pq.read_table(path)
    place, form = table.schema.get_field_index(column), table.schema.field(column)
    values = pa.array(change(table.column(column).to_pylist()), form.type)
    pq.write_table(table.set_column(place, form, values), path, compression="snappy", use_dictionary=False)


@pytest.mark.parametrize(
    ("column", "value", "what"),
    [
        ("data/chunk_index", 0, "expected the frames"),
        ("data/chunk_index", -3, "missing"),
        ("data/file_index", 999, "missing"),
        ("dataset_from_index", 0, "all of episode"),
        ("dataset_from_index", 10**6, "expected the frames"),
        ("dataset_to_index", 10**6, "expected the frames"),
    ],
)
def test_episodes_that_are_not_where_a_release_says_are_refused(
    column: str, value: int, what: str, release: Release, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(release.root, tmp_path / "release"))
    edit(root / "meta/episodes/chunk-000/file-000.parquet", column, lambda values: [*values[:-1], value])
    damaged = Release(root, "", read_info(root))
    with pytest.raises(ArtefactError, match=what):
        list(episodes_of_release(damaged, range(len(release.episodes))))


@pytest.mark.parametrize("column", ["episode_index", "action", "observation.image"])
def test_frames_of_another_episode_or_without_a_value_are_refused(
    column: str, release: Release, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(release.root, tmp_path / "release"))
    wrong = 0 if column == "episode_index" else {"bytes": None, "path": ""} if column.endswith("image") else None
    edit(max(root.glob("data/*/*.parquet")), column, lambda values: [*values[:-1], wrong])
    last = len(release.episodes) - 1
    # Before 26, pyarrow itself refuses a list of fixed size that is missing.
    with pytest.raises(ArtefactError, match=rf"all of episode {last} and whole|cannot be unpacked: .* of size=9"):
        list(episodes_of_release(Release(root, "", read_info(root)), [last]))
