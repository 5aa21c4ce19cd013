"""CURL against plain NumPy."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from gym_open.agents.augment import draw_shifts, no_shifts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.agents.curl import Curl
from gym_open.agents.encoder import Encoder
from gym_open.agents.world_model import TransitionBatch

MakeImages = Callable[..., torch.Tensor]


def curl(seed: int = 0, pad: int = 4) -> Curl:
    generator = torch.Generator().manual_seed(seed)
    encoder = Encoder(EncoderConfig(features=32, pixel_scale=2.0), generator)
    return Curl(encoder, CurlConfig(latent=8, pad=pad, tau=0.05), 9, generator)


def steps(images: torch.Tensor) -> TransitionBatch:
    return TransitionBatch(images, torch.zeros(len(images), dtype=torch.int64), images.flip(0))


def plain_info_nce(logits: np.ndarray) -> np.ndarray:
    """Log probability of each query's own key."""
    return -np.array([np.log(np.exp(row[i]) / np.exp(row).sum()) for i, row in enumerate(logits.astype(np.float64))])


def test_loss_world_loss_and_errors_are_info_nce_of_the_right_images(make_images: MakeImages) -> None:
    """Without shifts, all three can be computed from the latents."""
    model, images = curl(pad=0), make_images(5)
    z = model.latent(images).numpy()
    expected = plain_info_nce(z @ model.W.detach().numpy() @ z.T)
    play, nothing = steps(images), torch.Generator()
    features = model.features(images, no_shifts(5))
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing).item(), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing, features).item(), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.world_loss(play, nothing), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.errors(play)["error"].numpy(), expected[::-1], rtol=1e-3, atol=1e-5)


def test_the_loss_compares_the_given_shift_with_a_drawn_one(make_images: MakeImages) -> None:
    model, images = curl(pad=6), make_images(8)
    torch.nn.init.eye_(model.W)  # so that some images are distinguished before any learning, and others not
    given = torch.randint(-6, 7, (8, 2), generator=torch.Generator().manual_seed(3))
    drawn = torch.randint(-6, 7, (8, 2), generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        query = model.projection(model.features(images, given)).numpy()
        keys = model.key(model.encoder.prepare_shifted(images, drawn)).numpy()
    logits = query @ model.W.detach().numpy() @ keys.T
    loss, figures = model.measure(steps(images), given, torch.Generator().manual_seed(5))
    np.testing.assert_allclose(loss.item(), plain_info_nce(logits).mean(), rtol=1e-4)
    accuracy = np.mean([row.argmax() == i for i, row in enumerate(logits)])
    assert 0 < accuracy < 1
    np.testing.assert_allclose(figures["accuracy"].item(), accuracy, rtol=1e-6)


def test_latent_is_layer_normalised(make_images: MakeImages) -> None:
    z = curl().latent(make_images(3)).numpy()
    np.testing.assert_allclose(z.mean(axis=1), 0, atol=1e-5)
    np.testing.assert_allclose(z.std(axis=1), 1, atol=1e-2)


def test_key_moves_by_tau_every_second_step_and_never_otherwise(make_images: MakeImages) -> None:
    model = curl()
    before = [parameter.clone() for parameter in model.key.parameters()]
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-2)
    model.loss(steps(make_images(8)), no_shifts(8), torch.Generator().manual_seed(0)).backward()
    optimizer.step()
    model.stepped()
    assert all(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))
    model.stepped()
    query = [*model.encoder.layers.parameters(), *model.projection.parameters()]
    for old, new, fast in zip(before, model.key.parameters(), query, strict=True):
        expected = 0.95 * old.numpy() + 0.05 * fast.detach().numpy()
        np.testing.assert_allclose(new.numpy(), expected, atol=1e-6)
    assert not any(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))


def test_key_network_gets_no_gradient_and_encoder_does(make_images: MakeImages) -> None:
    model = curl()
    model.loss(steps(make_images(8)), no_shifts(8), torch.Generator().manual_seed(0)).backward()
    assert all(parameter.grad is None for parameter in model.key.parameters())
    assert all(parameter.grad is not None for parameter in model.encoder.parameters())


@pytest.mark.learning
def test_curl_learns_to_tell_images_apart(make_images: MakeImages) -> None:
    model, images, generator = curl(), make_images(16), torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-3)

    def measured() -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        shifts = draw_shifts(16, 4, generator)
        return model.measure(steps(images), shifts, generator)

    first = measured()[0].item()
    for _ in range(150):
        loss, _ = measured()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        model.stepped()
    loss, figures = measured()
    assert loss.item() < 0.6 * first
    assert figures["accuracy"].item() > 0.5  # chance is 1/16
