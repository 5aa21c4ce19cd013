"""The explorer's update, compared with an independent computation: advantages, loss, clipped gradient, Adam's step."""

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gym_open.agents.augment import no_shifts
from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerConfig, IcmConfig, PPOConfig, WorldModelName
from gym_open.agents.curl import Curl
from gym_open.agents.explorer import Acted, Explorer
from gym_open.agents.world_model import TransitionBatch
from gym_open.errors import DivergedError

MakeImages = Callable[..., Tensor]
T, N = 8, 2


def explorer(ppo: PPOConfig, world_model: WorldModelName = "icm", *, share: bool = True) -> Explorer:
    config = ExplorerConfig(
        world_model=world_model, share_encoder=share, encoder=EncoderConfig(features=8), icm=IcmConfig(hidden=8),
        curl=CurlConfig(latent=4, pad=2, tau=0.3, update_every=3), ppo=ppo,
    )  # fmt: skip
    return Explorer(config, n_actions=9, n_streams=N, seed=0)


def vector(parameters: Iterable[Tensor]) -> Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in parameters])


def learned_parameters(one: Explorer) -> list[Tensor]:
    assert one.optimizer is not None
    return one.optimizer.param_groups[0]["params"]


@pytest.fixture
def seen(make_images: MakeImages) -> Tensor:
    """Observations around 8 steps in 2 worlds."""
    return torch.stack([make_images(N, seed) for seed in range(T + 1)])


@pytest.fixture
def acted() -> list[Acted]:
    """Steps of another policy than the one that learns from them, so that ratios and values exceed their clips."""
    rng = np.random.default_rng(0)

    def numbers(mean: float) -> Tensor:
        return torch.from_numpy(rng.normal(mean, 0.5, N).astype(np.float32))

    return [Acted(torch.from_numpy(rng.integers(0, 9, N)), numbers(-2.2), numbers(1), numbers(0)) for _ in range(T + 1)]


def plain_advantages(rewards: np.ndarray, values: np.ndarray, gamma: float, lam: float) -> np.ndarray:
    """By definition: Σ_k (γλ)^k δ_{t+k}, with the value after the last step (there is one more value)."""
    delta = rewards + gamma * values[1:] - values[:-1]
    return np.stack([sum((gamma * lam) ** k * delta[t + k] for k in range(T - t)) for t in range(T)])


def plain_scale(rewards: np.ndarray, gamma: float) -> np.ndarray:
    """Rewards divided by the standard deviation of their discounted sums so far."""
    sums = [sum(gamma**k * rewards[t - k] for k in range(t + 1)) for t in range(T)]
    return rewards / np.std(sums)


def written_out_loss(
    one: Explorer, seen: Tensor, acted: list[Acted], rewards: np.ndarray, plain: bool
) -> tuple[Tensor, list[float]]:
    """The whole loss, and its statistics; coefficients are those of the test below."""
    assert one.policy is not None
    assert one.model is not None
    actions = torch.stack([a.actions for a in acted[:-1]]).flatten()
    logprobs = torch.stack([a.logprobs for a in acted[:-1]]).flatten()
    values = torch.stack([a.values for a in acted]).double().numpy()
    advantages = plain_advantages(plain_scale(rewards, 0.9), values, 0.9, 0.7)
    old, returns = (torch.from_numpy(x).flatten() for x in (values[:-1], advantages + values[:-1]))
    if not plain:
        advantages = (advantages - advantages.mean()) / advantages.std(ddof=1)
    weight = torch.from_numpy(advantages).flatten()

    logits, value = one.policy(one.policy.encoder.prepare(seen[:-1].flatten(0, 1)))
    policy = torch.distributions.Categorical(logits=logits)
    ratio = (policy.log_prob(actions) - logprobs).exp()
    policy_loss = -torch.minimum(ratio * weight, ratio.clamp(0.8, 1.2) * weight).mean()
    squares = (value - returns) ** 2
    if not plain:
        squares = torch.maximum(squares, (old + (value - old).clamp(-0.2, 0.2) - returns) ** 2)
    value_loss, entropy = squares.mean() / 2, policy.entropy().mean()
    play = TransitionBatch(seen[:-1].flatten(0, 1), actions, seen[1:].flatten(0, 1))
    model_loss = one.model.loss(play, no_shifts(T * N), torch.Generator())
    figures = [model_loss, policy_loss, value_loss, entropy, (ratio - 1 - ratio.log()).mean()]
    return policy_loss + 0.4 * value_loss - 0.6 * entropy + model_loss, [figure.item() for figure in figures]


@pytest.mark.parametrize("plain", [False, True])
def test_one_gradient_step_is_that_of_the_loss_written_out(seen: Tensor, acted: list[Acted], plain: bool) -> None:
    """`plain`: no shared encoder, no scaled advantages, no clipped change of the value."""
    ppo = PPOConfig(
        learning_rate=1e-2, gamma=0.9, gae_lambda=0.7, minibatch_size=T * N, update_epochs=1, shift_pad=0,
        precision="fp32", ent_coef=0.6, vf_coef=0.4, max_grad_norm=1e-3, norm_adv=not plain, clip_vloss=not plain,
    )  # fmt: skip
    one, twin = (explorer(ppo, share=not plain) for _ in range(2))
    for each in (one, twin):
        assert each.policy is not None
        nn.init.normal_(each.policy.actor.weight, std=0.3, generator=torch.Generator().manual_seed(1))
    learned = one.learn(seen, acted)
    loss, figures = written_out_loss(twin, seen, acted, learned.reward.double().numpy(), plain)
    np.testing.assert_allclose([*vars(learned.stats).values()], figures, rtol=1e-4, atol=1e-5)

    parameters, before = learned_parameters(twin), learned_parameters(explorer(ppo, share=not plain))
    loss.backward()
    gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
    norm = math.sqrt(sum(float(gradient.double().square().sum()) for gradient in gradients))
    assert norm > 0.1  # the clip is at 0.001, where Adam's epsilon lets the size of a gradient matter
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient * (1e-3 / norm)
    torch.optim.Adam(parameters, lr=1e-2, eps=1e-5).step()
    for found, expected in zip(learned_parameters(one), parameters, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=2e-5)
    steps = [float((p - q).detach().abs().max()) for p, q in zip(parameters, before, strict=True)]
    assert np.median(steps) > 1e-3  # far above the tolerance


def test_key_of_curl_follows_the_query_at_every_third_gradient_step(seen: Tensor, acted: list[Acted]) -> None:
    """Two epochs of four minibatches: it moves after the third and the sixth of eight steps."""
    one = explorer(PPOConfig(minibatch_size=4, update_epochs=2, shift_pad=2, precision="fp32"), "curl")
    assert isinstance(one.model, Curl)
    assert one.optimizer is not None
    model = one.model
    slow = vector(model.key.parameters())
    queries: list[Tensor] = []

    def query(*_: object) -> None:
        fast = [*model.encoder.layers.parameters(), *model.projection.parameters()]
        queries.append(vector(fast))

    one.optimizer.register_step_post_hook(query)
    one.learn(seen, acted)
    assert len(queries) == 8
    for fast in (queries[2], queries[5]):
        slow = 0.7 * slow + 0.3 * fast
    torch.testing.assert_close(vector(model.key.parameters()), slow, rtol=1e-5, atol=1e-6)


def test_target_kl_stops_the_update(seen: Tensor) -> None:
    def epochs_until(target: float | None) -> int:
        ppo = PPOConfig(
            learning_rate=1e-2, minibatch_size=1000, update_epochs=4, shift_pad=0, target_kl=target, precision="fp32"
        )
        one = explorer(ppo)
        one.learn(seen, [one.act(images) for images in seen])
        assert one.optimizer is not None
        return int(one.optimizer.state_dict()["state"][0]["step"])

    assert epochs_until(None) == 4
    assert epochs_until(1e-4) == 2  # in the first epoch, the policy is the one that acted


def test_numbers_that_are_no_longer_finite_are_an_error(seen: Tensor, acted: list[Acted]) -> None:
    one = explorer(PPOConfig(precision="fp32"))
    assert one.policy is not None
    assert one.model is not None
    play = TransitionBatch(seen[:-1].flatten(0, 1), torch.zeros(T * N, dtype=torch.int64), seen[1:].flatten(0, 1))
    with torch.no_grad():
        assert isinstance(one.policy.actor, torch.nn.Linear)
        one.policy.actor.bias[3] = math.nan
    with pytest.raises(DivergedError, match="the policy's probabilities are not finite"):
        one.act(seen[0])
    with torch.no_grad():
        for parameter in one.model.encoder.parameters():
            parameter.fill_(math.inf)
    for diverged in (lambda: one.learn(seen, acted), lambda: one.world_loss(play, torch.Generator())):
        with pytest.raises(DivergedError, match="the world model's loss is not finite"):
            diverged()
