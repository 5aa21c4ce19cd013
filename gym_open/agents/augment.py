"""Random shift, the only augmentation of images here (Kostrikov et al. 2021, "DrQ")."""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gym_open.agents.buffers import borrow
from gym_open.agents.threads import in_parts
from gym_open.envs.jit import compiled


def draw_shifts(n: int, pad: int, generator: torch.Generator) -> Tensor:
    """Draw shifts (down, right) of n images in whole pixels, uniform in −pad…pad; (n, 2) int64."""
    return torch.randint(-pad, pad + 1, (n, 2), generator=generator)


def no_shifts(n: int) -> Tensor:
    """Shifts of zero for n images; (n, 2) int64."""
    return torch.zeros(n, 2, dtype=torch.int64)


def shift_each(images: Tensor, shifts: Tensor, weight: Tensor, offset: Tensor, dtype: torch.dtype) -> Tensor:
    """Turn pixels into numbers, `weight · pixel + offset`, and move each image by its own shift, zeros at the edge.

    If `offset` subtracts the mean image, zero stands for the mean image: the edge of the mean does not move.
    On a CPU this is one compiled pass, which is several times faster than PyTorch's own operations.

    Args:
        images: (B, H, W, C) uint8.
        shifts: (down, right) of each image, (B, 2) int64.
        weight: factor of each pixel, (H, W, C) float32.
        offset: offset of each pixel, (H, W, C) float32.
        dtype: type of the result, float32 or bfloat16.

    Returns:
        The numbers, (B, C, H, W) in channels-last memory order.
    """
    if images.is_cuda:
        return _shift_each_cuda(images, shifts, weight, offset).to(dtype)
    (n, height, width, channels), low = images.shape, dtype == torch.bfloat16
    rows = width * channels
    out = borrow((n, height, rows), np.uint16 if low else np.uint32)
    pixels, moves = images.contiguous().numpy().reshape(n, height, rows), shifts.numpy()
    weights = weight.expand(images.shape[1:]).reshape(height, rows).numpy()
    offsets = offset.reshape(height, rows).contiguous().numpy()

    def work(begin: int, end: int) -> None:
        _place(pixels[begin:end], moves[begin:end], weights, offsets, channels, out[begin:end], low)

    in_parts(n, work)
    return torch.from_numpy(out).view(dtype).view(images.shape).permute(0, 3, 1, 2)


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
    """`shift_each` on rows (…, H, W · C). `out` gets the bits of float32, or of bfloat16 if `low`."""
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
                # With slices, no index can be negative; otherwise the loop is not vectorised.
                pixels = images[i, source, first - right : last - right]
                w, o = weight[source, first - right : last - right], offset[source, first - right : last - right]
                moved = line[first:last]
                for k in range(len(moved)):
                    moved[k] = w[k] * pixels[k] + o[k]
            to = out[i, row]
            if low:  # rounded to even, as in PyTorch
                for k in range(width):
                    to[k] = (bits[k] + np.uint32(0x7FFF) + ((bits[k] >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)
            else:
                for k in range(width):
                    to[k] = bits[k]


def _shift_each_cuda(images: Tensor, shifts: Tensor, weight: Tensor, offset: Tensor) -> Tensor:
    """`shift_each` in PyTorch's operations: it reads moved windows of images that are padded with zeros."""
    n, height, width, channels = images.shape
    pad = int(shifts.abs().max()) if n else 0
    numbers = torch.addcmul(offset, images.float(), weight)
    margin = F.pad(numbers, (0, 0, pad, pad, pad, pad))
    moved = pad - shifts.to(images.device)
    rows = moved[:, :1] + torch.arange(height, device=images.device)
    columns = moved[:, 1:] + torch.arange(width, device=images.device)
    every = torch.arange(n, device=images.device)[:, None, None]
    return margin[every, rows[:, :, None], columns[:, None, :]].view(n, height, width, channels).permute(0, 3, 1, 2)
