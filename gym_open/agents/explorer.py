"""The explorer: one encoder shared by a policy and a world model, one optimiser, and a reward from within.

CURL is the world model (Srinivas et al. 2020), RIDE's impact the reward (Raileanu & Rocktäschel 2020), PPO the learner
(Schulman et al. 2017); OPEn found sharing the encoder's weights while exploring to be important. There is no reward
from outside: nothing here takes one.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open import seeding
from gym_open.agents.augment import random_shift
from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerKind, PPOConfig
from gym_open.agents.curl import Curl, info_nce
from gym_open.agents.encoder import Encoder, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import Rollout, gae, policy_loss, value_loss
from gym_open.agents.ride import ride_reward


@dataclass(frozen=True)
class Acted:
    """What the explorer makes of N observations: what it does, and what it thought, each (N,) but the latent (N, D)."""

    actions: Tensor
    logprobs: Tensor
    entropy: Tensor
    """Nats."""
    values: Tensor
    latent: Tensor


@dataclass(frozen=True)
class UpdateStats:
    """Losses of an update, averaged over its minibatches."""

    world_model_loss: float
    policy_loss: float
    value_loss: float
    entropy: float


class Explorer:
    """Acts, rewards itself, and learns.

    Attributes:
        encoder: shared by `policy` and `curl`.
        reward_scale: running scale of the intrinsic reward.
    """

    def __init__(
        self, kind: ExplorerKind, encoder: EncoderConfig, curl: CurlConfig, ppo: PPOConfig, *, n_actions: int,
        n_streams: int, seed: int,
    ) -> None:  # fmt: skip
        init = _generator(seed, "init")
        self.kind: ExplorerKind = kind
        self.config = ppo
        self.encoder = Encoder(encoder, init)
        self.policy = ActorCritic(self.encoder, n_actions, init)
        self.curl = Curl(self.encoder, curl, init)
        self._modules = nn.ModuleDict({"policy": self.policy, "curl": self.curl})
        learned = [parameter for parameter in self._modules.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.Adam(learned, lr=ppo.learning_rate, eps=1e-5)
        self.reward_scale = RewardScale(n_streams, ppo.gamma)
        self._act, self._learn = _generator(seed, "act"), _generator(seed, "learn")
        self._losses = 0

    @torch.no_grad()
    def act(self, images: Tensor) -> Acted:
        """Look at N observations, (N, 84, 84, 3) uint8, and choose an action for each."""
        with autocast(self.config.precision):
            features = self.encoder(self.encoder.prepare(images))
            latent = self.curl.projection(features).float()
            logits, values = self.policy.actor(features).float(), self.policy.critic(features).float().flatten()
        if self.kind == "curl+random":
            logits = torch.zeros_like(logits)
        logprobs = F.log_softmax(logits, dim=1)
        probs = logprobs.exp()
        actions = torch.multinomial(probs, 1, generator=self._act)
        entropy = -(probs * logprobs).sum(dim=1)
        return Acted(actions.flatten(), logprobs.gather(1, actions).flatten(), entropy, values, latent)

    def intrinsic_reward(self, latent: Tensor, next_latent: Tensor) -> Tensor:
        """Impact of each step in CURL's latent space; (T, N, D) twice to (T, N). Zero for random play."""
        if self.kind == "curl+random":
            return torch.zeros(latent.shape[:-1])
        return ride_reward(latent, next_latent)

    @torch.no_grad()
    def world_loss(self, images: Tensor, generator: torch.Generator) -> float:
        """The world model's loss on B observations of one world, (B, 84, 84, 3) uint8: InfoNCE among themselves."""
        with autocast(self.config.precision):
            return float(self.curl.loss(images, generator))

    def update(self, rollout: Rollout) -> UpdateStats:
        """Learn from one rollout, whose rewards are intrinsic and not yet scaled.

        Policy and world model look at the same random shift of a picture, so that one pass through the encoder serves
        both; the world model's keys are a second shift. A rollout's last step bootstraps from the value of what it led
        to, also where the curriculum then leaves the world: a switch is a truncation, never an end.
        """
        rewards = torch.from_numpy(self.reward_scale.normalise(rollout.rewards.double().numpy())).float()
        rollout = Rollout(**{**vars(rollout), "rewards": rewards})
        advantages = gae(rollout, self.config.gamma, self.config.gae_lambda)
        batch = _Batch(
            rollout.obs.flatten(0, 1), rollout.actions.flatten(), rollout.logprobs.flatten(),
            rollout.values.flatten(), advantages.flatten(), (advantages + rollout.values).flatten(),
        )  # fmt: skip
        sums, count = torch.zeros(4), 0
        for _ in range(self.config.update_epochs):
            order = torch.randperm(len(batch.obs), generator=self._learn)
            for chosen in order.split(self.config.minibatch_size):
                sums += self._minibatch(batch.take(chosen))
                count += 1
        return UpdateStats(*(sums / count).tolist())

    def _minibatch(self, batch: "_Batch") -> Tensor:
        """One gradient step; returns world-model loss, policy loss, value loss and entropy."""
        config = self.config
        prepared = self.encoder.prepare(batch.obs)
        with autocast(config.precision):
            features = self.encoder(random_shift(prepared, config.shift_pad, self._learn))
            query = self.curl.projection(features)
            with torch.no_grad():
                key = self.curl.key(random_shift(prepared, self.curl.config.pad, self._learn))
            logits, values = self.policy.actor(features).float(), self.policy.critic(features).float().flatten()
        model_loss = info_nce(query.float() @ self.curl.W @ key.float().T)
        pg_loss, v_loss, entropy = self._policy_losses(batch, logits, values)
        loss = model_loss
        if self.kind == "curl+ride":
            loss = loss + pg_loss - config.ent_coef * entropy + config.vf_coef * v_loss
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self._modules.parameters(), config.max_grad_norm)
        self.optimizer.step()
        self._losses += 1
        if self._losses % self.curl.config.update_every == 0:
            self.curl.update_key()
        return torch.stack([model_loss, pg_loss, v_loss, entropy]).detach()

    def _policy_losses(self, batch: "_Batch", logits: Tensor, values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        config = self.config
        logprobs = F.log_softmax(logits, dim=1)
        logratio = logprobs.gather(1, batch.actions[:, None]).flatten() - batch.logprobs
        advantages = batch.advantages
        if config.norm_adv and len(advantages) > 1:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        clip = config.clip_coef if config.clip_vloss else None
        return (
            policy_loss(logratio, advantages, config.clip_coef),
            value_loss(values, batch.values, batch.returns, clip),
            -(logprobs.exp() * logprobs).sum(dim=1).mean(),
        )

    def tensors(self) -> dict[str, Tensor]:
        """Weights and the states of the random generators, by name (the optimiser's state is kept apart)."""
        scale = {"reward_scale": torch.from_numpy(self.reward_scale.state.copy())}
        counters = {"losses": torch.tensor(self._losses)}
        generators = {"act": self._act.get_state(), "learn": self._learn.get_state()}
        return {**self._modules.state_dict(), **scale, **counters, **generators}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore what `tensors` gave."""
        rest = dict(tensors)
        self.reward_scale.state = rest.pop("reward_scale").numpy().copy()
        self._losses = int(rest.pop("losses"))
        self._act.set_state(rest.pop("act"))
        self._learn.set_state(rest.pop("learn"))
        self._modules.load_state_dict(rest)


@dataclass(frozen=True)
class _Batch:
    """B transitions: pictures (B, 84, 84, 3) uint8, everything else (B,)."""

    obs: Tensor
    actions: Tensor
    logprobs: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor

    def take(self, chosen: Tensor) -> "_Batch":
        return _Batch(**{name: values[chosen] for name, values in vars(self).items()})


class RewardScale:
    """Divides rewards by the running deviation of their discounted sum (Burda et al. 2018, RND).

    The sum runs on through switches of world: play is not episodic. The mean is not subtracted.
    """

    def __init__(self, n_streams: int, gamma: float) -> None:
        self._gamma = gamma
        self.state = np.zeros(n_streams + 3)
        """Discounted sum of each stream, then count, mean and sum of squared differences of all sums so far."""

    def normalise(self, rewards: np.ndarray) -> np.ndarray:
        """Take T steps of N streams into account, (T, N), and return them scaled."""
        sums, (count, mean, squares) = self.state[:-3], self.state[-3:]
        for now in rewards:
            sums = self._gamma * sums + now
            for value in sums:  # Welford's update, one value at a time
                count += 1
                step = value - mean
                mean += step / count
                squares += step * (value - mean)
        self.state = np.array([*sums, count, mean, squares])
        return rewards / (math.sqrt(squares / count) + 1e-8)


def _generator(seed: int, name: str) -> torch.Generator:
    return torch.Generator().manual_seed(seeding.integer(seed, "explorer", name))
