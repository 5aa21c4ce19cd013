"""The compiled convolutions equal PyTorch's: outputs and gradients, for every number of images."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from gym_open.agents import convolve
from gym_open.agents.encoder import Convolutions, autocast, convolutions

FEATURES = 24


def network(activation: Callable[[], nn.Module] = nn.ReLU) -> Convolutions:
    made = convolutions(FEATURES, activation, torch.Generator().manual_seed(0))
    assert isinstance(made, Convolutions)
    with torch.no_grad():  # with the initial biases of zero, a missing bias would not show
        for layer in made:
            if isinstance(layer, nn.Conv2d) and layer.bias is not None:
                layer.bias.copy_(torch.randn(layer.bias.shape, generator=torch.Generator().manual_seed(1)))
    return made


def make_images(n: int) -> Tensor:
    return torch.randn(n, 84, 84, 3, generator=torch.Generator().manual_seed(2)).permute(0, 3, 1, 2)


def gradients(network: nn.Sequential, made: Tensor) -> list[Tensor]:
    """Gradients of a sum in which every feature has another weight."""
    weights = torch.randn(made.shape, generator=torch.Generator().manual_seed(3))
    return list(torch.autograd.grad((made * weights).sum(), list(network.parameters())))


@pytest.mark.parametrize("n", [1, 3, 4, 21])
def test_features_and_gradients_are_those_of_pytorchs_layers(n: int) -> None:
    ours = network()
    expected, made = nn.Sequential.forward(ours, make_images(n)), ours(make_images(n))
    torch.testing.assert_close(made, expected, rtol=1e-5, atol=1e-5)
    for name, found, wanted in zip(
        dict(ours.named_parameters()), gradients(ours, made), gradients(ours, expected), strict=True
    ):
        assert found.stride() == wanted.stride(), name
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5 * float(wanted.abs().max()), msg=name)


def test_a_leaky_relu_has_its_slope() -> None:
    ours = network(lambda: nn.LeakyReLU(0.2))
    expected, made = nn.Sequential.forward(ours, make_images(9)), ours(make_images(9))
    torch.testing.assert_close(made, expected, rtol=1e-5, atol=1e-5)
    for found, wanted in zip(gradients(ours, made), gradients(ours, expected), strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5 * float(wanted.abs().max()))


def test_gradients_hold_against_differences_in_float64() -> None:
    """Compared with the definition: a small step of some of the weights."""
    ours, seen = network(), make_images(3)
    found = gradients(ours, ours(seen))
    exact = network().double()
    weights = torch.randn(3, FEATURES, generator=torch.Generator().manual_seed(3)).double()
    for index, (parameter, gradient) in enumerate(zip(exact.parameters(), found, strict=True)):
        flat = parameter.detach().permute(*range(parameter.dim()))
        place = tuple(int(size) // 2 for size in flat.shape)
        step, sides = 1e-6, []
        for sign in (1, -1):
            with torch.no_grad():
                parameter[place] += sign * step
                sides.append(float((exact(seen.double()) * weights).sum()))
                parameter[place] -= sign * step
        slope = (sides[0] - sides[1]) / (2 * step)
        assert float(gradient[place]) == pytest.approx(slope, rel=1e-3, abs=1e-3), index


def test_a_feature_does_not_depend_on_the_other_images() -> None:
    layers = [layer for layer in network() if isinstance(layer, nn.Conv2d)]
    together = convolve.three_layers(make_images(21), layers, 0.0)
    alone = torch.cat([convolve.three_layers(one, layers, 0.0) for one in make_images(21).split(1)])
    assert torch.equal(alone, together)
    with torch.no_grad():
        assert torch.equal(convolve.three_layers(make_images(21), layers, 0.0), together)


def test_gradients_repeat_to_the_bit() -> None:
    ours = network()
    first, again = (gradients(ours, ours(make_images(21))) for _ in range(2))
    assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))


def test_nan_is_not_lost() -> None:
    seen = make_images(2).clone()
    seen[1, 0, 40, 40] = torch.nan
    made = network()(seen)
    assert made[0].isfinite().all()
    assert made[1].isnan().any()


def test_other_arithmetic_and_gradients_of_images_are_left_to_pytorch() -> None:
    ours = network()
    layers = [layer for layer in ours if isinstance(layer, nn.Conv2d)]
    assert convolve.suits(layers, make_images(2))
    assert not convolve.suits(layers, make_images(2).bfloat16())
    assert not convolve.suits(layers, make_images(2).requires_grad_())
    assert not convolve.suits([network()[0].double()], make_images(2))
    with autocast("bf16"):
        assert not convolve.suits(layers, make_images(2))
        assert ours(make_images(2)).dtype == torch.bfloat16
    seen = make_images(2).requires_grad_()
    ours(seen).sum().backward()
    assert seen.grad is not None
    assert seen.grad.abs().sum() > 0


def test_only_weights_that_learn_have_gradients() -> None:
    ours = network()
    ours[0].requires_grad_(requires_grad=False)
    ours(make_images(9)).sum().backward()
    assert [name for name, parameter in ours.named_parameters() if parameter.grad is None] == ["0.weight", "0.bias"]
