"""Encoder and random shift against plain NumPy."""

import numpy as np
import pytest
import torch

from gym_open.agents.augment import random_shift
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder, autocast


def pictures(n: int, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, (n, 84, 84, 3), dtype=np.uint8))


def encoder(seed: int = 0, **settings: float) -> Encoder:
    return Encoder(EncoderConfig(**settings), torch.Generator().manual_seed(seed))  # type: ignore[arg-type]


def test_prepare_centres_scales_and_moves_channels_first() -> None:
    net, images = encoder(pixel_scale=10.0), pictures(5)
    net.set_mean_image(images[:3])
    plain = images.numpy().astype(np.float64)
    expected = ((plain - plain[:3].mean(axis=0)) * 10 / 255).transpose(0, 3, 1, 2)
    prepared = net.prepare(images)
    np.testing.assert_allclose(prepared.numpy(), expected, atol=1e-5)
    assert prepared.is_contiguous(memory_format=torch.channels_last)


def test_mean_image_is_the_same_for_any_order() -> None:
    net, images = encoder(), pictures(100)
    net.set_mean_image(images)
    first = net.mean_image.clone()
    net.set_mean_image(images.flip(0))
    assert torch.equal(net.mean_image, first)


@pytest.mark.parametrize("shape", [(0, 84, 84, 3), (2, 3, 84, 84)])
def test_set_mean_image_refuses_what_are_no_pictures(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must have shape \(N, 84, 84, 3\)"):
        encoder().set_mean_image(torch.zeros(shape, dtype=torch.uint8))


def test_forward_is_the_three_layer_network() -> None:
    net = encoder(features=7)
    x = torch.randn(2, 3, 84, 84, generator=torch.Generator().manual_seed(1))
    out = x.numpy().astype(np.float64)
    for conv, stride in ((net.layers[0], 4), (net.layers[2], 2), (net.layers[4], 1)):
        weight, bias = conv.get_parameter("weight").detach().numpy(), conv.get_parameter("bias").detach().numpy()
        windows = np.lib.stride_tricks.sliding_window_view(out, weight.shape[2:], axis=(2, 3))[:, :, ::stride, ::stride]
        out = np.maximum(np.einsum("bcijhw,ochw->boij", windows, weight) + bias[:, None, None], 0)
    linear = net.layers[7]
    weight, bias = linear.get_parameter("weight").detach().numpy(), linear.get_parameter("bias").detach().numpy()
    expected = np.maximum(out.reshape(2, -1) @ weight.T + bias, 0)
    np.testing.assert_allclose(net(x).detach().numpy(), expected, rtol=1e-4, atol=1e-5)


def test_initial_weights_come_from_the_generator_alone() -> None:
    torch.manual_seed(1)
    a = encoder(seed=3).state_dict()
    torch.manual_seed(2)
    b, other = encoder(seed=3).state_dict(), encoder(seed=4).state_dict()
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert not torch.equal(a["layers.0.weight"], other["layers.0.weight"])


def test_initial_weights_are_orthogonal_with_gain_root_two() -> None:
    weight = encoder().layers[0].get_parameter("weight").detach().flatten(1)
    torch.testing.assert_close(weight @ weight.T, 2 * torch.eye(32), atol=1e-5, rtol=0)


def test_bf16_stays_near_fp32_and_is_really_bf16() -> None:
    net = encoder()
    x = net.prepare(pictures(4))
    with autocast("bf16"):
        low = net(x)
    with autocast("fp32"):
        high = net(x)
    assert low.dtype == torch.bfloat16
    assert high.dtype == torch.float32
    assert (low.float() - high).norm() < 0.02 * high.norm()


def test_random_shift_moves_each_picture_and_fills_with_zero() -> None:
    pad = 3
    x = torch.rand(64, 2, 10, 12, generator=torch.Generator().manual_seed(0)) + 1
    shifted = random_shift(x, pad, torch.Generator().manual_seed(1))
    found = set()
    for before, after in zip(x.numpy(), shifted.numpy(), strict=True):
        padded = np.pad(before, ((0, 0), (pad, pad), (pad, pad)))
        moves = [
            (down, right)
            for down in range(-pad, pad + 1)
            for right in range(-pad, pad + 1)
            if np.array_equal(after, padded[:, pad - down : pad - down + 10, pad - right : pad - right + 12])
        ]
        assert len(moves) == 1
        found.add(moves[0])
    assert {down for down, _ in found} == {right for _, right in found} == set(range(-pad, pad + 1))


def test_random_shift_keeps_memory_order_and_is_repeatable() -> None:
    x = torch.rand(4, 3, 84, 84).to(memory_format=torch.channels_last)
    a, b = (random_shift(x, 8, torch.Generator().manual_seed(5)) for _ in range(2))
    assert torch.equal(a, b)
    assert a.is_contiguous(memory_format=torch.channels_last)
    assert random_shift(x, 0, torch.Generator()) is x


@pytest.mark.parametrize("pad", [0, 5])
def test_shifting_and_preparing_in_one_pass_is_the_same(pad: int) -> None:
    net, images = encoder(), pictures(6)
    net.set_mean_image(images[:4])
    expected = random_shift(net.prepare(images), pad, torch.Generator().manual_seed(1))
    found = net.prepare_shifted(images, pad, torch.Generator().manual_seed(1))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)
    assert found.is_contiguous(memory_format=torch.channels_last)
    with autocast("bf16"):
        low = net.prepare_shifted(images, pad, torch.Generator().manual_seed(1))
    assert low.dtype == torch.bfloat16
    torch.testing.assert_close(low.float(), expected, atol=0.05, rtol=0.01)
