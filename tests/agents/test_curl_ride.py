"""CURL and RIDE against plain NumPy."""

import numpy as np
import torch

from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.agents.curl import Curl, contrastive_accuracy, info_nce
from gym_open.agents.encoder import Encoder
from gym_open.agents.ride import ride_reward


def curl(seed: int = 0, pad: int = 4) -> Curl:
    generator = torch.Generator().manual_seed(seed)
    return Curl(
        Encoder(EncoderConfig(features=32, pixel_scale=2.0), generator),
        CurlConfig(latent=8, pad=pad, tau=0.05),
        generator,
    )


def pictures(n: int) -> torch.Tensor:
    """Pictures that differ by where a bright square is."""
    images = torch.zeros(n, 84, 84, 3, dtype=torch.uint8)
    for i in range(n):
        row, column = 8 + 20 * (i % 4), 8 + 20 * (i // 4 % 4)
        images[i, row : row + 10, column : column + 10] = 255
    return images


def test_info_nce_is_the_log_share_of_the_partner() -> None:
    logits = np.random.default_rng(0).normal(size=(6, 6)) * 3
    expected = -np.mean([np.log(np.exp(logits[i, i]) / np.exp(logits[i]).sum()) for i in range(6)])
    np.testing.assert_allclose(info_nce(torch.from_numpy(logits)).item(), expected, rtol=1e-5)


def test_info_nce_closed_forms() -> None:
    np.testing.assert_allclose(info_nce(torch.zeros(16, 16)).item(), np.log(16), rtol=1e-6)
    assert info_nce(100 * torch.eye(4)).item() < 1e-6


def test_accuracy_counts_partners_that_win() -> None:
    logits = torch.tensor([[2.0, 1, 0], [3, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(contrastive_accuracy(logits).item(), 2 / 3, rtol=1e-6)


def test_logits_are_bilinear_less_the_row_maximum() -> None:
    model, images = curl(pad=0), pictures(5)
    z = model.latent(images).numpy()  # before any learning the key network is the query network
    raw = z @ model.W.detach().numpy() @ z.T
    found = model.logits(images, torch.Generator()).detach().numpy()
    np.testing.assert_allclose(found, raw - raw.max(axis=1, keepdims=True), atol=1e-4)


def test_latent_is_layer_normalised() -> None:
    z = curl().latent(pictures(3)).numpy()
    np.testing.assert_allclose(z.mean(axis=1), 0, atol=1e-5)
    np.testing.assert_allclose(z.std(axis=1), 1, atol=1e-2)


def test_key_moves_by_tau_and_only_by_update_key() -> None:
    model = curl()
    before = [parameter.clone() for parameter in model.key.parameters()]
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-2)
    model.loss(pictures(8), torch.Generator().manual_seed(0)).backward()
    optimizer.step()
    assert all(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))
    model.update_key()
    query = [*model.encoder.layers.parameters(), *model.projection.parameters()]
    for old, new, fast in zip(before, model.key.parameters(), query, strict=True):
        expected = 0.95 * old.numpy() + 0.05 * fast.detach().numpy()
        np.testing.assert_allclose(new.numpy(), expected, atol=1e-6)
    assert not any(torch.equal(a, b) for a, b in zip(before, model.key.parameters(), strict=True))


def test_key_network_gets_no_gradient_and_encoder_does() -> None:
    model = curl()
    model.loss(pictures(8), torch.Generator().manual_seed(0)).backward()
    assert all(parameter.grad is None for parameter in model.key.parameters())
    assert all(parameter.grad is not None for parameter in model.encoder.parameters())


def test_curl_learns_to_tell_pictures_apart() -> None:
    torch.set_num_threads(1)
    model, images, generator = curl(), pictures(16), torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-3)
    first = model.loss(images, generator).item()
    for _ in range(120):
        loss = model.loss(images, generator)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        model.update_key()
    logits = model.logits(images, generator)
    assert info_nce(logits).item() < 0.5 * first
    assert contrastive_accuracy(logits).item() > 0.5  # chance is 1/16


def test_ride_is_the_euclidean_distance() -> None:
    a, b = torch.tensor([[0.0, 0.0], [1.0, 1.0]]), torch.tensor([[3.0, 4.0], [1.0, 1.0]])
    assert ride_reward(a, b).tolist() == [5.0, 0.0]
