"""Encoders: from observations, or from the simulator state, to features.

`Encoder` centres and scales an image and passes it through one of two networks: the paper's three-layer one (Mnih et
al. 2015), or the deeper one of IMPALA (Espeholt et al. 2018, figure 3 right, without its LSTM). `StateEncoder` passes
the simulator state on: it is the upper bound for any encoder of images.

Departure from `deepmind/scalable_agent`: IMPALA's weights are orthogonal, as in the three-layer network. The last
convolution of each residual block has a smaller gain, so that all six blocks together add about as much as they get.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from gym_open.agents import convolve
from gym_open.agents.augment import no_shifts, shift_each
from gym_open.agents.config import EncoderConfig
from gym_open.agents.symmetry import Turns, TurnsBuilder
from gym_open.agents.threads import through
from gym_open.envs.physics.model import INVENTORY
from gym_open.envs.puzzles import SIDES
from gym_open.envs.state import STATE_SIZE
from gym_open.precision import PrecisionSetting, resolve

IMAGE_SHAPE = (84, 84, 3)
"""Height, width, channels of an observation."""


def autocast(precision: PrecisionSetting, device: str = "cpu") -> torch.autocast:
    """Context in which a network on `device` computes in `precision`. Weights and losses stay fp32."""
    return torch.autocast(device, torch.bfloat16, enabled=resolve(precision, device) == "bf16")


def init_layer(layer: nn.Conv2d | nn.Linear, generator: torch.Generator, std: float = math.sqrt(2)) -> None:
    """Set orthogonal weights of gain `std`, drawn from `generator`, and zero bias, as CleanRL's `layer_init`."""
    nn.init.orthogonal_(layer.weight, std, generator=generator)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


class Convolutions(nn.Sequential):
    """The layers of `convolutions`. In fp32 on a CPU, compiled code computes the first six together."""

    def forward(self, input: Tensor) -> Tensor:  # noqa: A002  (its name in PyTorch)
        """(B, 3, 84, 84) to (B, features)."""
        layers = list(self)
        three = cast("list[nn.Conv2d]", layers[:6:2])
        if not convolve.suits(three, input):
            return super().forward(input)
        features = convolve.three_layers(input, three, getattr(layers[1], "negative_slope", 0.0))
        for layer in layers[7:]:  # after `nn.Flatten`
            features = layer(features)
        return features


def convolutions(features: int, activation: Callable[[], nn.Module], generator: torch.Generator) -> nn.Sequential:
    """The network of Mnih et al. 2015: convolutions 32 8×8/4, 64 4×4/2, 64 3×3/1, then a linear layer of `features`.

    It maps (B, 3, 84, 84) to (B, features). `activation`, `nn.ReLU` or `nn.LeakyReLU`, is between the layers and not
    after the last one.
    """
    layers = Convolutions(
        nn.Conv2d(IMAGE_SHAPE[2], 32, kernel_size=8, stride=4), activation(),
        nn.Conv2d(32, 64, kernel_size=4, stride=2), activation(),
        nn.Conv2d(64, 64, kernel_size=3, stride=1), activation(),
        nn.Flatten(),
        nn.Linear(64 * 7 * 7, features),
    )  # fmt: skip
    for layer in layers:
        if isinstance(layer, nn.Conv2d | nn.Linear):
            init_layer(layer, generator)
    return layers.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  (missing in torch's stubs)


_CHANNELS = (3, 16, 32, 32)
_BLOCKS = 2
"""Residual blocks per stage."""


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


class ImageEncoder(nn.Module, ABC):
    """Image to features.

    Attributes:
        mean_image: subtracted from each image, (3, 84, 84), in units of 0…255; zero until it is set, and always if the
            configuration says not to centre.
    """

    shape = IMAGE_SHAPE
    """Of an observation."""
    dtype = torch.uint8
    """Of an observation."""
    turns: Turns | None = None
    """What the symmetries of the table do to the features; None if that is no permutation."""
    mean_image: Tensor

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.config = config
        height, width, channels = IMAGE_SHAPE
        self.register_buffer("mean_image", torch.zeros(channels, height, width))

    def set_mean_image(self, images: Tensor) -> None:
        """Set the mean image to the mean of `images`, (N, 84, 84, 3) uint8.

        Raises:
            ValueError: if there is no image, or the shape is wrong.
        """
        check_images(images)
        if not self.config.centre:
            return
        # Sums of integers are exact, so the mean does not depend on the order in which threads add.
        mean = images.sum(dim=0, dtype=torch.int64).double() / len(images)
        self.mean_image.copy_(mean.permute(2, 0, 1))

    def prepare(self, images: Tensor) -> Tensor:
        """`prepare_shifted` without a shift."""
        return self.prepare_shifted(images, no_shifts(len(images)))

    @abstractmethod
    def prepare_shifted(self, images: Tensor, shifts: Tensor) -> Tensor:
        """Input of `forward` for images (B, 84, 84, 3) uint8, each moved by its own shift, (B, 2) int64."""

    @torch.no_grad()
    def encode(self, images: Tensor | np.ndarray) -> Tensor:
        """Features (B, `config.width`), fp32 and without gradient, of images (B, 84, 84, 3) uint8.

        A tensor must be on the encoder's device; an array is copied there.

        Raises:
            ValueError: if `images` has another shape or type.
        """
        if images.shape[1:] != IMAGE_SHAPE or images.dtype not in (torch.uint8, np.uint8):
            raise ValueError(f"images must be (B, 84, 84, 3) uint8, got {tuple(images.shape)} {images.dtype}")
        if isinstance(images, np.ndarray):  # copied, since torch takes no read-only array, nor one that runs backwards
            images = torch.from_numpy(np.array(images, order="C")).to(self.mean_image.device)
        return self(self.prepare(images)).float()


def check_images(images: Tensor) -> None:
    """Raise ValueError unless there are images, (N, 84, 84, 3) with N > 0."""
    if images.shape[1:] != IMAGE_SHAPE or len(images) == 0:
        raise ValueError(f"images must have shape (N, 84, 84, 3) with N > 0, got {tuple(images.shape)}")


class Encoder(ImageEncoder):
    """The network that `config.architecture` names, with a ReLU after the last layer too.

    Attributes:
        layers: the network itself, (B, 3, 84, 84) prepared images to (B, features).
    """

    def __init__(self, config: EncoderConfig, generator: torch.Generator) -> None:
        super().__init__(config)
        deep = config.architecture == "impala"
        layers = impala(config.features, generator) if deep else convolutions(config.features, nn.ReLU, generator)
        self.layers = layers.append(nn.ReLU())

    def prepare_shifted(self, images: Tensor, shifts: Tensor) -> Tensor:
        """Centre and scale images, `(image − mean_image) · pixel_scale / 255`, then move each by its own shift.

        Args:
            images: (B, 84, 84, 3) uint8.
            shifts: (B, 2) int64, from `augment.draw_shifts`. Zeros fill the uncovered edge.

        Returns:
            (B, 3, 84, 84) in channels-last memory order; bf16 inside `autocast("bf16")`, else float32.
        """
        scale = self.config.pixel_scale / 255
        offset = (-scale * self.mean_image).permute(1, 2, 0).contiguous()
        weight = torch.full((), scale, device=offset.device).expand(offset.shape)
        low = torch.is_autocast_enabled(images.device.type)
        return shift_each(images, shifts, weight, offset, torch.bfloat16 if low else torch.float32)

    def forward(self, prepared: Tensor) -> Tensor:
        """Features (B, features) of prepared images (B, 3, 84, 84)."""
        return through(self.layers, prepared)


class StateEncoder(nn.Module):
    """Passes the simulator state on. What a policy learns from it, its trunk learns."""

    shape = (STATE_SIZE,)
    """Shape of an input."""
    dtype = torch.float32
    """Type of an input."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.config = config
        self.turns = _turns_of_state()

    def prepare(self, states: Tensor) -> Tensor:
        """Return the states unchanged, (B, `STATE_SIZE`) float32."""
        return states

    def prepare_shifted(self, states: Tensor, shifts: Tensor) -> Tensor:  # noqa: ARG002  (there is no image)
        """Return the states unchanged: there is no image to shift."""
        return states

    def forward(self, prepared: Tensor) -> Tensor:
        """The states, (B, `STATE_SIZE`)."""
        return prepared


def _turns_of_state() -> Turns:
    """What the symmetries of the table do to a state vector, in the order of `envs.state.state_vector`."""
    builder = TurnsBuilder()
    for _ in INVENTORY:
        builder.scalars(1)
        builder.vectors(1)
        builder.scalars(2)
    builder.vectors(1)  # velocity
    builder.scalars(1)
    builder.vectors(1)
    builder.directions([(column, -row) for row, column in SIDES.values()])
    builder.scalars(1)
    builder.vectors(1)
    return builder.build()
