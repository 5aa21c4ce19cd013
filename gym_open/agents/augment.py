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
    shifts = torch.randint(-pad, pad + 1, (len(prepared), 2), generator=generator)
    shifted = torch.zeros_like(prepared)
    for target, source, (down, right) in zip(shifted, prepared, shifts.tolist(), strict=True):
        to_rows, from_rows = _overlap(down, height)
        to_columns, from_columns = _overlap(right, width)
        target[:, to_rows, to_columns] = source[:, from_rows, from_columns]
    return shifted


def _overlap(shift: int, size: int) -> tuple[slice, slice]:
    """Where pixels land, and where they come from, when an axis of `size` moves by `shift`."""
    return slice(max(shift, 0), size + min(shift, 0)), slice(max(-shift, 0), size + min(-shift, 0))
