"""The paper's three convolutions in fp32 on a CPU, forward and backward, as compiled code.

Why not PyTorch's layers: oneDNN's code for processors without AVX-512 takes up to 1.5 × the time of the products in the
gradients of the weights. Each layer writes its numbers to memory, and the next one reads them back. A ReLU takes
another pass. Here, a few images at a time go through all three layers while their numbers are in the cache. Products
are added in registers (`tiles`), and bias and ReLU are part of the last addition. Forward and backward pass of the
whole network take .97 × the time of the products alone, with AVX2 and with AVX-512. With PyTorch's layers they take
1.31 × and 1.19 × (`benchmarks/bench_ppo.py`).

Every number is the sum of its products in one fixed order. So the features of an image do not depend on the other
images in the batch.

Method: images are stored with channels last. The input of a kernel is then a run of `kernel · channels` numbers in each
of `kernel` rows, and an output is the sum of `kernel` dot products of runs. `add_rows` computes a tile of outputs at
once. The same function propagates gradients back to the inputs. `add_columns` computes tiles of the gradients of the
weights.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn

from gym_open.agents.buffers import borrow
from gym_open.agents.tiles import ROWS, WIDTH, add_columns, add_rows
from gym_open.envs.jit import compiled

CHUNK = 4
"""Images that go through all layers together. Their numbers fit into the core's own cache."""


class Layer(NamedTuple):
    """A convolution without padding."""

    channels: int
    size: int
    """Edge of its input image."""
    kernel: int
    stride: int
    outputs: int
    out: int
    """Edge of its output image."""
    together: int
    """Rows of the kernel whose products are added before the sum is written; the first layer has short rows."""


FIRST, SECOND, THIRD = Layer(3, 84, 8, 4, 32, 20, 8), Layer(32, 20, 4, 2, 64, 9, 1), Layer(64, 9, 3, 1, 64, 7, 1)
"""Mnih et al. 2015."""
FIRST_LOOKS, SECOND_LOOKS, THIRD_LOOKS = (layer.channels * layer.size**2 for layer in (FIRST, SECOND, THIRD))
"""Numbers in the input of each layer, for one image."""
N_PLACES, N_OUTPUTS = THIRD.out**2, THIRD.outputs
N_FEATURES = N_PLACES * N_OUTPUTS


def suits(layers: Sequence[nn.Module], prepared: Tensor) -> bool:
    """Whether `three_layers` can replace these PyTorch layers: fp32 on a CPU, and no gradient for the images."""
    return (
        prepared.dtype == torch.float32
        and prepared.device.type == "cpu"
        and not prepared.requires_grad
        and not torch.is_autocast_enabled("cpu")
        and all(parameter.dtype == torch.float32 for layer in layers for parameter in layer.parameters())
    )


def three_layers(prepared: Tensor, layers: Sequence[nn.Conv2d], slope: float) -> Tensor:
    """Pass images through the three convolutions, with an activation after each.

    Args:
        prepared: (B, 3, 84, 84) fp32, without a gradient.
        layers: the convolutions, on the CPU.
        slope: slope of the activation below zero: 0 for a ReLU.

    Returns:
        Features (B, 3136), channel by channel, in the order of `nn.Flatten`.
    """
    weights = [parameter for layer in layers for parameter in (layer.weight, cast("Tensor", layer.bias))]
    keep = torch.is_grad_enabled() and any(weight.requires_grad for weight in weights)
    return cast("Tensor", _ThreeLayers.apply(prepared, slope, keep, *weights))


class _ThreeLayers(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, prepared: Tensor, slope: float, keep: bool, *weights: Tensor) -> Tensor:
        """Features. The outputs of both lower layers are kept for the backward pass if `keep`."""
        images = prepared.detach().permute(0, 2, 3, 1).contiguous().view(-1).numpy()
        packed = [_packed(weight) for weight in weights[::2]]
        biases = [bias.detach().numpy() for bias in weights[1::2]]
        n = len(prepared)
        features = borrow((n * N_FEATURES,), np.float32)
        lower = [borrow(((n if keep else CHUNK) * looks,), np.float32) for looks in (SECOND_LOOKS, THIRD_LOOKS)]
        _forward(n, images, *packed, *biases, *lower, features, slope, keep)
        if keep:
            ctx.slope, ctx.seen = slope, (images, *lower, features)
            ctx.save_for_backward(*weights)
        return torch.from_numpy(features).view(n, N_FEATURES)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of weights and biases."""
        gradient = gradients[0].contiguous().view(-1).numpy()
        weights = ctx.saved_tensors
        upper = [weight.detach().permute(0, 2, 3, 1).contiguous().view(-1).numpy() for weight in weights[2::2]]
        sums = [np.zeros(weight.numel(), np.float32) for weight in weights]
        _backward(len(gradients[0]), *ctx.seen, gradient, *upper, *sums, ctx.slope)
        return (
            None,
            None,
            None,
            *(_like(torch.from_numpy(one), weight) for one, weight in zip(sums, weights, strict=True)),
        )


def _packed(weight: Tensor) -> np.ndarray:
    """Weights (O, C, K, K) in the order that `add_rows` needs: (O / WIDTH, K, K, C, WIDTH), flat."""
    tiles = weight.detach().unflatten(0, (-1, WIDTH)).permute(0, 3, 4, 2, 1)
    return tiles.contiguous().view(-1).numpy()


def _like(gradient: Tensor, parameter: Tensor) -> Tensor:
    """A gradient from `_backward`, (K, K, C, O) flat, in the shape and memory order of the parameter."""
    if parameter.dim() == 1:
        return gradient
    outputs, channels, height, width = parameter.shape
    ordered = gradient.view(height, width, channels, outputs).permute(3, 2, 0, 1)
    return torch.empty_like(parameter).copy_(ordered)


@compiled
def _forward(  # noqa: PLR0917  # compiled code takes arguments by position
    count: int,
    images: np.ndarray,
    packed1: np.ndarray,
    packed2: np.ndarray,
    packed3: np.ndarray,
    bias1: np.ndarray,
    bias2: np.ndarray,
    bias3: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    features: np.ndarray,
    slope: float,
    keep: bool,
) -> None:
    """Features of all images. `first` and `second` get the outputs of these layers, of all images if `keep`."""
    third = np.empty(CHUNK * N_FEATURES, np.float32)
    for start in range(0, count, CHUNK):
        n = min(CHUNK, count - start)
        at = start if keep else 0
        _convolve(FIRST, n, images, start * FIRST_LOOKS, packed1, bias1, first, at * SECOND_LOOKS, slope)
        _convolve(SECOND, n, first, at * SECOND_LOOKS, packed2, bias2, second, at * THIRD_LOOKS, slope)
        _convolve(THIRD, n, second, at * THIRD_LOOKS, packed3, bias3, third, 0, slope)
        for i in range(n):
            for output in range(N_OUTPUTS):
                to, source = (start + i) * N_FEATURES + output * N_PLACES, i * N_FEATURES + output
                for place in range(N_PLACES):
                    features[to + place] = third[source + place * N_OUTPUTS]


@compiled
def _backward(  # noqa: PLR0917
    count: int,
    images: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    features: np.ndarray,
    gradient: np.ndarray,
    weight2: np.ndarray,
    weight3: np.ndarray,
    d_weight1: np.ndarray,
    d_bias1: np.ndarray,
    d_weight2: np.ndarray,
    d_bias2: np.ndarray,
    d_weight3: np.ndarray,
    d_bias3: np.ndarray,
    slope: float,
) -> None:
    """Add the contributions of all images to the gradients of weights, (K, K, C, O) flat, and biases."""
    d_first, d_second = np.empty(CHUNK * SECOND_LOOKS, np.float32), np.empty(CHUNK * THIRD_LOOKS, np.float32)
    d_third, third = np.empty(CHUNK * N_FEATURES, np.float32), np.empty(CHUNK * N_FEATURES, np.float32)
    for start in range(0, count, CHUNK):
        n = min(CHUNK, count - start)
        for i in range(n):
            for output in range(N_OUTPUTS):
                source, to = (start + i) * N_FEATURES + output * N_PLACES, i * N_FEATURES + output
                for place in range(N_PLACES):
                    third[to + place * N_OUTPUTS] = features[source + place]
                    d_third[to + place * N_OUTPUTS] = gradient[source + place]
        _through_activation(n * N_PLACES, third, 0, d_third, d_bias3, slope)
        _add_weights(THIRD, n, second, start * THIRD_LOOKS, d_third, d_weight3)
        _hand_down(THIRD, n, d_third, weight3, d_second)
        _through_activation(n * THIRD.size**2, second, start * THIRD_LOOKS, d_second, d_bias2, slope)
        _add_weights(SECOND, n, first, start * SECOND_LOOKS, d_second, d_weight2)
        _hand_down(SECOND, n, d_second, weight2, d_first)
        _through_activation(n * SECOND.size**2, first, start * SECOND_LOOKS, d_first, d_bias1, slope)
        _add_weights(FIRST, n, images, start * FIRST_LOOKS, d_first, d_weight1)


@compiled
def _places(layer: Layer, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the output places of n images, in numbers: of the input of each place, and of the place itself.

    Filled up to whole tiles with the last place again: it is then computed twice, with the same result.
    """
    count = n * layer.out**2
    padded = (count + ROWS - 1) // ROWS * ROWS
    looks, makes = np.empty(padded, np.int64), np.empty(padded, np.int64)
    row = layer.size * layer.channels
    for i in range(padded):
        place = min(i, count - 1)
        image, inside = place // layer.out**2, place % layer.out**2
        down, right = inside // layer.out, inside % layer.out
        looks[i] = image * layer.size * row + layer.stride * (down * row + right * layer.channels)
        makes[i] = place * layer.outputs
    return looks, makes


@compiled
def _convolve(  # noqa: PLR0917
    layer: Layer, n: int, x: np.ndarray, x_at: int, packed: np.ndarray, bias: np.ndarray, y: np.ndarray, y_at: int,
    slope: float,
) -> None:  # fmt: skip
    """Apply a layer and its activation to n images: from `x[x_at:]` to `y[y_at:]`."""
    looks, makes = _places(layer, n)
    row, run = layer.size * layer.channels, layer.kernel * layer.channels
    for tile in range(layer.outputs // WIDTH):
        for tap in range(0, layer.kernel, layer.together):
            weights = (tile * layer.kernel + tap) * run * WIDTH
            last = tap + layer.together == layer.kernel
            for place in range(0, len(looks), ROWS):
                add_rows(
                    ROWS, x, x_at + tap * row, looks, place, layer.together, row, run, packed, weights, WIDTH,
                    bias if tap == 0 else y, tile * WIDTH + (0 if tap == 0 else y_at), 0 if tap == 0 else 1,
                    y, y_at + tile * WIDTH, makes, np.float32(slope if last else 1.0),
                )  # fmt: skip


@compiled
def _hand_down(layer: Layer, n: int, dy: np.ndarray, weight: np.ndarray, dx: np.ndarray) -> None:
    """Compute the gradient of a layer's input from that of its output, for n images; `weight` is (O, K, K, C)."""
    looks, makes = _places(layer, n)
    row, run = layer.size * layer.channels, layer.kernel * layer.channels
    dx[: n * layer.size * row] = 0
    for tap in range(layer.kernel):
        for tile in range(0, run, WIDTH):
            for place in range(0, len(looks), ROWS):
                add_rows(
                    ROWS, dy, 0, makes, place, 1, 0, layer.outputs, weight, tap * run + tile, layer.kernel * run,
                    dx, tap * row + tile, 1, dx, tap * row + tile, looks, np.float32(1),
                )  # fmt: skip


@compiled
def _add_weights(  # noqa: PLR0917
    layer: Layer, n: int, x: np.ndarray, x_at: int, dy: np.ndarray, sums: np.ndarray
) -> None:
    """Add the gradient of a layer's weights to `sums`, (K, K, C, O), image by image."""
    looks, _ = _places(layer, 1)
    places = layer.out**2
    row, run = layer.size * layer.channels, layer.kernel * layer.channels
    for image in range(n):
        x_from, dy_from = x_at + image * layer.size * row, image * places * layer.outputs
        for tile in range(0, layer.outputs, WIDTH):
            for tap in range(layer.kernel):
                done = 0
                while done < run:
                    a, c = x_from + tap * row + done, (tap * run + done) * layer.outputs + tile
                    if run - done >= ROWS and run - done != 8:
                        add_columns(ROWS, x, a, looks, places, dy, dy_from + tile, layer.outputs, sums, c)
                        done += ROWS
                    else:  # the rest of a run is a multiple of four
                        add_columns(4, x, a, looks, places, dy, dy_from + tile, layer.outputs, sums, c)
                        done += 4


@compiled
def _through_activation(  # noqa: PLR0917
    count: int, y: np.ndarray, y_at: int, dy: np.ndarray, sums: np.ndarray, slope: float
) -> None:
    """Turn the gradient after the activation, at `count` places, into that before it, and add it to the bias's."""
    width, below = len(sums), np.float32(slope)
    for place in range(count):
        of, made = dy[place * width : (place + 1) * width], y[y_at + place * width : y_at + (place + 1) * width]
        for k in range(width):
            of[k] *= np.float32(1) if made[k] > 0 else below
            sums[k] += of[k]
