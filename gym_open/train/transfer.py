"""Prepare an encoder that was learned without a task, so that a policy can start from it."""

import torch
from torch import Tensor, nn

from gym_open.agents.encoder import Encoder, init_layer
from gym_open.train.config import Transfer


def take_over(encoder: Encoder, how: Transfer, images: Tensor, generator: torch.Generator) -> None:
    """Change an encoder in place, as `how` says.

    - `weights`: nothing changes.
    - `scaled`: its last layer is multiplied by one number, so that features of `images` have the same root mean square
      as those of an untrained encoder. Before a ReLU this changes only the scale of the features. World models
      leave that scale free (normalised latents, a free bilinear form). It grows to several times the scale for which
      the heads, the clipping of values and the limit on the gradient norm are made.
    - `convolutions`: its last layer is drawn anew and scaled in the same way, since its inputs have grown too.

    Args:
        encoder: an encoder with its own mean image.
        how: see above.
        images: images of the task, (N, 84, 84, 3) uint8.
        generator: source of new weights.
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
