"""Encoders that find objects: an image becomes one map per slot, and maps become features (`readout`).

Both are fitted to exploration, without a task (`objects.model`), and do not change while a policy learns:

- `SlotEncoder` groups colours. A slot is a cluster of the colours of pixels that differ from the background.
- `KeypointEncoder` learns its maps: a small convolution whose maps, each painted in one learned colour, reconstruct
  the image (after Transporter, Kulkarni et al. 2019).
"""

from abc import ABC, abstractmethod

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import IMAGE_SHAPE, ImageEncoder, check_images, init_layer
from gym_open.agents.objects.plane import CELLS, UNFITTED, plane_of
from gym_open.agents.objects.readout import read_maps, turns_of
from gym_open.agents.threads import in_parts, through
from gym_open.envs.jit import compiled

FOREGROUND = 3.5
"""A pixel belongs to an object if its scaled difference from the background, summed over channels, is larger: for
fitting colours."""
BACKGROUND = 2.0
"""A pixel belongs to the background if the square of its scaled difference is smaller: for maps."""
PIXELS, ROUNDS = 60_000, 25
"""Of k-means."""
BIAS, GAIN = 0.25, 1.4
"""A keypoint's map is `relu(softmax − its mean − BIAS) · GAIN`: what stands out of its mean."""
CHANNELS = 24
"""Of the keypoints' convolution."""
SHARPNESS = 10.0
"""Factor of the agent's logits: they learn that much faster than the rest."""


class ObjectEncoder(ImageEncoder, ABC):
    """Image to maps to features.

    Attributes:
        agent_logits: one per slot, (K,); the agent's slot has the largest.
        homography: from places in the image to places on the table (`plane`), (3, 3).
        reach: how far the agent gets from the table's middle along x and y, (2,), in moves.
    """

    homography: Tensor
    reach: Tensor

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__(config)
        self.agent_logits = nn.Parameter(torch.zeros(config.slots))
        self.register_buffer("homography", torch.tensor(UNFITTED))
        self.register_buffer("reach", torch.full((2,), CELLS / 4, dtype=torch.float64))
        self.turns = turns_of(config)

    @property
    def agent(self) -> int:
        """The agent's slot."""
        return int(self.agent_logits.argmax())

    @property
    def agent_shares(self) -> Tensor:
        """Probability of each slot to be the agent's, (K,), with gradients."""
        return (SHARPNESS * self.agent_logits).softmax(dim=0)

    def set_mean_image(self, images: Tensor) -> None:
        """Set the background to the median of `images`, (N, 84, 84, 3) uint8. The mean would show faint objects.

        Raises:
            ValueError: if there is no image or their shape is another one.
        """
        check_images(images)
        self.mean_image.copy_(images.median(dim=0).values.permute(2, 0, 1))

    @abstractmethod
    def maps(self, images: Tensor) -> Tensor:
        """Maps (B, 42, 42, K) float32 of images (B, 84, 84, 3) uint8, not negative."""

    def centred(self, images: Tensor) -> Tensor:
        """`(image − background) · pixel_scale / 255`: (B, 84, 84, 3) float32."""
        return (images.float() - self.mean_image.permute(1, 2, 0)) * (self.config.pixel_scale / 255)

    def prepare(self, images: Tensor) -> Tensor:
        """The images themselves."""
        return images

    def prepare_shifted(self, images: Tensor, shifts: Tensor) -> Tensor:  # noqa: ARG002  (features are not learned)
        """The images themselves: places must not move."""
        return images

    @torch.no_grad()
    def forward(self, prepared: Tensor) -> Tensor:
        """Features (B, width) float32 of images (B, 84, 84, 3) uint8."""
        plane = plane_of(self.homography.cpu().numpy())
        return read_maps(self.maps(prepared), self.agent, plane, self.reach.cpu().numpy(), self.config)


class SlotEncoder(ObjectEncoder):
    """Slots of colours.

    Attributes:
        colours: the middle of each slot, as a scaled difference from the background, (K, 3).
    """

    colours: Tensor

    def __init__(self, config: EncoderConfig, generator: torch.Generator) -> None:  # noqa: ARG002  (nothing is drawn)
        super().__init__(config)
        self.register_buffer("colours", torch.zeros(config.slots, IMAGE_SHAPE[2]))

    def fit_colours(self, images: Tensor, rng: np.random.Generator) -> None:
        """Group the colours of objects in `images`, (N, 84, 84, 3) uint8, by k-means++ (Arthur & Vassilvitskii 2007).

        Raises:
            ValueError: if the images show fewer pixels of objects than there are slots.
        """
        from scipy.cluster.vq import kmeans2

        pixels = torch.cat([self.object_pixels(part) for part in images.split(100)]).numpy()
        if len(pixels) < self.config.slots:
            raise ValueError(f"{len(pixels)} pixels differ from the background, expected {self.config.slots} or more")
        some = pixels[np.sort(rng.choice(len(pixels), min(len(pixels), PIXELS), replace=False))]
        found, _ = kmeans2(some, self.config.slots, iter=ROUNDS, minit="++", rng=rng)
        self.colours.copy_(torch.from_numpy(found))

    def object_pixels(self, images: Tensor) -> Tensor:
        """Scaled differences (P, 3) of the pixels that clearly differ from the background."""
        pixels = self.centred(images).flatten(0, 2)
        return pixels[pixels.abs().sum(dim=1) > FOREGROUND]

    def maps(self, images: Tensor) -> Tensor:
        """Each pixel is a quarter of a cell of the nearest slot's map, unless it belongs to the background."""
        found = np.zeros((len(images), CELLS, CELLS, self.config.slots), np.float32)
        pixels = np.ascontiguousarray(images.cpu().numpy())
        background = self.mean_image.permute(1, 2, 0).contiguous().cpu().numpy()
        colours, scale = self.colours.cpu().numpy(), np.float32(self.config.pixel_scale / 255)

        def work(begin: int, end: int) -> None:
            _nearest(pixels[begin:end], background, colours, scale, np.float32(BACKGROUND), found[begin:end])

        in_parts(len(images), work)
        return torch.from_numpy(found).to(images.device)


@compiled
def _nearest(  # noqa: PLR0917  (compiled code takes arguments by position)
    images: np.ndarray, background: np.ndarray, colours: np.ndarray, scale: np.float32, least: np.float32,
    maps: np.ndarray,
) -> None:  # fmt: skip
    """`SlotEncoder.maps` on arrays; `maps` holds zeros."""
    n, height, width, _ = images.shape
    for i in range(n):
        for y in range(height):
            for x in range(width):
                red = (np.float32(images[i, y, x, 0]) - background[y, x, 0]) * scale
                green = (np.float32(images[i, y, x, 1]) - background[y, x, 1]) * scale
                blue = (np.float32(images[i, y, x, 2]) - background[y, x, 2]) * scale
                if red * red + green * green + blue * blue < least:
                    continue
                slot, nearest = 0, np.float32(np.inf)
                for k in range(len(colours)):
                    away = (red - colours[k, 0]) ** 2 + (green - colours[k, 1]) ** 2 + (blue - colours[k, 2]) ** 2
                    if away < nearest:
                        slot, nearest = k, away
                maps[i, y // 2, x // 2, slot] += np.float32(0.25)


class KeypointEncoder(ObjectEncoder):
    """Learned maps.

    Attributes:
        layers: (B, 3, 84, 84) scaled differences to map logits (B, K, 42, 42).
        colours: in which each map is painted to reconstruct the image, (K, 3).
        mean_map: mean of each map over exploration, (K,).
    """

    mean_map: Tensor

    def __init__(self, config: EncoderConfig, generator: torch.Generator) -> None:
        super().__init__(config)
        self.layers = nn.Sequential(
            nn.Conv2d(IMAGE_SHAPE[2], CHANNELS, kernel_size=4, stride=2, padding=1), nn.ReLU(),
            nn.Conv2d(CHANNELS, CHANNELS, kernel_size=1), nn.ReLU(),
            nn.Conv2d(CHANNELS, config.slots, kernel_size=1),
        )  # fmt: skip
        for layer in self.layers:
            if isinstance(layer, nn.Conv2d):
                init_layer(layer, generator)
        self.colours = nn.Parameter(torch.randn(config.slots, IMAGE_SHAPE[2], generator=generator))
        self.register_buffer("mean_map", torch.zeros(config.slots))

    def shares(self, images: Tensor) -> Tensor:
        """Softmax over maps in each cell, (B, 42, 42, K), with gradients."""
        logits = through(self.layers, self.centred(images).permute(0, 3, 1, 2))
        return logits.float().softmax(dim=1).permute(0, 2, 3, 1)

    def reconstruction(self, shares: Tensor, images: Tensor) -> Tensor:
        """Square error, summed over channels, of the image that the maps paint; mean over cells, a scalar."""
        wanted = F.avg_pool2d(self.centred(images).permute(0, 3, 1, 2), 2).permute(0, 2, 3, 1)
        return (shares @ self.colours - wanted).square().sum(dim=3).mean()

    def standing_out(self, shares: Tensor, mean: Tensor) -> Tensor:
        """Maps of what stands out of the mean of each map."""
        return F.relu(shares - mean - BIAS) * GAIN

    def maps(self, images: Tensor) -> Tensor:
        """What stands out of each map's mean over exploration."""
        return self.standing_out(self.shares(images), self.mean_map)
