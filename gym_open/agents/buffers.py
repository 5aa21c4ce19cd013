"""Memory for what every minibatch needs anew, used again and again.

The system hands out memory page by page and fills it with zeros. For arrays of many megabytes, filled and freed at
every minibatch, that takes a tenth of the time of an update.
"""

import math
import sys
import threading

import numpy as np

_SMALLEST, _LARGEST = 2**20, 2**26
"""Bytes of the arrays that are kept: less is cheap to have anew, more should not be held on to."""
_MOST = 16
"""Arrays that are kept."""
_kept: list[np.ndarray] = []
_lock = threading.Lock()


def borrow(shape: tuple[int, ...], dtype: type[np.generic]) -> np.ndarray:
    """An array of any content. Its memory is used again once nothing refers to the array, nor to a view of it."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if not _SMALLEST <= size <= _LARGEST:
        return np.empty(shape, dtype)
    with _lock:
        free = [one for one, count in enumerate(_references(_kept)) if count == _ALONE]
        fitting = [one for one in free if size <= len(_kept[one]) <= 2 * size]
        if fitting:
            memory = _kept[min(fitting, key=lambda one: len(_kept[one]))]
        else:
            memory = np.empty(size, np.uint8)
            _kept.append(memory)
            del _kept[:-_MOST]
        return memory[:size].view(dtype).reshape(shape)


def _references(arrays: list[np.ndarray]) -> list[int]:
    return [sys.getrefcount(one) for one in arrays]


_ALONE = _references([np.empty(1)])[0]
"""What is counted of an array that nobody but the list refers to."""
