"""Data parallelism on the CPU: each thread takes its part of the images forward and backward through the whole network.

PyTorch itself splits every operation: its threads synchronise hundreds of times per minibatch, and spin while they
wait. If another process needs the same cores, that is many times slower than one thread. Here, threads synchronise
twice per minibatch, and sleep while they wait. Compiled code and PyTorch's operations release the interpreter lock.
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
"""Images that are worth a thread."""
_count = 1


def set_threads(count: int) -> None:
    """Set the number of threads of networks on the CPU. PyTorch's own number of threads becomes one.

    Another number of threads adds in another order, which changes the last bits.
    """
    global _count  # noqa: PLW0603  (it belongs to the process, like PyTorch's own)
    _count = count
    torch.set_num_threads(1)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """`set_threads` within this context."""
    before, torchs = _count, torch.get_num_threads()
    set_threads(count)
    try:
        yield
    finally:
        set_threads(before)
        torch.set_num_threads(torchs)


def in_parts(n: int, work: Callable[[int, int], T]) -> list[T]:
    """Results of `work(begin, end)` for each thread's part of n images, in order."""
    count = max(min(_count, n // LEAST), 1)
    edges = [round(n * part / count) for part in range(count + 1)]
    return side_by_side([partial(work, *part) for part in pairwise(edges)])


def side_by_side(works: Sequence[Callable[[], T]]) -> list[T]:
    """Results of all functions, in order. The first runs in this thread, each other one in a thread of its own."""
    first, *others = works
    if not others:
        return [first()]
    rest = [_workers(len(others)).submit(_alone, work) for work in others]
    return [first(), *(one.result() for one in rest)]


@functools.cache
def _workers(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, "images")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_workers.cache_clear)  # a forked process has no threads


def _alone(work: Callable[[], T]) -> T:
    torch.set_num_threads(1)  # each thread has its own number of PyTorch threads
    return work()


def through(network: nn.Module, prepared: Tensor) -> Tensor:
    """`network(prepared)`, (B, …). On the CPU, the images are divided among the threads."""
    if _count == 1 or len(prepared) < 2 * LEAST or prepared.device.type != "cpu" or prepared.requires_grad:
        return network(prepared)
    learned = [parameter for parameter in network.parameters() if parameter.requires_grad]
    keep = torch.is_grad_enabled() and bool(learned)
    return cast("Tensor", _Through.apply(network, prepared, keep, *learned))


class _Through(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, network: nn.Module, prepared: Tensor, keep: bool, *learned: Tensor) -> Tensor:
        """Output of the network for all parts. The graph of each part is kept for the backward pass if `keep`."""
        low, dtype = torch.is_autocast_enabled("cpu"), torch.get_autocast_dtype("cpu")

        def work(begin: int, end: int) -> Tensor:
            # Each thread has its own settings. bf16 weights in the graph of one part cannot serve another part.
            with torch.set_grad_enabled(keep), torch.autocast("cpu", dtype, enabled=low, cache_enabled=not keep):
                return network(prepared[begin:end])

        parts = in_parts(len(prepared), work)
        if keep:
            ctx.parts, ctx.learned = parts, learned
        return torch.cat([part.detach() for part in parts])

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the learned parameters: those of all parts, added in the order of the parts."""
        shares = gradients[0].split([len(part) for part in ctx.parts])
        pairs = zip(ctx.parts, shares, strict=True)
        found = side_by_side([partial(torch.autograd.grad, part, ctx.learned, share) for part, share in pairs])
        sums = list(found[0])
        for of_part in found[1:]:
            for total, gradient in zip(sums, of_part, strict=True):
                total += gradient  # noqa: PLW2901  (in place)
        return None, None, None, *sums
