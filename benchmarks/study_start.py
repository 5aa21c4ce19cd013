"""Do PPO's first updates destroy what an encoder has learned? `train policy` from an encoder, with a gentler start.

    .venv/bin/python benchmarks/study_start.py --encoder /tmp/told/cells-5000 --critic-gain 0.01 --balanced --out /tmp/g
    .venv/bin/python benchmarks/study_features.py /tmp/g

`--critic-gain` is the gain of the value head's initial weights (1 in `train policy`, as in CleanRL). `--balanced`
scales every layer of the encoder, not only the last one, so that its outputs are as large as an untrained encoder's.
Because of the ReLUs, this changes all features by one factor. The policy is like any other, but its configuration does
not record these options: mention them next to its scores.
"""

import argparse
from pathlib import Path
from unittest.mock import patch

import msgspec
import torch
from torch import Tensor, nn

from gym_open.agents.encoder import Encoder, init_layer
from gym_open.config import load
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import train_policy

PICTURES = 250


@torch.no_grad()
def sizes(encoder: Encoder, images: Tensor) -> list[float]:
    """Root mean square of each layer's outputs, after its ReLU."""
    found, x = [], encoder.prepare(images[:PICTURES])
    for layer in encoder.layers:
        x = layer(x)
        if isinstance(layer, nn.ReLU):
            found.append(float(x.square().mean().sqrt()))
    return found


@torch.no_grad()
def balance(encoder: Encoder, _how: str, images: Tensor, generator: torch.Generator) -> None:
    """Scale each layer to the output size of an untrained encoder. It replaces `take_over`."""
    fresh = Encoder(encoder.config, generator)
    fresh.mean_image.copy_(encoder.mean_image)
    learned = [layer for layer in encoder.layers if isinstance(layer, nn.Conv2d | nn.Linear)]
    before = 1.0
    for layer, have, want in zip(learned, sizes(encoder, images), sizes(fresh, images), strict=True):
        factor = want / have
        layer.weight.mul_(factor / before)
        if layer.bias is not None:
            layer.bias.mul_(factor)
        before = factor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encoder", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--critic-gain", type=float, default=1.0)
    parser.add_argument("--balanced", action="store_true")
    parser.add_argument("--steps", type=int, default=200_000)
    given = parser.parse_args()
    root = Path(__file__).parents[1]
    config = load(root / "train/policy-strong.toml", PolicyTrainConfig)
    checkpoints = tuple(step for step in (50_000, 100_000) if step < given.steps)
    config = msgspec.structs.replace(
        config, steps=given.steps, checkpoints=checkpoints, agent="gentle", threads=1, seed=0
    )

    def gained(layer: nn.Conv2d | nn.Linear, generator: torch.Generator, std: float = 2**0.5) -> None:
        init_layer(layer, generator, given.critic_gain if std == 1.0 else std)

    with patch("gym_open.agents.policy.init_layer", gained):
        if not given.balanced:
            train_policy(config, given.encoder, given.out)
        else:
            with patch("gym_open.train.policy.take_over", balance):
                train_policy(config, given.encoder, given.out)


if __name__ == "__main__":
    main()
