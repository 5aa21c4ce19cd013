"""Random shift, the one augmentation that pixels need here (Kostrikov et al. 2021, "DrQ")."""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gym_open.envs.jit import compiled


def draw_shifts(n: int, pad: int, generator: torch.Generator) -> Tensor:
    """Shifts (down, right) of n pictures, whole pixels, each uniform in −pad…pad; (n, 2) int64."""
    return torch.randint(-pad, pad + 1, (n, 2), generator=generator)


def no_shifts(n: int) -> Tensor:
    """Shifts that leave n pictures where they are; (n, 2) int64."""
    return torch.zeros(n, 2, dtype=torch.int64)


def shift_each(images: Tensor, shifts: Tensor, weight: Tensor, offset: Tensor, dtype: torch.dtype) -> Tensor:
    """Turn pixels into numbers, `weight · pixel + offset`, and move each picture by its own shift; zero comes in.

    Zero is the mean picture when that is what `offset` subtracts, so that the edge of the mean does not move along.
    One compiled pass on a CPU, which is several times faster than PyTorch's own operations there.

    Args:
        images: (B, H, W, C) uint8.
        shifts: (down, right) of each picture, (B, 2) int64.
        weight: of each pixel, (H, W, C) float32.
        offset: likewise.
        dtype: of the result, float32 or bfloat16.

    Returns:
        (B, C, H, W) in channels-last memory order.
    """
    if images.is_cuda:
        return _shift_each_cuda(images, shifts, weight, offset).to(dtype)
    shape, low = images.shape, dtype == torch.bfloat16
    out = torch.empty(shape, dtype=dtype)
    bits = out.view(torch.uint16).numpy() if low else out.view(torch.uint32).numpy()
    rows = shape[2] * shape[3]
    _place(
        images.contiguous().numpy().reshape(shape[0], shape[1], rows), shifts.numpy(),
        weight.expand(shape[1:]).reshape(shape[1], rows).numpy(), offset.reshape(shape[1], rows).contiguous().numpy(),
        shape[3], bits.reshape(shape[0], shape[1], rows), low,
    )  # fmt: skip
    return out.permute(0, 3, 1, 2)


@compiled
def _place(  # noqa: PLR0917  # compiled code takes arguments by position
    images: np.ndarray,
    shifts: np.ndarray,
    weight: np.ndarray,
    offset: np.ndarray,
    channels: int,
    out: np.ndarray,
    low: bool,
) -> None:
    """`shift_each` on rows (…, H, W · C); `out` takes the bits of float32, or of bfloat16 if `low`."""
    n, height, width = images.shape
    line = np.zeros(width, np.float32)
    bits = line.view(np.uint32)
    for i in range(n):
        down, right = shifts[i, 0], shifts[i, 1] * channels
        first, last = max(right, 0), max(width + min(right, 0), 0)
        for row in range(height):
            source = row - down
            line[:] = 0
            if 0 <= source < height:
                # Slices, so that no index may be negative: else the loop takes one number at a time.
                pixels = images[i, source, first - right : last - right]
                w, o = weight[source, first - right : last - right], offset[source, first - right : last - right]
                moved = line[first:last]
                for k in range(len(moved)):
                    moved[k] = w[k] * pixels[k] + o[k]
            to = out[i, row]
            if low:  # rounded to even, as PyTorch does
                for k in range(width):
                    to[k] = (bits[k] + np.uint32(0x7FFF) + ((bits[k] >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)
            else:
                for k in range(width):
                    to[k] = bits[k]


def _shift_each_cuda(images: Tensor, shifts: Tensor, weight: Tensor, offset: Tensor) -> Tensor:
    """`shift_each` in PyTorch's operations: pictures within a margin of zeros are looked at through moved windows."""
    n, height, width, channels = images.shape
    pad = int(shifts.abs().max()) if n else 0
    numbers = torch.addcmul(offset, images.float(), weight)
    margin = F.pad(numbers, (0, 0, pad, pad, pad, pad))
    moved = pad - shifts.to(images.device)
    rows = moved[:, :1] + torch.arange(height, device=images.device)
    columns = moved[:, 1:] + torch.arange(width, device=images.device)
    every = torch.arange(n, device=images.device)[:, None, None]
    return margin[every, rows[:, :, None], columns[:, None, :]].view(n, height, width, channels).permute(0, 3, 1, 2)
