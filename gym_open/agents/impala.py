"""The deeper network of IMPALA (Espeholt et al. 2018, figure 3 right, without its LSTM).

Departure from `deepmind/scalable_agent`: weights are orthogonal, as in the three-layer network, with a smaller gain in
the last convolution of each residual block, so that all six blocks together add as much as they are given.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from gym_open.agents.layers import init_layer

_CHANNELS = (3, 16, 32, 32)
_BLOCKS = 2
"""Residual blocks a stage."""


class _Residual(nn.Module):
    """`x + conv(relu(conv(relu(x))))`."""

    def __init__(self, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, kernel_size=3, padding=1)
        self.last = nn.Conv2d(channels, channels, kernel_size=3, padding=1)
        init_layer(self.first, generator)
        init_layer(self.last, generator, std=math.sqrt(2 / (_BLOCKS * (len(_CHANNELS) - 1))))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.last(self.first(x.relu()).relu())


def impala(features: int, generator: torch.Generator) -> nn.Sequential:
    """Three stages of 16, 32 and 32 channels, then a linear layer of `features`.

    A stage is a 3×3 convolution, a 3×3 max-pool of stride 2 and two residual blocks. It maps (B, 3, 84, 84) to
    (B, features), with a ReLU before the linear layer and none after it.
    """
    layers = nn.Sequential()
    for inputs, outputs in pairwise(_CHANNELS):
        first = nn.Conv2d(inputs, outputs, kernel_size=3, padding=1)
        init_layer(first, generator, std=1.0)  # no ReLU before it
        layers.extend([first, nn.MaxPool2d(kernel_size=3, stride=2, padding=1)])
        layers.extend(_Residual(outputs, generator) for _ in range(_BLOCKS))
    linear = nn.Linear(_CHANNELS[-1] * 11 * 11, features)  # 84 halved three times, rounded up
    init_layer(linear, generator)
    layers.extend([nn.ReLU(), nn.Flatten(), linear])
    return layers.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  (missing in torch's stubs)
