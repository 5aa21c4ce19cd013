"""ICM against plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import EncoderConfig, IcmConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.icm import Icm
from gym_open.agents.world_model import TransitionBatch

MakeImages = Callable[..., torch.Tensor]
ACTIONS = torch.tensor([0, 3, 8, 8, 1])


def icm(**settings: float) -> Icm:
    generator = torch.Generator().manual_seed(0)
    encoder = Encoder(EncoderConfig(features=32, pixel_scale=2.0), generator)
    return Icm(encoder, IcmConfig(hidden=16, **settings), 9, generator)  # type: ignore[arg-type]


def steps(make_images: MakeImages) -> TransitionBatch:
    return TransitionBatch(make_images(5, 0), ACTIONS, make_images(5, 1))


def dense(network: torch.nn.Module, x: np.ndarray) -> np.ndarray:
    """A linear layer, ReLU, a linear layer, from their weights."""
    w1, b1, w2, b2 = (parameter.detach().numpy().astype(np.float64) for parameter in network.parameters())
    return np.maximum(x @ w1.T + b1, 0) @ w2.T + b2


def plain_errors(model: Icm, play: TransitionBatch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """½ mean_d (φ̂′ − φ′)², −log p(a) and whether a is the most likely action, from features and weights alone."""

    def phi(images: torch.Tensor) -> np.ndarray:
        x = model.encoder(model.encoder.prepare(images)).detach().numpy().astype(np.float64)
        return (x - x.mean(1, keepdims=True)) / np.sqrt(x.var(1, keepdims=True) + 1e-5)

    before, after = phi(play.obs), phi(play.next_obs)
    predicted = dense(model.predictor, np.concatenate([before, np.eye(9)[play.actions.numpy()]], axis=1))
    logits = dense(model.inverse, np.concatenate([before, after], axis=1))
    p = np.exp(logits) / np.exp(logits).sum(1, keepdims=True)
    actions = play.actions.numpy()
    return 0.5 * ((predicted - after) ** 2).mean(1), -np.log(p[np.arange(5), actions]), p.argmax(1) == actions


def test_the_loss_is_the_papers_mixture_of_both_errors(make_images: MakeImages) -> None:
    model, play = icm(beta=0.3), steps(make_images)
    forward, inverse, named = plain_errors(model, play)
    expected = 0.7 * inverse.mean() + 0.3 * forward.mean()
    nothing = torch.Generator()
    features = model.features(play.obs, no_shifts(5))
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing).item(), expected, rtol=1e-4)
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing, features).item(), expected, rtol=1e-4)
    np.testing.assert_allclose(model.world_loss(play, nothing), expected, rtol=1e-4)
    figures = {name: value.item() for name, value in model.measure(play, no_shifts(5), nothing)[1].items()}
    means = {"forward": forward.mean(), "inverse": inverse.mean(), "inverse_accuracy": named.mean()}
    assert figures == pytest.approx(means, rel=1e-4)


def test_the_reward_is_the_forward_error_weighted_and_clipped(make_images: MakeImages) -> None:
    play = steps(make_images)
    model = icm(eta=0.01)
    forward, inverse, _ = plain_errors(model, play)
    assert model.error_parts == ("forward",)
    np.testing.assert_allclose(model.errors(play)["forward"].numpy(), 0.01 * forward, rtol=1e-3)
    eta = 1 / float(np.median(forward))  # then some errors exceed 1
    both = icm(eta=eta, eta_inverse=0.1)
    assert both.error_parts == ("forward", "inverse")
    found = both.errors(play)
    np.testing.assert_allclose(found["forward"].numpy(), np.minimum(eta * forward, 1), rtol=1e-3)
    np.testing.assert_allclose(found["inverse"].numpy(), 0.1 * inverse, rtol=1e-3)
    assert (found["forward"] == 1).any()


def test_both_images_of_a_step_are_shifted_alike(make_images: MakeImages) -> None:
    """Shifting the images beforehand, with the mean colour at the edge, gives the same as asking for the shift."""
    model, play = icm(), steps(make_images)
    model.encoder.set_mean_image(torch.full((1, 84, 84, 3), 90, dtype=torch.uint8))
    rolled = TransitionBatch(play.obs.roll((5, -4), (1, 2)), play.actions, play.next_obs.roll((5, -4), (1, 2)))
    given = torch.tensor([[5, -4]]).expand(5, 2)
    nothing = torch.Generator()
    expected = model.loss(rolled, no_shifts(5), nothing).item()
    np.testing.assert_allclose(model.loss(play, given, nothing).item(), expected, rtol=1e-4)
    assert abs(model.loss(play, no_shifts(5), nothing).item() - expected) > 1e-4


def test_the_latent_has_one_scale_whatever_the_features_have(make_images: MakeImages) -> None:
    model = icm()
    before = model.latent(make_images(3)).numpy()
    np.testing.assert_allclose(before.mean(1), 0, atol=1e-5)
    np.testing.assert_allclose(before.std(1), 1, rtol=1e-3)
    with torch.no_grad():
        for parameter in model.encoder.layers[7].parameters():
            parameter.mul_(10)
    np.testing.assert_allclose(model.latent(make_images(3)).numpy(), before, atol=1e-3)


def test_the_forward_error_trains_the_predictor_and_the_inverse_error_the_features(
    make_images: MakeImages,
) -> None:
    forward_only, play = icm(beta=1.0), steps(make_images)
    forward_only.loss(play, no_shifts(5), torch.Generator()).backward()
    assert all(parameter.grad.any() for parameter in forward_only.predictor.parameters() if parameter.grad is not None)
    assert not any(p.grad is not None and p.grad.any() for p in forward_only.encoder.parameters())
    inverse_only = icm(beta=0.0)
    inverse_only.loss(play, no_shifts(5), torch.Generator()).backward()
    assert all(p.grad is not None and p.grad.any() for p in inverse_only.encoder.parameters())
