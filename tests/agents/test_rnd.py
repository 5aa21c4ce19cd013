"""RND against plain NumPy."""

from collections.abc import Callable

import numpy as np
import torch

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import EncoderConfig, RndConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.rnd import Rnd
from gym_open.agents.world_model import TransitionBatch

MakeImages = Callable[..., torch.Tensor]


def rnd(clip: float = 5.0) -> Rnd:
    generator = torch.Generator().manual_seed(0)
    encoder = Encoder(EncoderConfig(features=32, pixel_scale=2.0), generator)
    return Rnd(encoder, RndConfig(hidden=16, outputs=24, clip=clip), 9, generator)


def steps(make_images: MakeImages) -> TransitionBatch:
    return TransitionBatch(make_images(5, 0), torch.zeros(5, dtype=torch.int64), make_images(5, 1))


def test_the_target_sees_pixels_in_running_deviations_clipped(make_images: MakeImages) -> None:
    model, seen = rnd(clip=1.5), make_images(20)
    for part in seen.split(7):
        model.watch(part)
    plain = seen.numpy().astype(np.float64)
    deviation = np.maximum(plain.std(axis=0), 1)  # a pixel that never changed counts as one grey level
    assert (plain.std(axis=0) == 0).any()
    assert (plain.std(axis=0) > 1).any()
    new = make_images(4, 7)
    expected = np.clip((new.numpy() - plain.mean(axis=0)) / deviation, -1.5, 1.5).transpose(0, 3, 1, 2)
    found = model.normalised(new, no_shifts(4)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert (np.abs(found) == 1.5).any()
    shifted = model.normalised(new, torch.tensor([[6, -9]]).expand(4, 2)).numpy()
    np.testing.assert_allclose(shifted[:, :, 6:, :-9], found[:, :, :-6, 9:], atol=1e-6)
    assert not shifted[:, :, :6].any()
    assert not shifted[:, :, :, -9:].any()


def test_the_statistics_do_not_depend_on_the_order(make_images: MakeImages) -> None:
    one, other, seen = rnd(), rnd(), make_images(30)
    one.watch(seen)
    for part in seen.flip(0).split(11):
        other.watch(part)
    new = make_images(2, 3)
    assert torch.equal(one.normalised(new, no_shifts(2)), other.normalised(new, no_shifts(2)))


def test_loss_and_reward_are_the_mean_square_error_to_the_target(make_images: MakeImages) -> None:
    model, play = rnd(), steps(make_images)
    model.watch(play.obs)

    def error(images: torch.Tensor) -> np.ndarray:
        with torch.no_grad():
            predicted = model.predictor(model.encoder(model.encoder.prepare(images))).numpy().astype(np.float64)
            target = model.target(model.normalised(images, no_shifts(5))).numpy()
        return ((predicted - target) ** 2).mean(axis=1)

    nothing, expected = torch.Generator(), error(play.obs).mean()
    features = model.features(play.obs, no_shifts(5))
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing).item(), expected, rtol=1e-4)
    np.testing.assert_allclose(model.loss(play, no_shifts(5), nothing, features).item(), expected, rtol=1e-4)
    np.testing.assert_allclose(model.world_loss(play, nothing), expected, rtol=1e-4)
    np.testing.assert_allclose(model.errors(play)["error"].numpy(), error(play.next_obs), rtol=1e-4)


def test_the_target_is_rnds_own_network() -> None:
    """Convolutions 8/4, 4/2, 3/1 with a LeakyReLU of 0.2 after each, and a linear layer, of orthogonal weights."""
    model = rnd()
    x = torch.randn(2, 3, 84, 84, generator=torch.Generator().manual_seed(1))
    out = x
    weights = list(model.target.parameters())
    for weight, bias, stride in zip(weights[0:6:2], weights[1:6:2], (4, 2, 1), strict=True):
        out = torch.nn.functional.conv2d(out, weight, bias, stride)
        out = torch.where(out > 0, out, 0.2 * out)
    expected = out.flatten(1) @ weights[6].T + weights[7]
    torch.testing.assert_close(model.target(x), expected, rtol=1e-4, atol=1e-5)
    assert [tuple(weight.shape) for weight in weights[::2]] == [
        (32, 3, 8, 8),
        (64, 32, 4, 4),
        (64, 64, 3, 3),
        (24, 3136),
    ]


def test_the_target_never_learns_and_the_encoder_does(make_images: MakeImages) -> None:
    model, play = rnd(), steps(make_images)
    model.loss(play, no_shifts(5), torch.Generator()).backward()
    assert all(not p.requires_grad and p.grad is None for p in model.target.parameters())
    assert all(p.grad is not None and p.grad.any() for p in model.encoder.parameters())
    assert all(p.grad is not None for p in model.predictor.parameters())


def test_the_latent_is_the_prediction(make_images: MakeImages) -> None:
    model, images = rnd(), make_images(3)
    with torch.no_grad():
        expected = model.predictor(model.encoder(model.encoder.prepare(images)))
    torch.testing.assert_close(model.latent(images), expected, rtol=1e-4, atol=1e-5)
