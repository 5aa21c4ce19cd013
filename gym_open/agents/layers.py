"""How layers are initialised."""

import math

import torch
from torch import nn


def init_layer(layer: nn.Conv2d | nn.Linear, generator: torch.Generator, std: float = math.sqrt(2)) -> None:
    """Orthogonal weights of gain `std` and zero bias, drawn from `generator` (as CleanRL's `layer_init`)."""
    nn.init.orthogonal_(layer.weight, std, generator=generator)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
