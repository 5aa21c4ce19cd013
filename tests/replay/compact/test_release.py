"""A compact release is read like the release that was packed."""

from pathlib import Path

import numpy as np
import pytest
from pandas.testing import assert_frame_equal

from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.content import table_digest
from gym_open.formats.releases.layout import TABLES
from gym_open.formats.windows import Pictures, Windows
from gym_open.replay.compact import open_dataset
from gym_open.replay.compact.release import CompactRelease
from tests.datasets.compact.conftest import learned_log, packed, random_log, release  # noqa: F401  # fixtures

FILES = {"data/chunk_index", "data/file_index", "meta/episodes/chunk_index", "tasks"}
"""Columns about the release's files, which a compact release does not have."""


@pytest.fixture(scope="module")
def pair(release: Path, packed: Path) -> tuple[Release, Release]:  # noqa: F811
    one, other = open_dataset(release), open_dataset(packed)
    assert isinstance(other, CompactRelease)
    assert not isinstance(one, CompactRelease)
    return one, other


def test_tables_and_frames_are_equal(pair: tuple[Release, Release]) -> None:
    one, other = pair
    assert (len(one), one.info, one.name, one.version) == (len(other), other.info, other.name, other.version)
    columns = [name for name in one.episodes if name not in FILES]
    assert_frame_equal(one.episodes[columns], other.episodes[columns], check_dtype=False)
    assert_frame_equal(one.frames, other.frames[list(one.frames)])
    for name in TABLES:
        assert table_digest(one.arrow_table(name)) == table_digest(other.arrow_table(name)), name


@pytest.mark.parametrize("name", ["action.index", "reward.intrinsic", "observation.environment_state", "index"])
def test_columns_are_equal(pair: tuple[Release, Release], name: str) -> None:
    one, other = (opened.column(name) for opened in pair)
    assert (one.dtype, one.tobytes()) == (other.dtype, other.tobytes())


def test_images_and_numbers_are_equal_in_any_order(pair: tuple[Release, Release]) -> None:
    one, other = pair
    wanted = np.random.default_rng(0).permutation(len(one))[:60]
    assert np.array_equal(one.images(wanted), other.images(wanted))
    assert one.pngs(wanted[:3]) == other.pngs(wanted[:3])
    for first, stop in ((0, 1), (5, 40), (len(one) - 3, len(one))):
        mine, theirs = one.numbers(first, stop), other.numbers(first, stop)
        assert mine.keys() == theirs.keys()
        assert all(mine[name].tobytes() == theirs[name].tobytes() for name in mine)
    for a, b in zip(one.iterate_episodes([7, 2]), other.iterate_episodes([7, 2]), strict=True):
        assert np.array_equal(a.observations, b.observations)
        assert np.array_equal(a.actions, b.actions)
    assert np.array_equal(one.split("val"), other.split("val"))


def test_what_is_not_there_is_refused_alike(pair: tuple[Release, Release]) -> None:
    for one in pair:
        with pytest.raises(IndexError):
            one.images([len(one)])
        with pytest.raises(IndexError):
            one.numbers(3, 3)
        with pytest.raises(KeyError):
            one.column("nothing")


def test_windows_are_equal_and_other_processes_open_them(pair: tuple[Release, Release], tmp_path: Path) -> None:
    import pickle

    pictures = [Pictures(one, cache=tmp_path) for one in pair]
    numbers = np.arange(9)
    mine, theirs = (Windows(one, "train", 4).fetch(numbers) for one in pictures)
    assert all(np.array_equal(mine[name], theirs[name]) for name in mine)
    again = pickle.loads(pickle.dumps(pictures[1]))
    assert isinstance(again.release, CompactRelease)
    assert np.array_equal(again.take(numbers), pictures[0].take(numbers))


def test_a_command_for_releases_alone_says_what_to_do(packed: Path) -> None:  # noqa: F811
    with pytest.raises(ArtefactError, match="gym-open dataset restore"):
        open_release(packed)
