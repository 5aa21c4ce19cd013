"""PPO compared with Stable-Baselines3's, on the same numbers.

Where SB3 differs by design, settings that make the two equal are compared:

- its value loss is a mean square, ours half of one: its `vf_coef` is half of ours;
- with clipped values it takes the clipped error, we the larger of both (as OpenAI's baselines do);
- it adds `gamma` times the value of a truncated episode's last observation to the reward, we keep that value apart;
- it reports the KL divergence of the last epoch alone, and stops before a minibatch's step at 1.5 `target_kl`, we after
  an epoch at `target_kl`;
- with a last minibatch of one, neither scales the advantage.
"""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import configure
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from gym_open import seeding
from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.agents.encoder import StateEncoder
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import Rollout, gae, ppo_update
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.state import STATE_SIZE, state_vector
from gym_open.formats.models import load_policy
from gym_open.train import policy as training
from gym_open.train.config import PolicyTrainConfig

GAMMA, LAMBDA = 0.95, 0.9
ENCODER, TRUNK = EncoderConfig(architecture="state"), (32, 32)
SPACE = spaces.Box(-np.inf, np.inf, (STATE_SIZE,), np.float32)


class Features(BaseFeaturesExtractor):
    """Our trunk, for SB3."""

    def __init__(self, space: spaces.Box) -> None:
        super().__init__(space, TRUNK[-1])
        self.trunk = agent().trunk

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return self.trunk(observations)


class StateEnv(gymnasium.ObservationWrapper[Any, Any, Any]):
    """`OpenEnv` with the simulator state as observation. Its first reset has the given seed."""

    def __init__(self, seed: int) -> None:
        super().__init__(OpenEnv("goal-seeking"))
        self.observation_space = SPACE
        self.first: int | None = seed

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:  # noqa: ARG002  (SB3's own)
        given, self.first = self.first, None
        return super().reset(seed=given, options=options)

    def observation(self, observation: Any) -> np.ndarray:  # noqa: ARG002  (the image)
        env = self.unwrapped
        assert isinstance(env, OpenEnv)
        return state_vector(env.world)


def sb3_ppo(agent: ActorCritic, config: PPOConfig, n_steps: int, seeds: list[int], **also: Any) -> PPO:
    """SB3's PPO with the weights of `agent` and the settings of `config`, and one environment per seed."""
    model = PPO(
        "MlpPolicy", DummyVecEnv([lambda s=s: StateEnv(s) for s in seeds]), learning_rate=config.learning_rate,
        n_steps=n_steps, batch_size=config.minibatch_size, n_epochs=config.update_epochs, gamma=config.gamma,
        gae_lambda=config.gae_lambda, clip_range=config.clip_coef, normalize_advantage=config.norm_adv,
        ent_coef=config.ent_coef, vf_coef=config.vf_coef / 2, max_grad_norm=config.max_grad_norm, device="cpu",
        policy_kwargs={"features_extractor_class": Features, "net_arch": []}, **also,
    )  # fmt: skip
    for theirs, own in modules(model, agent):
        theirs.load_state_dict(own.state_dict())
    model.set_logger(configure(None, []))
    return model


def modules(model: PPO, agent: ActorCritic) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
    """Pairs of SB3's modules and ours."""
    theirs = model.policy
    assert isinstance(theirs.features_extractor, Features)
    return [
        (theirs.features_extractor.trunk, agent.trunk),
        (theirs.action_net, agent.actor),
        (theirs.value_net, agent.critic),
    ]


def assert_same_weights(model: PPO, agent: ActorCritic) -> None:
    for theirs, own in modules(model, agent):
        for a, b in zip(theirs.parameters(), own.parameters(), strict=True):
            np.testing.assert_allclose(a.detach().numpy(), b.detach().numpy(), atol=1e-5)


def made_up(seed: int, n_steps: int, n_envs: int, ends: float = 0.2) -> Rollout:
    """Random numbers for a rollout. Within an episode, the result of an action is the next observation."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.from_numpy(rng.normal(size=shape).astype(np.float32))

    over, values, next_values = rng.random((n_steps, n_envs)), normal(n_steps, n_envs), normal(n_steps, n_envs)
    same = torch.from_numpy((over > ends) & (over < 1 - ends))[:-1]
    next_values[:-1][same] = values[1:][same]
    return Rollout(
        obs=normal(n_steps, n_envs, STATE_SIZE),
        actions=torch.from_numpy(rng.integers(0, N_ACTIONS, (n_steps, n_envs))),
        logprobs=np.log(1 / N_ACTIONS) + 0.3 * normal(n_steps, n_envs), rewards=normal(n_steps, n_envs),
        values=values, next_values=next_values,
        terminations=torch.from_numpy(over <= ends), truncations=torch.from_numpy(over >= 1 - ends),
    )  # fmt: skip


def fill(buffer: RolloutBuffer, rollout: Rollout) -> None:
    """Fill SB3's buffer with `rollout`, as its `collect_rollouts` would."""
    ended = rollout.terminations | rollout.truncations
    rewards = rollout.rewards + buffer.gamma * rollout.next_values * rollout.truncations
    begins = torch.cat([torch.ones_like(ended[:1]), ended[:-1]])
    for t in range(len(rewards)):
        obs, action, reward, begin = (a[t].numpy() for a in (rollout.obs, rollout.actions, rewards, begins))
        buffer.add(obs, action, reward, begin, rollout.values[t], rollout.logprobs[t])
    buffer.compute_returns_and_advantage(rollout.next_values[-1], ended[-1].numpy())


@pytest.mark.parametrize("seed", range(5))
def test_advantages_and_returns(seed: int) -> None:
    rollout = made_up(seed, 40, 3, ends=0.08 * seed)
    buffer = RolloutBuffer(40, SPACE, spaces.Discrete(N_ACTIONS), "cpu", LAMBDA, GAMMA, n_envs=3)
    fill(buffer, rollout)
    advantages = gae(rollout, GAMMA, LAMBDA)
    np.testing.assert_allclose(advantages.numpy(), buffer.advantages, atol=1e-5)
    np.testing.assert_allclose((advantages + rollout.values).numpy(), buffer.returns, atol=1e-5)


def agent() -> ActorCritic:
    generator = torch.Generator().manual_seed(0)
    return ActorCritic(StateEncoder(ENCODER), N_ACTIONS, generator, trunk=TRUNK)


CONFIG = PPOConfig(
    gamma=GAMMA, gae_lambda=LAMBDA, minibatch_size=120, update_epochs=1, ent_coef=0.02, clip_vloss=False,
    precision="fp32",
)  # fmt: skip
SETTINGS = {
    "as it is": {},
    "advantages as they are": {"norm_adv": False},
    "gradient not clipped": {"max_grad_norm": 1e9},
    "other coefficients": {"clip_coef": 0.05, "ent_coef": 0.1, "vf_coef": 2.0, "learning_rate": 1e-2},
}


@pytest.mark.parametrize("also", SETTINGS.values(), ids=SETTINGS.keys())
def test_gradient_step(also: dict[str, Any]) -> None:
    """One minibatch: the same losses, and the same weights after it."""
    config, net, rollout = msgspec.structs.replace(CONFIG, **also), agent(), made_up(0, 40, 3)
    model = sb3_ppo(net, config, 40, [0, 1, 2])
    fill(model.rollout_buffer, rollout)
    model.train()
    optimizer = torch.optim.Adam(net.parameters(), lr=config.learning_rate, eps=1e-5, fused=True)
    stats = ppo_update(net, optimizer, rollout, config, torch.Generator())
    assert_same_weights(model, net)
    found = {name.removeprefix("train/"): value for name, value in model.logger.name_to_value.items()}
    assert 0.1 < stats.clip_fraction < 0.9
    assert stats.approx_kl > 0.01
    np.testing.assert_allclose(stats.policy_loss, found["policy_gradient_loss"], atol=1e-5)
    np.testing.assert_allclose(2 * stats.value_loss, found["value_loss"], rtol=1e-5)
    np.testing.assert_allclose(stats.entropy, -found["entropy_loss"], atol=1e-5)
    np.testing.assert_allclose(stats.approx_kl, found["approx_kl"], rtol=1e-4)
    np.testing.assert_allclose(stats.clip_fraction, found["clip_fraction"], atol=1e-6)
    np.testing.assert_allclose(stats.explained_variance, found["explained_variance"], rtol=1e-4)


def test_clipped_values_are_the_worse_of_both() -> None:
    """SB3's error is that of the clipped values. Ours is the larger one of the clipped and the unclipped error."""

    def value_losses(*, clipped: bool) -> tuple[float, float]:
        config, net, rollout = msgspec.structs.replace(CONFIG, clip_vloss=clipped), agent(), made_up(0, 40, 3)
        model = sb3_ppo(net, config, 40, [0, 1, 2], clip_range_vf=config.clip_coef if clipped else None)
        fill(model.rollout_buffer, rollout)
        model.train()
        stats = ppo_update(net, torch.optim.Adam(net.parameters()), rollout, config, torch.Generator())
        return 2 * stats.value_loss, model.logger.name_to_value["train/value_loss"]

    (ours, theirs), (unclipped, _) = value_losses(clipped=True), value_losses(clipped=False)
    assert ours > max(theirs, unclipped) + 1e-3


def test_a_whole_run_of_train_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With our initial weights, actions and shuffles, SB3 has the same observations, rewards and updates."""
    ppo = msgspec.structs.replace(CONFIG, minibatch_size=100, update_epochs=3, learning_rate=5e-4)
    config = PolicyTrainConfig(
        steps=440, num_envs=4, num_steps=110, encoder=ENCODER, trunk=TRUNK, ppo=ppo, threads=1, seed=3
    )
    kept: list[tuple[ActorCritic, Rollout]] = []
    shuffles: list[torch.Tensor] = []

    def update(agent: ActorCritic, optimizer: Any, rollout: Rollout, *rest: Any) -> Any:
        kept.append((copy.deepcopy(agent), rollout))
        with monkeypatch.context() as patches:
            patches.setattr(torch, "randperm", recorded(torch.randperm, shuffles))
            return ppo_update(agent, optimizer, rollout, *rest)

    monkeypatch.setattr(training, "ppo_update", update)
    trained = load_policy(training.train_policy(config, None, tmp_path / "policy").path)
    [(first, rollout)] = kept
    assert rollout.truncations.any()
    assert rollout.rewards.any()

    seeds = [seeding.integer(config.seed, "policy", "env", i) for i in range(config.num_envs)]
    with pytest.warns(UserWarning, match="truncated mini-batch"):
        model = sb3_ppo(first, ppo, config.num_steps, seeds)
    times = iter(range(config.num_steps))

    def act(obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        actions = rollout.actions[next(times)]
        values, logprobs, _ = model.policy.evaluate_actions(obs, actions)
        return actions, values, logprobs

    monkeypatch.setattr(model.policy, "forward", act)
    orders = iter(shuffles)
    monkeypatch.setattr(np.random, "permutation", lambda _: worlds_first(next(orders), rollout))
    model.learn(config.steps)

    buffer = model.rollout_buffer
    advantages = gae(rollout, GAMMA, LAMBDA)
    folded = replace(rollout, rewards=rollout.rewards + GAMMA * rollout.next_values * rollout.truncations)
    np.testing.assert_allclose(buffer.rewards, folded.rewards.numpy(), atol=1e-5)
    for theirs, own in [
        (buffer.observations, rollout.obs), (buffer.values, rollout.values), (buffer.log_probs, rollout.logprobs),
        (buffer.advantages, advantages), (buffer.returns, advantages + rollout.values),
    ]:  # fmt: skip
        expected = own.transpose(0, 1).flatten(0, 1).numpy()
        np.testing.assert_allclose(theirs.reshape(expected.shape), expected, atol=1e-5)
    assert len(shuffles) == ppo.update_epochs
    assert_same_weights(model, trained)


def recorded(function: Callable[..., torch.Tensor], results: list[torch.Tensor]) -> Callable[..., torch.Tensor]:
    """`function`, which also stores what it returns."""

    def wrapped(*args: Any, **kwargs: Any) -> torch.Tensor:
        results.append(function(*args, **kwargs))
        return results[-1]

    return wrapped


def worlds_first(order: torch.Tensor, rollout: Rollout) -> np.ndarray:
    """Indices into our flat rollout (time first) in SB3's order (environment first)."""
    n_steps, n_envs = rollout.rewards.shape
    return (order % n_envs * n_steps + order // n_envs).numpy()
