"""IMPALA's network, compared with PyTorch's plain functions, and used wherever the three-layer network is."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerConfig, IcmConfig, RndConfig, WorldModelName
from gym_open.agents.encoder import Encoder, impala
from gym_open.agents.policy import ActorCritic
from gym_open.agents.world_model import TransitionBatch
from gym_open.agents.world_models import WORLD_MODELS, make_world_model
from gym_open.formats.models import load_encoder, load_policy, save_encoder, save_policy

DEEP = EncoderConfig(architecture="impala", features=32)


def plain(weights: Sequence[Tensor], x: Tensor) -> Tensor:
    """The network of the paper's figure, which takes the weights one by one."""
    left = iter(weights)

    def conv(y: Tensor) -> Tensor:
        return F.conv2d(y, next(left), next(left), padding=1)

    for _ in range(3):
        x = F.max_pool2d(conv(x), 3, stride=2, padding=1)
        for _ in range(2):
            x = x + conv(F.relu(conv(F.relu(x))))
    return F.linear(F.relu(x).flatten(1), next(left), next(left))


def test_it_is_the_papers_network() -> None:
    network = impala(256, torch.Generator().manual_seed(0))
    weights = list(network.parameters())
    assert [tuple(weight.shape[:2]) for weight in weights[::2]] == [
        (16, 3), *[(16, 16)] * 4, (32, 16), *[(32, 32)] * 4, (32, 32), *[(32, 32)] * 4, (256, 32 * 11 * 11),
    ]  # fmt: skip
    for bias in weights[1::2]:  # as after some learning
        torch.nn.init.normal_(bias, generator=torch.Generator().manual_seed(1))
    x = torch.randn(2, 3, 84, 84, generator=torch.Generator().manual_seed(2))
    torch.testing.assert_close(network(x), plain(weights, x), rtol=1e-4, atol=1e-4)


def test_its_features_are_about_as_large_as_those_of_the_shallow_network(make_images: Callable[..., Tensor]) -> None:
    sizes = []
    for architecture in ("cnn", "impala"):
        encoder = Encoder(EncoderConfig(architecture=architecture), torch.Generator().manual_seed(0))
        encoder.set_mean_image(make_images(20))
        sizes.append(encoder.encode(make_images(20)).square().mean().sqrt().item())
    assert 1 / 3 < sizes[1] / sizes[0] < 3


@pytest.mark.parametrize("name", WORLD_MODELS)
def test_every_world_model_trains_all_of_it(name: WorldModelName, make_images: Callable[..., Tensor]) -> None:
    init = torch.Generator().manual_seed(0)
    config = ExplorerConfig(icm=IcmConfig(hidden=8), rnd=RndConfig(hidden=8, outputs=8), curl=CurlConfig(latent=8))
    model = make_world_model(name, config, Encoder(DEEP, init), 9, init)
    model.watch(make_images(4))
    play = TransitionBatch(make_images(4), torch.arange(4), make_images(4, 1))
    model.loss(play, no_shifts(4), init).backward()
    assert all(weight.grad is not None and weight.grad.any() for weight in model.encoder.parameters())


def test_encoders_and_policies_are_restored_from_disk(make_images: Callable[..., Tensor], tmp_path: Path) -> None:
    encoder, images = Encoder(DEEP, torch.Generator().manual_seed(3)), make_images(3)
    encoder.set_mean_image(images)
    save_encoder(tmp_path / "encoder", encoder)
    torch.testing.assert_close(load_encoder(tmp_path / "encoder").encode(images), encoder.encode(images))
    policy = ActorCritic(encoder, 9, torch.Generator().manual_seed(4))
    save_policy(tmp_path / "policy", policy)
    again = load_policy(tmp_path / "policy")
    torch.testing.assert_close(again.get_value(again.prepare(images)), policy.get_value(policy.prepare(images)))
