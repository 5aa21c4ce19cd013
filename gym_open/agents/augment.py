"""Random shift, the one augmentation that pixels need here (Kostrikov et al. 2021, "DrQ")."""

from collections.abc import Callable

import torch
from torch import Tensor

Window = tuple[slice, slice]
"""Rows and columns of a picture."""


def draw_shifts(n: int, pad: int, generator: torch.Generator) -> Tensor:
    """Shifts (down, right) of n pictures, whole pixels, each uniform in −pad…pad; (n, 2) int64."""
    return torch.randint(-pad, pad + 1, (n, 2), generator=generator)


def no_shifts(n: int) -> Tensor:
    """Shifts that leave n pictures where they are; (n, 2) int64."""
    return torch.zeros(n, 2, dtype=torch.int64)


def shift_each(
    images: Tensor, shifts: Tensor, place: Callable[[Tensor, Window, Tensor], object], dtype: torch.dtype
) -> Tensor:
    """Turn pixels into numbers and move each picture by its own shift in one pass; what comes in is zero.

    Zero is the mean picture when `place` centres the pictures, so that the edge of the mean does not move along.

    Args:
        images: (B, H, W, C).
        shifts: (down, right) of each picture, (B, 2) int64.
        place: writes what becomes of pixels (h, w, C) that lie in a window of their picture into a tensor (h, w, C).
        dtype: of the result.

    Returns:
        (B, C, H, W) in channels-last memory order.
    """
    height, width = images.shape[1:3]
    shifted = torch.zeros(images.shape, dtype=dtype)
    for target, source, (down, right) in zip(shifted, images, shifts.tolist(), strict=True):
        to_rows, from_rows = _overlap(down, height)
        to_columns, from_columns = _overlap(right, width)
        window = from_rows, from_columns
        place(source[window], window, target[to_rows, to_columns])
    return shifted.permute(0, 3, 1, 2)


def _overlap(shift: int, size: int) -> tuple[slice, slice]:
    """Where pixels land, and where they come from, when an axis of `size` moves by `shift`."""
    return slice(max(shift, 0), size + min(shift, 0)), slice(max(-shift, 0), size + min(-shift, 0))
