"""Pictures shared out among threads: each takes its part through the whole network, and all the way back.

PyTorch's own way splits every operation: its threads meet hundreds of times a minibatch, and spin while they wait.
Where another process needs the same cores, that is many times slower than one thread. Here they meet twice a minibatch,
and wait asleep. Compiled code and PyTorch's operations hold no interpreter lock.
"""

import functools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar, cast

import torch
from torch import Tensor, nn

T = TypeVar("T")
LEAST = 8
"""Pictures that are worth a thread."""
_count = 1


def set_threads(count: int) -> None:
    """Let networks on the CPU share their pictures out among so many threads; PyTorch's own number becomes one.

    Another number rounds sums in another order.
    """
    global _count  # noqa: PLW0603  (as PyTorch's own, it is the process's)
    _count = count
    torch.set_num_threads(1)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """`set_threads` for a while."""
    before, torchs = _count, torch.get_num_threads()
    set_threads(count)
    try:
        yield
    finally:
        set_threads(before)
        torch.set_num_threads(torchs)


def in_parts(n: int, work: Callable[[int, int], T]) -> list[T]:
    """What `work(begin, end)` gives for each thread's part of n pictures, in order."""
    count = max(min(_count, n // LEAST), 1)
    edges = [round(n * part / count) for part in range(count + 1)]
    return side_by_side([partial(work, *part) for part in pairwise(edges)])


def side_by_side(works: Sequence[Callable[[], T]]) -> list[T]:
    """What each gives, in order; the first is done here, each other one in a thread of its own."""
    first, *others = works
    if not others:
        return [first()]
    rest = [_workers(len(others)).submit(_alone, work) for work in others]
    return [first(), *(one.result() for one in rest)]


@functools.cache
def _workers(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, "pictures")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_workers.cache_clear)  # threads do not live on in a forked process


def _alone(work: Callable[[], T]) -> T:
    torch.set_num_threads(1)  # PyTorch's, of which each thread has a number of its own
    return work()


def through(network: nn.Module, prepared: Tensor) -> Tensor:
    """`network(prepared)`, (B, …), its pictures shared out among the threads if they are on the CPU."""
    if _count == 1 or len(prepared) < 2 * LEAST or prepared.device.type != "cpu" or prepared.requires_grad:
        return network(prepared)
    learned = [parameter for parameter in network.parameters() if parameter.requires_grad]
    keep = torch.is_grad_enabled() and bool(learned)
    return cast("Tensor", _Through.apply(network, prepared, keep, *learned))


class _Through(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, network: nn.Module, prepared: Tensor, keep: bool, *learned: Tensor) -> Tensor:
        """What the network makes of all parts; what leads back through each of them is kept if `keep`."""
        low, dtype = torch.is_autocast_enabled("cpu"), torch.get_autocast_dtype("cpu")

        def work(begin: int, end: int) -> Tensor:
            # Each thread has settings of its own. Weights in bf16 that one part leads back through serve no other part.
            with torch.set_grad_enabled(keep), torch.autocast("cpu", dtype, enabled=low, cache_enabled=not keep):
                return network(prepared[begin:end])

        parts = in_parts(len(prepared), work)
        if keep:
            ctx.parts, ctx.learned = parts, learned
        return torch.cat([part.detach() for part in parts])

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of what is learned: every part's own, added up in the order of parts."""
        shares = gradients[0].split([len(part) for part in ctx.parts])
        pairs = zip(ctx.parts, shares, strict=True)
        found = side_by_side([partial(torch.autograd.grad, part, ctx.learned, share) for part, share in pairs])
        sums = list(found[0])
        for of_part in found[1:]:
            for total, gradient in zip(sums, of_part, strict=True):
                total += gradient  # noqa: PLW2901  (in place)
        return None, None, None, *sums
