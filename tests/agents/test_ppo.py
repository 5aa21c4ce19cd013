"""PPO compared with plain NumPy, and on a problem that it must solve."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import Rollout, explained_variance, gae, policy_loss, ppo_update, value_loss
from gym_open.precision import native_precision

T, N = 7, 3


def random_rollout(seed: int, shape: tuple[int, ...] = (1,)) -> Rollout:
    rng = np.random.default_rng(seed)
    numbers = (torch.from_numpy(rng.normal(size=(T, N)).astype(np.float32)) for _ in range(4))
    logprobs, rewards, values, next_values = numbers
    ends = rng.random((T, N))
    return replace(
        Rollout.empty(T, N, shape, torch.uint8),
        logprobs=logprobs, rewards=rewards, values=values, next_values=next_values,
        terminations=torch.from_numpy(ends < 0.2), truncations=torch.from_numpy(ends > 0.8),
    )  # fmt: skip


def advantage_by_sum(rollout: Rollout, gamma: float, lam: float, t: int, n: int) -> float:
    """By definition: the sum of (γλ)^k δ over the later steps of the episode."""
    total = 0.0
    for k in range(T - t):
        reward, value = rollout.rewards[t + k, n].item(), rollout.values[t + k, n].item()
        future = 0.0 if rollout.terminations[t + k, n] else rollout.next_values[t + k, n].item()
        total += (gamma * lam) ** k * (reward + gamma * future - value)
        if rollout.terminations[t + k, n] or rollout.truncations[t + k, n]:
            break
    return total


@pytest.mark.parametrize("seed", range(5))
def test_gae_is_its_definition(seed: int) -> None:
    rollout = random_rollout(seed)
    expected = [[advantage_by_sum(rollout, 0.9, 0.8, t, n) for n in range(N)] for t in range(T)]
    np.testing.assert_allclose(gae(rollout, 0.9, 0.8).numpy(), expected, atol=1e-5)


@pytest.mark.parametrize(("ended", "expected"), [("terminations", 1.0 - 5.0), ("truncations", 1.0 + 0.9 * 10.0 - 5.0)])
def test_only_a_truncated_step_bootstraps(ended: str, expected: float) -> None:
    rollout = Rollout.empty(2, 1, (1,), torch.uint8)
    rollout.rewards[:], rollout.values[:], rollout.next_values[:] = 1.0, 5.0, 10.0
    getattr(rollout, ended)[0] = True
    np.testing.assert_allclose(gae(rollout, 0.9, 0.95)[0].item(), expected, rtol=1e-6)


def test_gae_of_a_constant_reward_in_closed_form() -> None:
    """With value 0, λ = 1 and no end before T, the advantage is the discounted sum of the remaining rewards."""
    rollout = Rollout.empty(T, 1, (1,), torch.uint8)
    rollout.rewards[:] = 1.0
    expected = [(1 - 0.9 ** (T - t)) / (1 - 0.9) for t in range(T)]
    np.testing.assert_allclose(gae(rollout, 0.9, 1.0)[:, 0].numpy(), expected, rtol=1e-5)


def test_policy_loss_is_the_clipped_objective() -> None:
    rng = np.random.default_rng(0)
    logratio, A = rng.normal(size=50) * 0.5, rng.normal(size=50)
    ratio = np.exp(logratio)
    expected = -np.minimum(A * ratio, A * np.clip(ratio, 0.8, 1.2)).mean()
    np.testing.assert_allclose(policy_loss(torch.from_numpy(logratio), torch.from_numpy(A), 0.2).item(), expected)


@pytest.mark.parametrize(
    ("logratio", "advantage", "flows"), [(0.5, 1.0, False), (0.5, -1.0, True), (-0.5, -1.0, False)]
)
def test_no_gradient_beyond_the_clip(logratio: float, advantage: float, flows: bool) -> None:
    x = torch.tensor([logratio], requires_grad=True)
    policy_loss(x, torch.tensor([advantage]), 0.2).backward()
    assert x.grad is not None
    assert (x.grad.item() != 0) is flows


@pytest.mark.parametrize("clip", [None, 0.2])
def test_value_loss(clip: float | None) -> None:
    rng = np.random.default_rng(1)
    new, old, returns = rng.normal(size=(3, 40))
    squares = (new - returns) ** 2
    if clip:
        squares = np.maximum(squares, (np.clip(new, old - clip, old + clip) - returns) ** 2)
    found = value_loss(*(torch.from_numpy(a) for a in (new, old, returns)), clip_coef=clip)
    np.testing.assert_allclose(found.item(), squares.mean() / 2)


def test_explained_variance() -> None:
    returns = torch.tensor([1.0, 2.0, 3.0, 4.0])
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(torch.zeros(4), returns) == 0.0
    assert math.isnan(explained_variance(returns, torch.ones(4)))


def agent(seed: int = 0, n_actions: int = 4) -> ActorCritic:
    generator = torch.Generator().manual_seed(seed)
    return ActorCritic(Encoder(EncoderConfig(features=32, pixel_scale=1.0), generator), n_actions, generator)


def test_log_probability_and_entropy_are_those_of_the_distribution() -> None:
    net = agent()
    prepared = torch.randn(6, 3, 84, 84, generator=torch.Generator().manual_seed(0)) * 5
    logits, values = net(prepared)
    action, logprob, entropy, value = net.get_action_and_value(prepared, generator=torch.Generator().manual_seed(0))
    plain = logits.detach().numpy().astype(np.float64)
    p = np.exp(plain) / np.exp(plain).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(logprob.detach().numpy(), np.log(p[np.arange(6), action.numpy()]), atol=1e-5)
    np.testing.assert_allclose(entropy.detach().numpy(), -(p * np.log(p)).sum(axis=1), atol=1e-5)
    assert torch.equal(value, values)
    assert torch.equal(value, net.get_value(prepared))


def test_actions_follow_the_probabilities() -> None:
    net = agent()
    with torch.no_grad():
        net.actor.weight.zero_()
        assert isinstance(net.actor, torch.nn.Linear)
        net.actor.bias.copy_(torch.tensor([0.1, 0.2, 0.3, 0.4]).log())
    generator = torch.Generator().manual_seed(0)
    prepared = torch.zeros(500, 3, 84, 84)
    drawn = torch.cat([net.get_action_and_value(prepared, generator=generator)[0] for _ in range(4)])
    shares = np.bincount(drawn.numpy(), minlength=4) / 2000
    np.testing.assert_allclose(shares, [0.1, 0.2, 0.3, 0.4], atol=0.04)


def test_sampling_needs_a_generator() -> None:
    with pytest.raises(ValueError, match="generator must be given"):
        agent().get_action_and_value(torch.zeros(1, 3, 84, 84))


def squares(which: torch.Tensor) -> torch.Tensor:
    """Images with a bright square in one of four corners."""
    images = torch.zeros(*which.shape, 84, 84, 3, dtype=torch.uint8)
    for index in np.ndindex(*which.shape):
        row, column = divmod(int(which[index]), 2)
        images[index][10 + 40 * row : 30 + 40 * row, 10 + 40 * column : 30 + 40 * column] = 255
    return images


def bandit_rollout(net: ActorCritic, generator: torch.Generator, n_steps: int = 8, n_envs: int = 8) -> Rollout:
    """One-step episodes: the reward is 1 if the action names the square's corner."""
    where = torch.randint(4, (n_steps, n_envs), generator=generator)
    rollout = Rollout.empty(n_steps, n_envs, (84, 84, 3), torch.uint8)
    rollout.obs[:] = squares(where)
    with torch.no_grad():
        prepared = net.encoder.prepare(rollout.obs.flatten(0, 1))
        action, logprob, _, value = net.get_action_and_value(prepared, generator=generator)
    for room, found in ((rollout.actions, action), (rollout.logprobs, logprob), (rollout.values, value)):
        room.copy_(found.view(n_steps, n_envs))
    rollout.rewards[:] = (rollout.actions == where).float()
    rollout.terminations[:] = True
    return rollout


def train_bandit(updates: int, config: PPOConfig) -> tuple[ActorCritic, list[float]]:
    torch.set_num_threads(1)
    net = agent()
    optimizer = torch.optim.Adam(net.parameters(), lr=config.learning_rate, eps=1e-5)
    acting, updating = (torch.Generator().manual_seed(seed) for seed in (1, 2))
    shares = []
    for _ in range(updates):
        rollout = bandit_rollout(net, acting)
        shares.append(rollout.rewards.mean().item())
        ppo_update(net, optimizer, rollout, config, updating)
    return net, shares


QUICK = PPOConfig(learning_rate=1.5e-3, minibatch_size=32, update_epochs=2, shift_pad=2, precision="fp32")


EMULATED = () if native_precision() == "bf16" else pytest.mark.slow


@pytest.mark.learning
@pytest.mark.parametrize("precision", ["fp32", pytest.param("bf16", marks=EMULATED)])
def test_ppo_solves_a_trivial_problem(precision: str) -> None:
    _, shares = train_bandit(12, msgspec.structs.replace(QUICK, precision=precision))
    assert shares[0] < 0.5
    assert shares[-1] > 0.9


def test_update_is_repeatable_bit_for_bit() -> None:
    (a, first), (b, second) = train_bandit(3, QUICK), train_bandit(3, QUICK)
    assert first == second
    assert all(torch.equal(x, y) for x, y in zip(a.parameters(), b.parameters(), strict=True))


def test_statistics_of_the_first_minibatch() -> None:
    """One minibatch, no shift: the ratio is 1, so KL and clip fraction are 0 and the policy loss is −mean(A) = 0."""
    net, generator = agent(), torch.Generator().manual_seed(0)
    rollout = bandit_rollout(net, generator)
    config = PPOConfig(minibatch_size=1000, update_epochs=1, shift_pad=0, precision="fp32")
    stats = ppo_update(net, torch.optim.Adam(net.parameters(), lr=1e-3), rollout, config, generator)
    assert abs(stats.approx_kl) < 1e-6
    assert stats.clip_fraction == 0
    assert abs(stats.policy_loss) < 1e-5
    np.testing.assert_allclose(stats.entropy, math.log(4), atol=1e-2)
    expected = 0.5 * ((rollout.rewards - rollout.values) ** 2).mean().item()
    np.testing.assert_allclose(stats.value_loss, expected, rtol=1e-4)


def test_target_kl_stops_the_update() -> None:
    def epochs_until(target: float | None) -> int:
        net, generator = agent(), torch.Generator().manual_seed(0)
        rollout = bandit_rollout(net, generator)
        optimizer = torch.optim.Adam(net.parameters(), lr=1e-2)
        config = PPOConfig(minibatch_size=1000, update_epochs=4, target_kl=target, precision="fp32")
        ppo_update(net, optimizer, rollout, config, generator)
        return int(optimizer.state_dict()["state"][0]["step"])

    assert epochs_until(None) == 4
    assert epochs_until(1e-4) == 2


def test_gradient_is_clipped() -> None:
    net, generator = agent(), torch.Generator().manual_seed(0)
    rollout = bandit_rollout(net, generator)
    before = [p.detach().clone() for p in net.parameters()]
    config = PPOConfig(minibatch_size=1000, update_epochs=1, max_grad_norm=1e-3, precision="fp32")
    ppo_update(net, torch.optim.SGD(net.parameters(), lr=1.0), rollout, config, generator)
    moved = math.sqrt(sum(((p - q) ** 2).sum().item() for p, q in zip(net.parameters(), before, strict=True)))
    np.testing.assert_allclose(moved, 1e-3, rtol=1e-2)
