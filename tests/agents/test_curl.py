"""CURL against plain NumPy."""

from collections.abc import Callable

import numpy as np
import torch

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.agents.curl import Curl, contrastive_accuracy, info_nce
from gym_open.agents.encoder import Encoder
from gym_open.agents.world_model import Transitions

Pictures = Callable[..., torch.Tensor]


def curl(seed: int = 0, pad: int = 4) -> Curl:
    generator = torch.Generator().manual_seed(seed)
    encoder = Encoder(EncoderConfig(features=32, pixel_scale=2.0), generator)
    return Curl(encoder, CurlConfig(latent=8, pad=pad, tau=0.05), generator)


def steps(images: torch.Tensor) -> Transitions:
    return Transitions(images, torch.zeros(len(images), dtype=torch.int64), images.flip(0))


def plain_info_nce(logits: np.ndarray) -> np.ndarray:
    return -np.array([np.log(np.exp(row[i]) / np.exp(row).sum()) for i, row in enumerate(logits.astype(np.float64))])


def test_info_nce_is_the_log_share_of_the_partner() -> None:
    logits = np.random.default_rng(0).normal(size=(6, 6)) * 3
    np.testing.assert_allclose(info_nce(torch.from_numpy(logits)).item(), plain_info_nce(logits).mean(), rtol=1e-5)


def test_info_nce_closed_forms() -> None:
    np.testing.assert_allclose(info_nce(torch.zeros(16, 16)).item(), np.log(16), rtol=1e-6)
    assert info_nce(100 * torch.eye(4)).item() < 1e-6


def test_accuracy_counts_partners_that_win() -> None:
    logits = torch.tensor([[2.0, 1, 0], [3, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(contrastive_accuracy(logits).item(), 2 / 3, rtol=1e-6)


def test_logits_are_bilinear_less_the_row_maximum(pictures: Pictures) -> None:
    model, images = curl(pad=0), pictures(5)
    z = model.latent(images).numpy()  # before any learning the key network is the query network
    raw = z @ model.W.detach().numpy() @ z.T
    found = model.logits(images, torch.Generator()).detach().numpy()
    np.testing.assert_allclose(found, raw - raw.max(axis=1, keepdims=True), atol=1e-4)


def test_loss_world_loss_and_errors_are_info_nce_of_the_right_pictures(pictures: Pictures) -> None:
    """Without shifts, all three can be computed from the latents."""
    model, images = curl(pad=0), pictures(5)
    z = model.latent(images).numpy()
    expected = plain_info_nce(z @ model.W.detach().numpy() @ z.T)
    play, nothing = steps(images), torch.Generator()
    features = model.features(images, no_shifts(5))
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing).item(), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing, features).item(), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.world_loss(play, nothing), expected.mean(), rtol=1e-4)
    np.testing.assert_allclose(model.errors(play)["error"].numpy(), expected[::-1], rtol=1e-3, atol=1e-5)


def test_the_loss_compares_the_given_shift_with_a_drawn_one(pictures: Pictures) -> None:
    model, images = curl(pad=6), pictures(8)
    given = torch.randint(-6, 7, (8, 2), generator=torch.Generator().manual_seed(3))
    drawn = torch.randint(-6, 7, (8, 2), generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        query = model.projection(model.features(images, given)).numpy()
        keys = model.key(model.encoder.prepare_shifted(images, drawn)).numpy()
    expected = plain_info_nce(query @ model.W.detach().numpy() @ keys.T).mean()
    found = model.loss(steps(images), given, torch.Generator().manual_seed(5)).item()
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_latent_is_layer_normalised(pictures: Pictures) -> None:
    z = curl().latent(pictures(3)).numpy()
    np.testing.assert_allclose(z.mean(axis=1), 0, atol=1e-5)
    np.testing.assert_allclose(z.std(axis=1), 1, atol=1e-2)


def test_key_moves_by_tau_every_second_step_and_never_otherwise(pictures: Pictures) -> None:
    model = curl()
    before = [parameter.clone() for parameter in model.key.parameters()]
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-2)
    model.loss(steps(pictures(8)), no_shifts(8), torch.Generator().manual_seed(0)).backward()
    optimizer.step()
    model.stepped()
    assert all(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))
    model.stepped()
    query = [*model.encoder.layers.parameters(), *model.projection.parameters()]
    for old, new, fast in zip(before, model.key.parameters(), query, strict=True):
        expected = 0.95 * old.numpy() + 0.05 * fast.detach().numpy()
        np.testing.assert_allclose(new.numpy(), expected, atol=1e-6)
    assert not any(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))


def test_key_network_gets_no_gradient_and_encoder_does(pictures: Pictures) -> None:
    model = curl()
    model.loss(steps(pictures(8)), no_shifts(8), torch.Generator().manual_seed(0)).backward()
    assert all(parameter.grad is None for parameter in model.key.parameters())
    assert all(parameter.grad is not None for parameter in model.encoder.parameters())


def test_curl_learns_to_tell_pictures_apart(pictures: Pictures) -> None:
    model, images, generator = curl(), pictures(16), torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-3)
    first = info_nce(model.logits(images, generator)).item()
    for _ in range(150):
        loss = info_nce(model.logits(images, generator))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        model.stepped()
    logits = model.logits(images, generator)
    assert info_nce(logits).item() < 0.6 * first
    assert contrastive_accuracy(logits).item() > 0.5  # chance is 1/16
