"""The explorer: its reward is impact, its world model learns, its encoder is one, and its state comes back whole."""

import copy
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerKind, PPOConfig
from gym_open.agents.explorer import Explorer, RewardScale
from gym_open.agents.ppo import Rollout

PPO = PPOConfig(learning_rate=1e-3, minibatch_size=16, update_epochs=1, shift_pad=2, precision="fp32")


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def explorer(kind: ExplorerKind = "curl+ride", seed: int = 0) -> Explorer:
    return Explorer(
        kind, EncoderConfig(features=32), CurlConfig(latent=8, pad=2), PPO, n_actions=9, n_streams=2, seed=seed
    )


def pictures(count: int, seed: int = 0) -> Tensor:
    """A bright square at another place in every picture."""
    rng = np.random.default_rng(seed)
    images = np.full((count, 84, 84, 3), 90, np.uint8)
    for image in images:
        row, column = rng.integers(10, 60, 2)
        image[row : row + 12, column : column + 12] = rng.integers(0, 256, 3)
    return torch.from_numpy(images)


def play(one: Explorer, n_steps: int = 8) -> Rollout:
    images = torch.stack([pictures(2, seed) for seed in range(n_steps + 1)])
    acted = [one.act(image) for image in images]
    latent, values = torch.stack([a.latent for a in acted]), torch.stack([a.values for a in acted])
    nothing = torch.zeros(n_steps, 2, dtype=torch.bool)
    actions = torch.stack([a.actions for a in acted[:-1]])
    logprobs = torch.stack([a.logprobs for a in acted[:-1]])
    rewards = one.intrinsic_reward(latent[:-1], latent[1:])
    return Rollout(images[:-1], actions, logprobs, rewards, values[:-1], values[1:], nothing, nothing)


def test_no_change_is_no_reward() -> None:
    one = explorer()
    latent = one.act(pictures(3)).latent
    assert torch.equal(one.intrinsic_reward(latent, latent), torch.zeros(3))


def test_the_reward_is_the_distance_in_the_world_models_latent() -> None:
    one = explorer()
    before, after = pictures(3, 0), pictures(3, 1)
    found = one.intrinsic_reward(one.act(before).latent, one.act(after).latent)
    difference = (one.curl.latent(after) - one.curl.latent(before)).numpy()
    np.testing.assert_allclose(found.numpy(), np.sqrt((difference**2).sum(axis=1)), rtol=1e-5)
    assert (found > 0).all()


def test_policy_and_world_model_share_one_encoder_and_one_optimiser() -> None:
    one = explorer()
    assert one.policy.encoder is one.curl.encoder is one.encoder
    held = [id(parameter) for group in one.optimizer.param_groups for parameter in group["params"]]
    wanted = {id(p) for module in (one.policy, one.curl) for p in module.parameters() if p.requires_grad}
    assert len(held) == len(set(held))
    assert set(held) == wanted


def test_actions_follow_the_policy_and_figures_are_its_own() -> None:
    one = explorer()
    images = pictures(1).expand(4000, -1, -1, -1)[:, :, :, :]
    with torch.no_grad():
        one.policy.actor.bias.copy_(torch.linspace(-1, 1, 9))
        logits, values = one.policy(one.encoder.prepare(images[:1]))
    acted = one.act(images)
    p = np.exp(logits.numpy()[0]) / np.exp(logits.numpy()[0]).sum()
    np.testing.assert_allclose(np.bincount(acted.actions, minlength=9) / 4000, p, atol=4 * np.sqrt(0.25 / 4000))
    np.testing.assert_allclose(acted.logprobs.numpy(), np.log(p)[acted.actions.numpy()], rtol=1e-4)
    np.testing.assert_allclose(acted.entropy[0].item(), -(p * np.log(p)).sum(), rtol=1e-4)
    np.testing.assert_allclose(acted.values[0].item(), values.item(), rtol=1e-4)


def test_the_world_model_learns_fixed_pictures() -> None:
    one = explorer()
    rollout = play(one)

    def loss() -> float:
        return one.world_loss(rollout.obs.flatten(0, 1), torch.Generator().manual_seed(1))

    before = loss()
    for _ in range(60):
        one.update(rollout)
    assert loss() < 0.7 * before


def test_the_policy_learns_to_have_impact() -> None:
    """In a world where action 3 changes everything and the others nothing, action 3 becomes the likely one."""
    one = explorer()
    images = pictures(2)
    first = one.act(images)
    chosen = torch.arange(40).remainder(9)[:, None].expand(-1, 2)
    for _ in range(6):
        acted = one.act(images)
        logits = one.policy(one.encoder.prepare(images))[0].log_softmax(1).detach()
        logprobs = logits[:, chosen[:, 0]].T
        values = acted.values.expand(40, 2)
        rewards = (chosen == 3).float()
        nothing = torch.zeros(40, 2, dtype=torch.bool)
        obs = images.expand(40, *images.shape)
        one.update(Rollout(obs, chosen, logprobs, rewards, values, torch.zeros(40, 2), ~nothing, nothing))
    after = one.policy(one.encoder.prepare(images))[0].softmax(1)[:, 3]
    assert first.entropy.mean() > 2.1
    assert (after > 0.3).all()


def test_random_play_is_uniform_without_reward_and_leaves_the_policy_alone() -> None:
    one = explorer("curl+random")
    with torch.no_grad():
        one.policy.actor.bias.copy_(torch.linspace(-5, 5, 9))
    acted = one.act(pictures(2))
    np.testing.assert_allclose(acted.entropy.numpy(), np.log(9), rtol=1e-6)
    rollout = play(one)
    assert not rollout.rewards.any()
    heads = [parameter.clone() for parameter in (one.policy.actor.weight, one.policy.critic.weight)]
    before = one.curl.W.clone()
    one.update(rollout)
    assert torch.equal(one.policy.actor.weight, heads[0])
    assert torch.equal(one.policy.critic.weight, heads[1])
    assert not torch.equal(one.curl.W, before)


def test_the_reward_scale_is_the_deviation_of_the_discounted_sum() -> None:
    rng = np.random.default_rng(3)
    rewards = rng.exponential(size=(50, 2))
    sums, every = np.zeros(2), []
    for now in rewards:
        sums = 0.9 * sums + now
        every.extend(sums)
    scale = RewardScale(2, gamma=0.9)
    scale.normalise(rewards[:20])
    np.testing.assert_allclose(scale.normalise(rewards[20:]), rewards[20:] / np.std(every), rtol=1e-6)


def test_its_state_comes_back_whole() -> None:
    """Restored in the middle, a second explorer goes on exactly as the first."""
    one, other = explorer(), explorer(seed=9)
    one.update(play(one))
    other.load_tensors({name: tensor.clone() for name, tensor in one.tensors().items()})
    other.optimizer.load_state_dict(copy.deepcopy(one.optimizer.state_dict()))
    one.update(play(one))
    other.update(play(other))
    mine, theirs = one.tensors(), other.tensors()
    assert mine.keys() == theirs.keys()
    assert [name for name in mine if not torch.equal(mine[name], theirs[name])] == []


def test_the_seed_decides_everything() -> None:
    first, again, different = (explorer(seed=seed).tensors() for seed in (4, 4, 5))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["policy.encoder.layers.0.weight"], different["policy.encoder.layers.0.weight"])
