"""Compiled work shared out among PyTorch's number of threads; compiled code holds no interpreter lock."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

import torch

T = TypeVar("T")


def in_parts(n: int, work: Callable[[int, int], T]) -> list[T]:
    """What `work(begin, end)` gives for each thread's part of n pictures, in order."""
    count = max(min(torch.get_num_threads(), n // 4), 1)
    if count == 1:
        return [work(0, n)]
    edges = [round(n * part / count) for part in range(count + 1)]
    with ThreadPoolExecutor(count - 1) as others:
        rest = [others.submit(work, *part) for part in pairwise(edges[1:])]
        return [work(*edges[:2]), *(one.result() for one in rest)]
