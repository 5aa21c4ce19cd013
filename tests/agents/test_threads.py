"""A network that is divided among threads computes the same features and gradients."""

import os

import pytest
import torch
from torch import Tensor, nn

from gym_open.agents import threads
from gym_open.agents.config import Architecture, EncoderConfig
from gym_open.agents.encoder import Encoder, autocast
from gym_open.agents.threads import in_parts, set_threads, side_by_side, through
from gym_open.precision import Precision


def encoder(architecture: Architecture = "cnn") -> Encoder:
    return Encoder(EncoderConfig(architecture=architecture, features=16), torch.Generator().manual_seed(0))


def make_images(n: int) -> Tensor:
    return torch.randint(256, (n, 84, 84, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))


def learned(network: Encoder, n: int, count: int, precision: Precision) -> tuple[Tensor, list[Tensor]]:
    """Features of n images, and gradients of a sum of them, with `count` threads."""
    set_threads(count)
    with autocast(precision):
        features = network(network.prepare(make_images(n)))
    weights = torch.randn(features.shape, generator=torch.Generator().manual_seed(2))
    parameters = [parameter for parameter in network.parameters() if parameter.requires_grad]
    return features.detach(), list(torch.autograd.grad((features.float() * weights).sum(), parameters))


@pytest.mark.parametrize(
    ("architecture", "precision", "tolerance"), [("cnn", "fp32", 1e-4), ("impala", "fp32", 1e-4), ("cnn", "bf16", 0.05)]
)
@pytest.mark.parametrize("count", [2, 3])
def test_features_and_gradients_are_those_of_one_thread(
    architecture: Architecture, precision: Precision, tolerance: float, count: int
) -> None:
    network = encoder(architecture)
    expected, slopes = learned(network, 27, 1, precision)
    features, found = learned(network, 27, count, precision)
    assert features.dtype == expected.dtype
    torch.testing.assert_close(features, expected, rtol=tolerance, atol=tolerance)
    for one, other in zip(found, slopes, strict=True):
        torch.testing.assert_close(one, other, rtol=tolerance, atol=tolerance * float(other.abs().max()))


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_they_repeat_to_the_bit(precision: Precision) -> None:
    (features, found), (again, others) = (learned(encoder(), 27, 2, precision) for _ in range(2))
    assert torch.equal(features, again)
    assert all(torch.equal(one, other) for one, other in zip(found, others, strict=True))


def test_only_parameters_that_learn_have_gradients() -> None:
    network = encoder()
    network.layers[0].requires_grad_(requires_grad=False)
    expected, slopes = learned(network, 16, 1, "fp32")
    features, found = learned(network, 16, 2, "fp32")
    torch.testing.assert_close(features, expected, rtol=1e-4, atol=1e-4)  # features reach 1
    assert len(found) == len(slopes) == 6
    for one, other in zip(found, slopes, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4 * float(other.abs().max()))


def test_without_gradients_no_graph_is_kept() -> None:
    set_threads(2)
    network = encoder()
    with torch.no_grad():
        assert not network(network.prepare(make_images(20))).requires_grad
    network.requires_grad_(requires_grad=False)
    assert not network(network.prepare(make_images(20))).requires_grad
    with torch.inference_mode():
        assert network(network.prepare(make_images(20))).is_inference()


def test_bf16_uses_the_weights_of_now() -> None:
    """PyTorch caches bf16 weights within one `autocast`; they must not outlive a step."""
    set_threads(2)
    network = encoder()
    prepared = network.prepare(make_images(20))
    for _ in range(2):
        with autocast("bf16"):
            before = network(prepared.bfloat16())
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.mul_(0.5)
        with autocast("bf16"):
            after = network(prepared.bfloat16())
        assert not torch.equal(after, before)


def test_a_gradient_of_the_images_is_pytorchs() -> None:
    set_threads(2)
    network = encoder()
    prepared = network.prepare(make_images(20)).requires_grad_()
    network(prepared).sum().backward()
    assert prepared.grad is not None
    assert prepared.grad.abs().sum() > 0


def test_parts_cover_all_images_in_order() -> None:
    for count in (1, 2, 3, 5):
        set_threads(count)
        for n in (0, 1, 15, 16, 17, 40, 99):
            parts = in_parts(n, lambda begin, end: list(range(begin, end)))
            assert [i for part in parts for i in part] == list(range(n))
            assert len(parts) == max(min(count, n // 8), 1)


def test_an_error_in_a_thread_reaches_the_caller() -> None:
    def fail() -> int:
        raise KeyError("other")

    with pytest.raises(KeyError, match="other"):
        side_by_side([lambda: 1, fail])


def test_a_few_images_stay_in_one_thread() -> None:
    set_threads(2)
    network = nn.Linear(3, 2)
    assert through(network, torch.ones(15, 3)).grad_fn is not None
    assert "Through" not in str(through(network, torch.ones(15, 3)).grad_fn)
    assert "Through" in str(through(network, torch.ones(16, 3)).grad_fn)


def test_the_number_of_threads_is_restored() -> None:
    before = torch.get_num_threads()
    with threads.threads(3):
        assert torch.get_num_threads() == 1
        assert len(in_parts(40, lambda begin, _: begin)) == 3
    assert torch.get_num_threads() == before
    assert len(in_parts(40, lambda begin, _: begin)) == 1


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes do not fork here")
def test_a_forked_process_has_threads_of_its_own() -> None:
    set_threads(2)
    assert in_parts(40, lambda begin, _: begin) == [0, 20]
    child = os.fork()
    if child == 0:
        os._exit(0 if in_parts(40, lambda begin, _: begin) == [0, 20] else 1)
    assert os.waitpid(child, 0)[1] == 0
