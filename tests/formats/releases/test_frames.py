"""Alignment: T actions, T + 1 frames, whatever the length."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.datasets.writing.statistics import Merger, Stats, feature_stats, image_stats
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.formats.logs.schemas import Segment
from gym_open.formats.pngs import decode_png, encode_pngs
from gym_open.formats.releases.features import features
from gym_open.formats.releases.frames import numbers

NAMES = ("agent", "yellow_0")
PUZZLE = sample_puzzle("sandbox", np.random.default_rng(0))


def segment(steps: int) -> Segment:
    """Every figure tells its own step, so that a shift by one shows."""
    row = np.arange(steps, dtype=np.float64)
    return Segment(
        stream=0, index=0, world=0, puzzle=PUZZLE, continued=False, first_step=100, segment_step=0, object_names=NAMES,
        integration_state=np.zeros(3), keyframes=[], depth=None, segmentation=None, reward_parts={},
        images=np.broadcast_to(np.arange(steps + 1, dtype=np.uint8)[:, None, None, None], (steps + 1, 84, 84, 3)),
        actions=np.arange(steps) % 9, contacts=[()] * steps,
        object_state=np.broadcast_to(np.arange(steps + 1.0)[:, None, None], (steps + 1, 2, 13)),
        intrinsic_reward=row, world_model_loss=row, policy_entropy=row, value=row, ended="budget",
    )  # fmt: skip


@given(steps=st.integers(0, 60))
def test_alignment(steps: int) -> None:
    values = numbers(segment(steps))
    assert {len(column) for column in values.values()} == {steps + 1}
    assert values["observation.state"][:, 0].tolist() == list(range(steps + 1))
    assert values["reward.intrinsic"].tolist() == [*range(steps), 0]
    assert values["world_model.loss"].tolist() == [*range(steps), 0]
    assert values["action.index"].tolist() == [*(i % 9 for i in range(steps)), -1]
    assert values["transition.valid"].sum() == steps
    assert values["frame_index"].tolist() == list(range(steps + 1))


def test_without_a_world_model_there_is_no_loss_anywhere() -> None:
    """The frame without an action has none either: statistics would take a 0 for a loss."""
    nothing = msgspec.structs.replace(segment(3), world_model_loss=np.full(3, np.nan))
    assert np.isnan(numbers(nothing)["world_model.loss"]).tolist() == [True] * 4


def test_every_feature_has_its_shape() -> None:
    described = features(NAMES, ("novelty",))
    values = numbers(segment(4), ("novelty",))
    assert {"observation.image", "index", "episode_index", "task_index", *values} == set(described)
    for name, column in values.items():
        shape = [] if described[name]["shape"] == [1] else described[name]["shape"]
        assert list(column.shape) == [5, *shape]
        assert column.dtype == described[name]["dtype"]
    names = described["observation.environment_state"]["names"]
    assert (names[0], names[13]) == ("agent.x", "yellow_0.x")


def test_pictures_survive_to_the_bit() -> None:
    image = np.random.default_rng(1).integers(0, 256, (84, 84, 3), dtype=np.uint8)
    assert np.array_equal(decode_png(encode_pngs(image[None])[0]), image)
    assert encode_pngs(image[None])[0] == encode_pngs(image.copy()[None])[0]


def test_a_png_is_the_same_whatever_was_coded_before() -> None:
    images = np.random.default_rng(1).integers(0, 256, (3, 84, 84, 3), dtype=np.uint8)
    assert encode_pngs(images) == [encode_pngs(image[None])[0] for image in images]
    assert encode_pngs(images[:0]) == []


def stats_of(batches: list[np.ndarray]) -> Stats:
    merger = Merger()
    for batch in batches:
        merger.add(feature_stats(batch))
    return merger.result()


@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.floats(-1e6, 1e6))
def test_merged_statistics_are_numpys(sizes: list[int], shift: float) -> None:
    rng = np.random.default_rng(sum(sizes))
    batches = [rng.normal(shift, 2, size=(size, 3)) for size in sizes]
    everything, entry = np.concatenate(batches), stats_of(batches)
    assert np.allclose(entry.mean, everything.mean(axis=0), rtol=1e-12)
    assert np.allclose(entry.std, everything.std(axis=0), rtol=1e-6, atol=1e-9)
    assert np.array_equal(entry.min, everything.min(axis=0))
    assert np.array_equal(entry.max, everything.max(axis=0))
    assert entry.count == len(everything)


def test_statistics_leave_out_what_is_not_finite() -> None:
    values = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 4.0], [np.inf, 0.0]])
    entry = feature_stats(values)
    assert (entry.mean.tolist(), entry.std.tolist(), entry.count) == ([3.0, 3.0], [2.0, 1.0], 2)
    nothing = feature_stats(np.full(3, np.nan))
    assert nothing.plain() == {"min": [0.0], "max": [0.0], "mean": [0.0], "std": [0.0], "count": [0]}
    ones = np.ones(2)
    assert stats_of([np.full(3, np.nan), ones, np.full(1, np.inf)]).plain() == feature_stats(ones).plain()


@pytest.mark.parametrize("sizes", [(1,), (3, 2)])
def test_picture_statistics_are_numpys(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    batches = [rng.integers(0, 200, (size, 84, 84, 3), dtype=np.uint8) for size in sizes]
    merger = Merger()
    for batch in batches:
        merger.add(image_stats(batch))
    values, entry = np.concatenate(batches).reshape(-1, 3) / 255, merger.result()
    for name in ("min", "max", "mean", "std"):
        assert np.allclose(np.ravel(getattr(entry, name)), getattr(np, name)(values, axis=0), rtol=1e-12)
    assert entry.count == sum(sizes)
