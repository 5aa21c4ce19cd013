"""What a policy takes over of an encoder that something else than a task has taught."""

import torch
from torch import Tensor, nn

from gym_open.agents.encoder import Encoder, init_layer
from gym_open.train.config import Transfer


def take_over(encoder: Encoder, how: Transfer, images: Tensor, generator: torch.Generator) -> None:
    """Change an encoder in place as `how` says.

    - `weights`: nothing is changed.
    - `scaled`: its last layer is multiplied by one number, so that features of `images` have the root mean square that
      an untrained encoder's have. Before a ReLU that changes the features' scale and nothing else. World models leave
      that scale free (normalised latents, a free bilinear form), and it grows to several times what the heads, the clip
      on values and the limit on the gradient's norm are made for.
    - `convolutions`: its last layer is drawn afresh, and scaled likewise, since what comes up to it has grown, too.

    Args:
        encoder: with its own mean picture.
        how: see above.
        images: of the task, (N, 84, 84, 3) uint8.
        generator: source of fresh weights.
    """
    if how == "weights":
        return
    last = _last_layer(encoder)
    if how == "convolutions":
        init_layer(last, generator)
    fresh = Encoder(encoder.config, generator)
    fresh.mean_image.copy_(encoder.mean_image)
    factor = _root_mean_square(fresh, images) / _root_mean_square(encoder, images)
    with torch.no_grad():
        for parameter in last.parameters():
            parameter.mul_(factor)


def _last_layer(encoder: Encoder) -> nn.Linear:
    return [layer for layer in encoder.layers.modules() if isinstance(layer, nn.Linear)][-1]


def _root_mean_square(encoder: Encoder, images: Tensor) -> float:
    sums = torch.stack([encoder.encode(part).double().square().mean(dim=1).sum() for part in images.split(250)])
    return float((sums.sum() / len(images)).sqrt().clamp(min=1e-12))
