"""Random shift, the one augmentation that pixels need here (Kostrikov et al. 2021, "DrQ")."""

import torch
from torch import Tensor


def random_shift(prepared: Tensor, pad: int, generator: torch.Generator) -> Tensor:
    """Move each picture by its own whole number of pixels, −pad…pad on each axis; what comes in is zero.

    Zero is the mean picture when the pictures are centred already, so shift after centring.

    Args:
        prepared: (B, C, H, W).
        pad: largest shift, at least 0.
        generator: source of the shifts.

    Returns:
        (B, C, H, W), in the memory order of `prepared`.
    """
    if pad == 0:
        return prepared
    height, width = prepared.shape[-2:]
    shifted = torch.zeros_like(prepared)
    for target, source, (down, right) in zip(
        shifted, prepared, draw_shifts(len(prepared), pad, generator), strict=True
    ):
        to_rows, from_rows = overlap(down, height)
        to_columns, from_columns = overlap(right, width)
        target[:, to_rows, to_columns] = source[:, from_rows, from_columns]
    return shifted


def draw_shifts(n: int, pad: int, generator: torch.Generator) -> list[list[int]]:
    """Shifts (down, right) of n pictures, each uniform in −pad…pad."""
    return torch.randint(-pad, pad + 1, (n, 2), generator=generator).tolist()


def overlap(shift: int, size: int) -> tuple[slice, slice]:
    """Where pixels land, and where they come from, when an axis of `size` moves by `shift`."""
    return slice(max(shift, 0), size + min(shift, 0)), slice(max(-shift, 0), size + min(-shift, 0))
