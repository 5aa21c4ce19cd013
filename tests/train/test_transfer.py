"""What is taken over of an encoder."""

import pytest
import torch

from gym_open.agents.config import Architecture, EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.train.transfer import take_over


@pytest.fixture(params=["cnn", "impala"])
def taught(request: pytest.FixtureRequest) -> Encoder:
    """An encoder whose features are seven times too large, and whose last layer has learned a bias."""
    architecture: Architecture = request.param
    encoder = Encoder(EncoderConfig(architecture=architecture, features=16), torch.Generator().manual_seed(1))
    encoder.set_mean_image(pictures())
    with torch.no_grad():
        last = encoder.layers[-2]
        assert isinstance(last, torch.nn.Linear)
        last.weight.mul_(7)
        last.bias.add_(0.5)
    return encoder


def pictures() -> torch.Tensor:
    return torch.randint(0, 256, (60, 84, 84, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))


def untrained(like: Encoder, images: torch.Tensor) -> torch.Tensor:
    """Root mean square of what an untrained encoder makes of pictures."""
    fresh = Encoder(like.config, torch.Generator().manual_seed(2))
    fresh.mean_image.copy_(like.mean_image)
    return fresh.encode(images).square().mean().sqrt()


def test_scaled_features_are_the_same_up_to_one_factor_and_as_large_as_fresh_ones(taught: Encoder) -> None:
    images = pictures()
    before = taught.encode(images)
    take_over(taught, "scaled", images, torch.Generator().manual_seed(2))
    after = taught.encode(images)
    factor = (after.sum() / before.sum()).item()
    torch.testing.assert_close(after, before * factor, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(after.square().mean().sqrt(), untrained(taught, images), rtol=1e-4, atol=0)


def test_convolutions_alone_keep_all_but_the_last_layer(taught: Encoder) -> None:
    before = [parameter.clone() for parameter in taught.parameters()]
    images = pictures()
    take_over(taught, "convolutions", images, torch.Generator().manual_seed(2))
    *first, weight, bias = zip(before, taught.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in first)
    assert abs(torch.corrcoef(torch.stack([weight[0].flatten(), weight[1].flatten()]))[0, 1]) < 0.1
    assert not bias[1].any()
    assert 0.5 < taught.encode(images).square().mean().sqrt() / untrained(taught, images) < 2


def test_weights_are_left_as_they_are(taught: Encoder) -> None:
    before = [parameter.clone() for parameter in taught.parameters()]
    take_over(taught, "weights", pictures(), torch.Generator().manual_seed(2))
    assert all(torch.equal(a, b) for a, b in zip(before, taught.parameters(), strict=True))
