"""Encoder and shifts against plain NumPy."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gym_open.agents.augment import _shift_each_cuda, draw_shifts, shift_each
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder, autocast


def make_images(n: int, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, (n, 84, 84, 3), dtype=np.uint8))


def encoder(seed: int = 0, **settings: float) -> Encoder:
    return Encoder(EncoderConfig(**settings), torch.Generator().manual_seed(seed))  # type: ignore[arg-type]


def test_prepare_centres_scales_and_moves_channels_first() -> None:
    net, images = encoder(pixel_scale=10.0), make_images(5)
    net.set_mean_image(images[:3])
    plain = images.numpy().astype(np.float64)
    expected = ((plain - plain[:3].mean(axis=0)) * 10 / 255).transpose(0, 3, 1, 2)
    prepared = net.prepare(images)
    np.testing.assert_allclose(prepared.numpy(), expected, atol=1e-5)
    assert prepared.is_contiguous(memory_format=torch.channels_last)


def test_arrays_are_encoded_as_tensors_are() -> None:
    """Also read-only arrays and views with negative strides, without a warning."""
    net, images = encoder(features=8), make_images(3)
    expected = net.encode(images)
    array = images.numpy().copy()
    array.flags.writeable = False
    assert torch.equal(net.encode(array), expected)
    assert torch.equal(net.encode(array[::-1, :, ::-1]), net.encode(images.flip(0, 2)))
    assert not array.flags.writeable
    assert not expected.requires_grad


@pytest.mark.parametrize("kind", ["array", "tensor"])
@pytest.mark.parametrize(
    ("shape", "dtype"), [((84, 84, 3), "uint8"), ((1, 3, 84, 84), "uint8"), ((1, 84, 84, 3), "float32")]
)
def test_arrays_that_are_no_images_are_not_encoded(kind: str, shape: tuple[int, ...], dtype: str) -> None:
    array = np.zeros(shape, dtype)
    with pytest.raises(ValueError, match=r"must be \(B, 84, 84, 3\) uint8, got \(.*\) .*" + dtype):
        encoder(features=8).encode(array if kind == "array" else torch.from_numpy(array))


def test_mean_image_is_the_same_for_any_order() -> None:
    net, images = encoder(), make_images(100)
    net.set_mean_image(images)
    first = net.mean_image.clone()
    net.set_mean_image(images.flip(0))
    assert torch.equal(net.mean_image, first)


@pytest.mark.parametrize("shape", [(0, 84, 84, 3), (2, 3, 84, 84)])
def test_set_mean_image_refuses_arrays_that_are_no_images(shape: tuple[int, ...]) -> None:
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
    x = net.prepare(make_images(4))
    with autocast("bf16"):
        low = net(x)
    with autocast("fp32"):
        high = net(x)
    assert low.dtype == torch.bfloat16
    assert high.dtype == torch.float32
    assert (low.float() - high).norm() < 0.02 * high.norm()


def moved(image: np.ndarray, down: int, right: int) -> np.ndarray:
    """An image (H, W, C), moved, with zeros at the edge."""
    pad = 20
    height, width, _ = image.shape
    padded = np.pad(image, ((pad, pad), (pad, pad), (0, 0)))
    return padded[pad - down : pad - down + height, pad - right : pad - right + width]


@given(seed=st.integers(0, 2**32), pad=st.integers(0, 12))
@settings(max_examples=20)
def test_shifts_are_applied_to_prepared_images_with_zeros_at_the_edge(seed: int, pad: int) -> None:
    net, images = encoder(), make_images(6, seed)
    net.set_mean_image(images[:4])
    shifts = draw_shifts(6, pad, torch.Generator().manual_seed(seed))
    plain = images.numpy().astype(np.float64)
    centred = (plain - plain[:4].mean(axis=0)) * 20 / 255
    expected = np.stack([moved(one, *shift) for one, shift in zip(centred, shifts.tolist(), strict=True)])
    found = net.prepare_shifted(images, shifts)
    assert found.is_contiguous(memory_format=torch.channels_last)
    np.testing.assert_allclose(found.numpy(), expected.transpose(0, 3, 1, 2), atol=1e-4)
    with autocast("bf16"):
        low = net.prepare_shifted(images, shifts)
    assert low.dtype == torch.bfloat16
    torch.testing.assert_close(low.float(), found, atol=0.05, rtol=0.01)


def test_preparing_centres_and_scales() -> None:
    net, images = encoder(), make_images(3)
    net.set_mean_image(images[:2])
    plain = images.double()
    expected = (plain - plain[:2].mean(dim=0)) * 20 / 255
    torch.testing.assert_close(net.prepare(images).double(), expected.permute(0, 3, 1, 2), atol=1e-4, rtol=0)
    raw = Encoder(EncoderConfig(features=8, pixel_scale=1.0, centre=False), torch.Generator().manual_seed(0))
    raw.set_mean_image(images)
    torch.testing.assert_close(raw.prepare(images).double(), (plain / 255).permute(0, 3, 1, 2), atol=1e-6, rtol=0)


@given(seed=st.integers(0, 2**32), pad=st.integers(0, 12))
@settings(max_examples=20)
def test_the_compiled_shift_is_that_of_tensor_operations(seed: int, pad: int) -> None:
    """The code for GPUs, run on the CPU; and bf16 is rounded as in PyTorch."""
    generator = torch.Generator().manual_seed(seed)
    images = make_images(3, seed)[:, :20, :30]
    weight, offset = torch.randn(20, 30, 3, generator=generator), torch.randn(20, 30, 3, generator=generator)
    shifts = draw_shifts(3, pad, generator)
    found = shift_each(images, shifts, weight, offset, torch.float32)
    torch.testing.assert_close(found, _shift_each_cuda(images, shifts, weight, offset), atol=1e-4, rtol=1e-6)
    low = shift_each(images, shifts, weight, offset, torch.bfloat16)
    assert torch.equal(low, found.to(torch.bfloat16))


def test_drawn_shifts_are_uniform_on_both_axes_and_repeatable() -> None:
    shifts = draw_shifts(7000, 3, torch.Generator().manual_seed(1))
    assert torch.equal(shifts, draw_shifts(7000, 3, torch.Generator().manual_seed(1)))
    for axis in shifts.numpy().T:
        counts = np.bincount(axis + 3, minlength=7)
        assert len(counts) == 7
        np.testing.assert_allclose(counts, 1000, atol=5 * np.sqrt(1000))
    assert abs(np.corrcoef(shifts.numpy().T)[0, 1]) < 0.05
