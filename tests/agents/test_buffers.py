"""Borrowed memory is reused, but never while anything still refers to it."""

import numpy as np
import pytest
import torch

from gym_open.agents import buffers
from gym_open.agents.buffers import borrow

SHAPE = (3, 2**19)


@pytest.fixture(autouse=True)
def _none_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(buffers, "_kept", [])


def where(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_memory_is_reused_for_arrays_of_at_least_half_its_size() -> None:
    place = where(borrow(SHAPE, np.float32))
    assert where(borrow(SHAPE, np.float32)) == place
    assert where(borrow(SHAPE, np.uint16)) == place
    assert where(borrow((2**21,), np.uint8)) != place


def test_memory_is_not_reused_while_a_view_or_a_tensor_refers_to_it() -> None:
    array = borrow(SHAPE, np.float32)
    place = where(array)
    row = array[1]
    del array
    assert where(borrow(SHAPE, np.float32)) != place
    tensor = torch.from_numpy(row).view(torch.int32)[5:]
    del row
    assert where(borrow(SHAPE, np.float32)) != place
    del tensor
    assert where(borrow(SHAPE, np.float32)) == place


def test_small_and_huge_arrays_are_not_kept() -> None:
    for size in (100, 2**26):
        first, second = borrow((size,), np.float32), borrow((size,), np.float32)
        assert first.base is None
        assert second.base is None
        assert first.shape == (size,)


def test_many_at_once_are_all_different() -> None:
    arrays = [borrow(SHAPE, np.float32) for _ in range(40)]
    assert len({where(array) for array in arrays}) == 40
