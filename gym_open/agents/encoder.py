"""The image encoder: centred, scaled pixels through the paper's three-layer CNN."""

import math

import torch
from torch import Tensor, nn

from gym_open.agents.augment import draw_shifts, overlap
from gym_open.agents.config import EncoderConfig, Precision

IMAGE_SHAPE = (84, 84, 3)
"""Height, width, channels of an observation."""


def autocast(precision: Precision) -> torch.autocast:
    """Context in which the network computes in `precision` (weights and losses stay fp32)."""
    return torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16")


def init_layer(layer: nn.Conv2d | nn.Linear, generator: torch.Generator, std: float = math.sqrt(2)) -> None:
    """Orthogonal weights of gain `std` and zero bias, drawn from `generator` (as CleanRL's `layer_init`)."""
    nn.init.orthogonal_(layer.weight, std, generator=generator)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


class Encoder(nn.Module):
    """Picture to features: convolutions 32 8×8/4, 64 4×4/2, 64 3×3/1, then a linear layer, each with ReLU.

    Attributes:
        mean_image: what is subtracted from a picture, (3, 84, 84), in units of 0…255; zero until it is set.
        layers: the network itself, (B, 3, 84, 84) prepared pictures to (B, features).
    """

    mean_image: Tensor

    def __init__(self, config: EncoderConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.config = config
        height, width, channels = IMAGE_SHAPE
        self.register_buffer("mean_image", torch.zeros(channels, height, width))
        self.layers = nn.Sequential(
            nn.Conv2d(channels, 32, kernel_size=8, stride=4), nn.ReLU(),
            nn.Conv2d(32, 64, kernel_size=4, stride=2), nn.ReLU(),
            nn.Conv2d(64, 64, kernel_size=3, stride=1), nn.ReLU(),
            nn.Flatten(),
            nn.Linear(64 * 7 * 7, config.features), nn.ReLU(),
        )  # fmt: skip
        for layer in self.layers:
            if isinstance(layer, nn.Conv2d | nn.Linear):
                init_layer(layer, generator)
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  (missing in torch's stubs)

    def set_mean_image(self, images: Tensor) -> None:
        """Let the mean of `images`, (N, 84, 84, 3) uint8, be what is subtracted from every picture.

        Raises:
            ValueError: if there is no image or their shape is another one.
        """
        if images.shape[1:] != IMAGE_SHAPE or len(images) == 0:
            raise ValueError(f"images must have shape (N, 84, 84, 3) with N > 0, got {tuple(images.shape)}")
        # Sums of integers are exact, so the mean does not depend on the order in which threads add.
        mean = images.sum(dim=0, dtype=torch.int64).double() / len(images)
        self.mean_image.copy_(mean.permute(2, 0, 1))

    def prepare(self, images: Tensor) -> Tensor:
        """Centre and scale pictures: `(image − mean_image) · pixel_scale / 255`.

        Args:
            images: (B, 84, 84, 3) uint8.

        Returns:
            (B, 3, 84, 84) float32 in channels-last memory order.
        """
        mean = self.mean_image.permute(1, 2, 0).contiguous()
        return torch.sub(images, mean).mul_(self.config.pixel_scale / 255).permute(0, 3, 1, 2)

    def prepare_shifted(self, images: Tensor, pad: int, generator: torch.Generator) -> Tensor:
        """`random_shift(prepare(images), pad, generator)` in one pass, a third of the time.

        Args:
            images: (B, 84, 84, 3) uint8.
            pad: largest shift in pixels.
            generator: source of the shifts.

        Returns:
            (B, 3, 84, 84) in channels-last memory order; bf16 inside `autocast("bf16")`, else float32.
        """
        height, width, _ = IMAGE_SHAPE
        scale = self.config.pixel_scale / 255
        offset = (-scale * self.mean_image).permute(1, 2, 0).contiguous()
        low = torch.is_autocast_enabled("cpu")
        shifted = torch.zeros(images.shape, dtype=torch.bfloat16 if low else torch.float32)
        for target, source, (down, right) in zip(
            shifted, images, draw_shifts(len(images), pad, generator), strict=True
        ):
            to_rows, from_rows = overlap(down, height)
            to_columns, from_columns = overlap(right, width)
            window = from_rows, from_columns
            torch.add(offset[window], source[window], alpha=scale, out=target[to_rows, to_columns])
        return shifted.permute(0, 3, 1, 2)

    def forward(self, prepared: Tensor) -> Tensor:
        """Features (B, features) of prepared pictures (B, 3, 84, 84)."""
        return self.layers(prepared)
