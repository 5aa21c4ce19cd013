"""Named random streams are repeatable and independent of one another."""

import hashlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gym_open import seeding


@given(st.integers(0, 2**63 - 1), st.text(max_size=8))
def test_same_seed_and_name_same_stream(seed: int, name: str) -> None:
    first = seeding.generator(seed, name).integers(0, 2**63, 4)
    assert (first == seeding.generator(seed, name).integers(0, 2**63, 4)).all()
    assert 0 <= seeding.integer(seed, name) < 2**63


def test_the_integer_is_the_documented_hash() -> None:
    expected = int.from_bytes(hashlib.sha256(b"7/collect/3").digest()[:8], "big") >> 1
    assert seeding.integer(7, "collect", 3) == expected


def test_names_and_seeds_give_uncorrelated_streams() -> None:
    streams = [seeding.generator(seed, name).random(4000) for seed in (0, 1) for name in ("a", "b", "ab")]
    correlation = np.abs(np.corrcoef(streams) - np.eye(len(streams)))
    assert correlation.max() < 0.07
