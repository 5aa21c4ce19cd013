"""Proximal policy optimisation, line by line as in CleanRL's `ppo_atari.py` (Huang et al. 2022).

Two departures: truncation and termination are distinguished (Pardo et al. 2018), and images are shifted at random in
the update (Kostrikov et al. 2021).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gym_open.agents.augment import draw_shifts
from gym_open.agents.config import PPOConfig
from gym_open.agents.encoder import autocast
from gym_open.agents.policy import ActorCritic
from gym_open.errors import DivergedError


@dataclass(frozen=True)
class Rollout:
    """T steps of N environments, time first.

    Attributes:
        obs: observation before each action, (T, N, …): images (84, 84, 3) uint8, features, or simulator states.
        actions: (T, N) int64.
        logprobs: log-probability of each action when it was taken, (T, N).
        rewards: (T, N).
        values: value of `obs`, (T, N).
        next_values: value of the observation that each action led to, (T, N). At the end of an episode, this is the
            last observation of the episode, never the first of the next one.
        terminations: whether the step terminated its episode, so that no reward can follow, (T, N) bool.
        truncations: whether the step was the last of its episode although the world could go on, (T, N) bool.
    """

    obs: Tensor
    actions: Tensor
    logprobs: Tensor
    rewards: Tensor
    values: Tensor
    next_values: Tensor
    terminations: Tensor
    truncations: Tensor

    @classmethod
    def empty(
        cls, n_steps: int, n_envs: int, obs_shape: tuple[int, ...], obs_dtype: torch.dtype, device: str = "cpu"
    ) -> "Rollout":
        """A rollout of zeros for `n_steps` of `n_envs` environments."""
        shape = (n_steps, n_envs)
        return cls(
            obs=torch.zeros(*shape, *obs_shape, dtype=obs_dtype, device=device),
            actions=torch.zeros(shape, dtype=torch.int64, device=device),
            logprobs=torch.zeros(shape, device=device),
            rewards=torch.zeros(shape, device=device),
            values=torch.zeros(shape, device=device),
            next_values=torch.zeros(shape, device=device),
            terminations=torch.zeros(shape, dtype=torch.bool, device=device),
            truncations=torch.zeros(shape, dtype=torch.bool, device=device),
        )


@dataclass(frozen=True)
class PPOStats:
    """Statistics of an update, averaged over its gradient steps; `explained_variance` is that of the rollout."""

    policy_loss: float
    value_loss: float
    entropy: float
    approx_kl: float
    clip_fraction: float
    explained_variance: float


def gae(rollout: Rollout, gamma: float, gae_lambda: float) -> Tensor:
    """Generalised advantage estimate (Schulman et al. 2016), (T, N).

    `delta[t] = reward[t] + gamma · next_value[t] · (1 − terminated[t]) − value[t]` and
    `advantage[t] = delta[t] + gamma · lambda · (1 − ended[t]) · advantage[t+1]`: a terminated step does
    not bootstrap, a truncated one bootstraps from the value of its last observation, and the sum stops at both.
    """
    alive = (~rollout.terminations).float()
    same_episode = (~(rollout.terminations | rollout.truncations)).float()
    delta = rollout.rewards + gamma * rollout.next_values * alive - rollout.values
    advantages = torch.zeros_like(rollout.rewards)
    lastgaelam = torch.zeros_like(rollout.rewards[0])
    for t in reversed(range(len(delta))):
        lastgaelam = delta[t] + gamma * gae_lambda * same_episode[t] * lastgaelam
        advantages[t] = lastgaelam
    return advantages


def policy_loss(logratio: Tensor, advantages: Tensor, clip_coef: float) -> Tensor:
    """`mean(max(−A·r, −A·clip(r, 1 − clip_coef, 1 + clip_coef)))` with `r = exp(logratio)`; all (B,)."""
    ratio = logratio.exp()
    pg_loss1 = -advantages * ratio
    pg_loss2 = -advantages * ratio.clamp(1 - clip_coef, 1 + clip_coef)
    return torch.max(pg_loss1, pg_loss2).mean()


def value_loss(newvalue: Tensor, value: Tensor, returns: Tensor, clip_coef: float | None) -> Tensor:
    """Half the mean square error to the returns; with `clip_coef`, the larger error of clipped and unclipped value."""
    v_loss = (newvalue - returns) ** 2
    if clip_coef is not None:
        v_clipped = value + (newvalue - value).clamp(-clip_coef, clip_coef)
        v_loss = torch.max(v_loss, (v_clipped - returns) ** 2)
    return 0.5 * v_loss.mean()


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """`1 − Var(returns − values) / Var(returns)`; NaN if the returns do not vary."""
    variance = returns.var(unbiased=False)
    return float("nan") if variance == 0 else float(1 - (returns - values).var(unbiased=False) / variance)


def ppo_update(
    agent: ActorCritic,
    optimizer: torch.optim.Optimizer,
    rollout: Rollout,
    config: PPOConfig,
    generator: torch.Generator,
) -> PPOStats:
    """Improve `agent` on one rollout, in `config.update_epochs` epochs of shuffled minibatches.

    Args:
        agent: is changed in place.
        optimizer: of at least the agent's parameters. Its learning rate is used unchanged.
        rollout: T steps of N environments by `agent`.
        config: coefficients. The caller applies `anneal_lr`.
        generator: source of the shuffles and shifts, on the CPU.

    Raises:
        DivergedError: if the loss is not finite.
    """
    device = rollout.rewards.device
    advantages = gae(rollout, config.gamma, config.gae_lambda)
    returns = (advantages + rollout.values).flatten()
    b_obs = rollout.obs.flatten(0, 1)
    b_actions, b_logprobs, b_values = rollout.actions.flatten(), rollout.logprobs.flatten(), rollout.values.flatten()
    b_advantages = advantages.flatten()

    sums, n_minibatches = torch.zeros(5, device=device), 0
    for _epoch in range(config.update_epochs):
        approx_kl = torch.zeros(())
        for mb_inds in torch.randperm(len(b_obs), generator=generator).to(device).split(config.minibatch_size):
            with autocast(config.precision, device.type):
                shifts = draw_shifts(len(mb_inds), config.shift_pad, generator)
                prepared = agent.prepare_shifted(b_obs.index_select(0, mb_inds), shifts)
                _, newlogprob, entropy, newvalue = agent.get_action_and_value(prepared, b_actions[mb_inds])
            logratio = newlogprob - b_logprobs[mb_inds]
            mb_advantages = b_advantages[mb_inds]
            if config.norm_adv and len(mb_inds) > 1:
                mb_advantages = (mb_advantages - mb_advantages.mean()) / (mb_advantages.std() + 1e-8)

            pg_loss = policy_loss(logratio, mb_advantages, config.clip_coef)
            clip = config.clip_coef if config.clip_vloss else None
            v_loss = value_loss(newvalue, b_values[mb_inds], returns[mb_inds], clip)
            entropy_loss = entropy.mean()
            loss = pg_loss - config.ent_coef * entropy_loss + config.vf_coef * v_loss
            if not loss.isfinite():
                raise DivergedError("PPO's loss is not finite")

            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), config.max_grad_norm)
            optimizer.step()

            with torch.no_grad():
                approx_kl = ((logratio.exp() - 1) - logratio).mean()  # http://joschu.net/blog/kl-approx.html
                clipped = ((logratio.exp() - 1).abs() > config.clip_coef).float().mean()
                sums += torch.stack([pg_loss, v_loss, entropy_loss, approx_kl, clipped])
                n_minibatches += 1
        if config.target_kl is not None and approx_kl > config.target_kl:
            break
    means = (sums / n_minibatches).tolist()
    return PPOStats(*means, explained_variance=explained_variance(b_values, returns))
