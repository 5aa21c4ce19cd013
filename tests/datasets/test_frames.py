"""Alignment: T actions, T + 1 frames, whatever the length."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.datasets.frames import numbers
from gym_open.datasets.statistics import Moments, PictureMoments
from gym_open.envs.puzzles.generators import sample_puzzle
from gym_open.formats.logs.schemas import Segment
from gym_open.formats.pictures import decode_png, encode_png
from gym_open.formats.releases.features import features

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
    values = numbers(segment(steps), episode=7, start=1000)
    assert {len(column) for column in values.values()} == {steps + 1}
    assert values["observation.state"][:, 0].tolist() == list(range(steps + 1))
    assert values["reward.intrinsic"].tolist() == [*range(steps), 0]
    assert values["world_model.loss"].tolist() == [*range(steps), 0]
    assert values["action.index"].tolist() == [*(i % 9 for i in range(steps)), -1]
    assert values["transition.valid"].sum() == steps
    assert values["index"].tolist() == list(range(1000, 1000 + steps + 1))


def test_without_a_world_model_there_is_no_loss_anywhere() -> None:
    """The frame without an action has none either: statistics would take a 0 for a loss."""
    nothing = msgspec.structs.replace(segment(3), world_model_loss=np.full(3, np.nan))
    assert np.isnan(numbers(nothing, episode=0, start=0)["world_model.loss"]).tolist() == [True] * 4


def test_every_feature_has_its_shape() -> None:
    described = features(NAMES)
    values = numbers(segment(4), episode=0, start=0)
    assert {"observation.image", *values} == set(described)
    for name, column in values.items():
        shape = [] if described[name]["shape"] == [1] else described[name]["shape"]
        assert list(column.shape) == [5, *shape]
        assert column.dtype == described[name]["dtype"]
    names = described["observation.environment_state"]["names"]
    assert (names[0], names[13]) == ("agent.x", "yellow_0.x")


def test_pictures_survive_to_the_bit() -> None:
    image = np.random.default_rng(1).integers(0, 256, (84, 84, 3), dtype=np.uint8)
    assert np.array_equal(decode_png(encode_png(image)), image)
    assert encode_png(image) == encode_png(image.copy())


@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.floats(-1e6, 1e6))
def test_moments_in_batches_are_numpys(sizes: list[int], shift: float) -> None:
    rng = np.random.default_rng(sum(sizes))
    batches = [rng.normal(shift, 2, size=(size, 3)) for size in sizes]
    moments = Moments(3)
    for batch in batches:
        moments.update(batch)
    everything, entry = np.concatenate(batches), moments.result()
    assert np.allclose(entry["mean"], everything.mean(axis=0), rtol=1e-12)
    assert np.allclose(entry["std"], everything.std(axis=0), rtol=1e-6, atol=1e-9)
    assert entry["min"] == everything.min(axis=0).tolist()
    assert entry["max"] == everything.max(axis=0).tolist()


def test_moments_leave_out_what_is_not_finite() -> None:
    moments = Moments(2)
    moments.update(np.array([[1.0, np.inf], [3.0, np.nan]]))
    entry = moments.result()
    assert (entry["mean"], entry["std"], entry["count"]) == ([2.0, 0.0], [1.0, 0.0], [2])
    nothing = Moments(1)
    nothing.update(np.full(3, np.nan))
    assert nothing.result() == {"min": [0.0], "max": [0.0], "mean": [0.0], "std": [0.0], "count": [0]}


@pytest.mark.parametrize("sizes", [(1,), (3, 2)])
def test_picture_moments_are_numpys(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    batches = [rng.integers(0, 200, (size, 84, 84, 3), dtype=np.uint8) for size in sizes]
    moments = PictureMoments()
    for batch in batches:
        moments.update(batch)
    values, entry = np.concatenate(batches).reshape(-1, 3) / 255, moments.result()
    for name in ("min", "max", "mean", "std"):
        assert np.allclose(np.ravel(entry[name]), getattr(np, name)(values, axis=0), rtol=1e-12)
