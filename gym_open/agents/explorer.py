"""The explorer: a world model, an intrinsic reward that is computed from it, and one PPO that maximises this reward.

Policy and world model share one encoder (unless `share_encoder` is false) and one optimiser: OPEn found that sharing
the encoder's weights during exploration is important. There is no extrinsic reward: no function here takes one.

With every world model, the policy and the model use the same random shift of an image in the update. So one pass
through a shared encoder serves both. Every reward is divided by the running standard deviation of its discounted sum,
so that the coefficients of PPO mean the same for all rewards. Of the papers, only RND's does this.

One gradient-norm clip, PPO's 0.5, covers policy and world model together, as one Adam does: their shared encoder takes
one step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open import seeding
from gym_open.agents.augment import draw_shifts
from gym_open.agents.config import ExplorerConfig
from gym_open.agents.encoder import Encoder, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import Rollout, gae, policy_loss, value_loss
from gym_open.agents.rewards import Reward, RewardScale, make_reward
from gym_open.agents.world_model import TransitionBatch, WorldModel
from gym_open.agents.world_models import make_world_model
from gym_open.errors import DivergedError


@dataclass(frozen=True)
class Acted:
    """The explorer's actions and estimates for N observations, each (N,)."""

    actions: Tensor
    logprobs: Tensor
    entropy: Tensor
    """Nats."""
    values: Tensor
    """0 for an explorer without a policy."""
    features: Tensor | None = None
    """The policy's encoder's features of the observations, (N, features), if the reward may reuse them."""


@dataclass(frozen=True)
class UpdateStats:
    """Statistics of an update, averaged over its minibatches. NaN without a world model, or without a policy."""

    world_model_loss: float
    policy_loss: float
    value_loss: float
    entropy: float
    approx_kl: float


@dataclass(frozen=True)
class LearnedRollout:
    """Rewards and statistics of a rollout of T steps in N streams, with P summands of reward.

    Attributes:
        reward: intrinsic reward before it is scaled, (T, N). It is the sum of its parts.
        parts: (T, N, P).
        stats: losses of the update.
    """

    reward: Tensor
    parts: Tensor
    stats: UpdateStats


class Explorer:
    """Chooses actions, computes its own reward, and learns.

    Attributes:
        policy: None if actions are random.
        model: the world model; None if there is none.
        encoder: the encoder that transfers to a task. It is the policy's, or the model's if there is no policy;
            None for plain random exploration.
        optimizer: of policy and world model together; None if there is neither.
        reward_parts: names of the summands of the reward.
    """

    def __init__(self, config: ExplorerConfig, *, n_actions: int, n_streams: int, seed: int) -> None:
        init = _generator(seed, "init")
        self.config = config
        self.n_actions = n_actions
        self.policy: ActorCritic | None = None
        self.model: WorldModel | None = None
        self.encoder: Encoder | None = None
        self.optimizer: torch.optim.Optimizer | None = None
        self._reward: Reward | None = None
        if config.world_model != "none":
            self.encoder = Encoder(config.encoder, init)
            shared = config.share_encoder or config.reward == "none"
            own = self.encoder if shared else Encoder(config.encoder, init)
            self.model = make_world_model(config.world_model, config, own, n_actions, init)
            if config.reward != "none":
                self.policy = ActorCritic(self.encoder, n_actions, init)
                self._reward = make_reward(config.reward, self.model, n_streams)
        self.reward_parts: tuple[str, ...] = self._reward.parts if self._reward else ()
        self._modules = nn.ModuleDict(
            {k: v for k, v in (("policy", self.policy), ("model", self.model)) if v is not None}
        )
        learned = [parameter for parameter in self._modules.parameters() if parameter.requires_grad]
        if learned:
            self.optimizer = torch.optim.Adam(learned, lr=config.ppo.learning_rate, eps=1e-5, fused=True)
        self.reward_scale = RewardScale(n_streams, config.ppo.gamma)
        self._act, self._learn = _generator(seed, "act"), _generator(seed, "learn")

    @property
    def learns(self) -> bool:
        """Whether there is a world model."""
        return self.model is not None

    def set_mean_image(self, images: Tensor) -> None:
        """Set the mean image of every encoder to the mean of images (N, 84, 84, 3) uint8."""
        for module in self._modules.modules():
            if isinstance(module, Encoder):
                module.set_mean_image(images)

    def entered(self, stream: int) -> None:
        """Notify the reward that a stream has entered another world."""
        if self._reward is not None:
            self._reward.entered(stream)

    @torch.no_grad()
    def act(self, images: Tensor) -> Acted:
        """Choose an action for each of N observations, (N, 84, 84, 3) uint8.

        Raises:
            DivergedError: if the policy's probabilities are not finite.
        """
        if self.policy is None:
            logits, values, features = torch.zeros(len(images), self.n_actions), torch.zeros(len(images)), None
        else:
            with autocast(self.config.ppo.precision):
                features = self.policy.encoder(self.policy.encoder.prepare(images))
                logits, values = self.policy.heads(features)
        logprobs = _finite(F.log_softmax(logits, dim=1), "the policy's probabilities are not finite")
        probs = logprobs.exp()
        actions = torch.multinomial(probs, 1, generator=self._act)
        entropy = -(probs * logprobs).sum(dim=1)
        return Acted(actions.flatten(), logprobs.gather(1, actions).flatten(), entropy, values, features)

    def learn(self, images: Tensor, acted: Sequence[Acted]) -> LearnedRollout:
        """Compute the rewards of a rollout of N streams, and learn from it.

        The last step bootstraps from the value of the observation that it led to, even if the curriculum then leaves
        the world: a switch is a truncation, never a termination.

        Args:
            images: observations before each of T steps and after the last, (T + 1, N, 84, 84, 3) uint8.
            acted: results of `act` for each of them; of the last, only the values are used.

        Raises:
            DivergedError: if the world model's loss is not finite.
        """
        actions = torch.stack([one.actions for one in acted[:-1]])
        if self.model is None:
            nothing = UpdateStats(*[math.nan] * 5)
            return LearnedRollout(torch.zeros(actions.shape), torch.zeros(*actions.shape, 0), nothing)
        self.model.watch(images[1:].flatten(0, 1))
        parts = torch.zeros(*actions.shape, 0)
        if self._reward is not None:
            with autocast(self.config.ppo.precision):
                parts = self._reward(images, actions, self._known(acted))
        reward = parts.sum(dim=-1)
        stats = self._update(self._batch(images, actions, acted, reward))
        return LearnedRollout(reward, parts, stats)

    def _known(self, acted: Sequence[Acted]) -> Tensor | None:
        """Features of all images from the model's encoder, (T + 1, N, features), if the policy has computed them."""
        known = [one.features for one in acted if one.features is not None]
        shared = self.policy is not None and self.model is not None and self.policy.encoder is self.model.encoder
        return torch.stack(known) if shared and len(known) == len(acted) else None

    def world_loss(self, transitions: TransitionBatch, generator: torch.Generator) -> float:
        """The world model's loss on B transitions of one world, times its `loss_scale`. NaN without a world model.

        Raises:
            DivergedError: if it is not finite.
        """
        if self.model is None:
            return math.nan
        with autocast(self.config.ppo.precision):
            loss = torch.tensor(self.model.world_loss(transitions, generator), dtype=torch.float64)
        return self.model.loss_scale * float(_finite(loss, "the world model's loss is not finite"))

    def _batch(self, images: Tensor, actions: Tensor, acted: Sequence[Acted], reward: Tensor) -> "_RolloutBatch":
        """All steps of a rollout, with the advantages of the scaled reward."""
        ppo = self.config.ppo
        values = torch.stack([one.values for one in acted])
        logprobs = torch.stack([one.logprobs for one in acted[:-1]])
        rewards = torch.from_numpy(self.reward_scale.normalise(reward.double().numpy())).float()
        never = torch.zeros(actions.shape, dtype=torch.bool)
        rollout = Rollout(images[:-1], actions, logprobs, rewards, values[:-1], values[1:], never, never)
        advantages = gae(rollout, ppo.gamma, ppo.gae_lambda)
        return _RolloutBatch(
            obs=images[:-1].flatten(0, 1), actions=actions.flatten(), next_obs=images[1:].flatten(0, 1),
            logprobs=logprobs.flatten(), values=values[:-1].flatten(), advantages=advantages.flatten(),
            returns=(advantages + values[:-1]).flatten(),
        )  # fmt: skip

    def _update(self, batch: "_RolloutBatch") -> UpdateStats:
        ppo = self.config.ppo
        sums, count, figures = torch.zeros(5), 0, torch.zeros(5)
        for _ in range(ppo.update_epochs):
            for chosen in torch.randperm(len(batch.obs), generator=self._learn).split(ppo.minibatch_size):
                figures = self._minibatch(batch.take(chosen))
                sums += figures
                count += 1
            if ppo.target_kl is not None and figures[4] > ppo.target_kl:
                break
        return UpdateStats(*(sums / count).tolist())

    def _minibatch(self, batch: "_RolloutBatch") -> Tensor:
        """Take one gradient step, and return the values of `UpdateStats` in their order, (5,)."""
        assert self.model is not None
        assert self.optimizer is not None
        ppo = self.config.ppo
        shifts = draw_shifts(len(batch.obs), ppo.shift_pad, self._learn)
        features: Tensor | None = None
        figures = torch.full((4,), math.nan)
        loss = torch.zeros(())
        if self.policy is not None:
            with autocast(ppo.precision):
                own = self.policy.encoder(self.policy.encoder.prepare_shifted(batch.obs, shifts))
                logits, values = self.policy.heads(own)
            if self.policy.encoder is self.model.encoder:
                features = own
            figures = self._policy_figures(batch, logits, values)
            loss = figures[:3] @ torch.tensor([1, ppo.vf_coef, -ppo.ent_coef])
        with autocast(ppo.precision):
            model_loss = self.model.loss(batch.transitions, shifts, self._learn, features)
        _finite(model_loss, "the world model's loss is not finite")
        self.optimizer.zero_grad()
        (loss + model_loss).backward()
        nn.utils.clip_grad_norm_(self._modules.parameters(), ppo.max_grad_norm)
        self.optimizer.step()
        self.model.stepped()
        return torch.cat([model_loss[None], figures]).detach()

    def _policy_figures(self, batch: "_RolloutBatch", logits: Tensor, values: Tensor) -> Tensor:
        """Policy loss, value loss, mean entropy, and KL divergence from the policy that acted, (4,)."""
        ppo = self.config.ppo
        logprobs = F.log_softmax(logits, dim=1)
        logratio = logprobs.gather(1, batch.actions[:, None]).flatten() - batch.logprobs
        kl = logratio.detach().exp() - 1 - logratio.detach()  # http://joschu.net/blog/kl-approx.html
        advantages = batch.advantages
        if ppo.norm_adv and len(advantages) > 1:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        clip = ppo.clip_coef if ppo.clip_vloss else None
        return torch.stack(
            [
                policy_loss(logratio, advantages, ppo.clip_coef),
                value_loss(values, batch.values, batch.returns, clip),
                -(logprobs.exp() * logprobs).sum(dim=1).mean(),
                kl.mean(),
            ]
        )

    def tensors(self) -> dict[str, Tensor]:
        """Weights, running statistics and states of the generators, by name, without the state of the optimiser."""
        scale = {"reward_scale": torch.from_numpy(self.reward_scale.state.copy())}
        generators = {"act": self._act.get_state(), "learn": self._learn.get_state()}
        kept = {} if self._reward is None else {f"reward.{k}": v for k, v in self._reward.tensors().items()}
        return {**self._modules.state_dict(), **scale, **generators, **kept}

    def load_tensors(self, tensors: dict[str, Tensor]) -> None:
        """Restore the state from the result of `tensors`."""
        rest = dict(tensors)
        self.reward_scale.state = rest.pop("reward_scale").numpy().copy()
        self._act.set_state(rest.pop("act"))
        self._learn.set_state(rest.pop("learn"))
        kept = {name: rest.pop(name) for name in list(rest) if name.startswith("reward.")}
        if self._reward is not None:
            self._reward.load_tensors({name.removeprefix("reward."): value for name, value in kept.items()})
        self._modules.load_state_dict(rest)


@dataclass(frozen=True)
class _RolloutBatch:
    """B steps: images (B, 84, 84, 3) uint8, everything else (B,)."""

    obs: Tensor
    actions: Tensor
    next_obs: Tensor
    logprobs: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor

    @property
    def transitions(self) -> TransitionBatch:
        return TransitionBatch(self.obs, self.actions, self.next_obs)

    def take(self, chosen: Tensor) -> "_RolloutBatch":
        return _RolloutBatch(**{name: values.index_select(0, chosen) for name, values in vars(self).items()})


def _finite(figures: Tensor, or_else: str) -> Tensor:
    if not figures.isfinite().all():
        raise DivergedError(or_else)
    return figures


def _generator(seed: int, name: str) -> torch.Generator:
    return torch.Generator().manual_seed(seeding.integer(seed, "explorer", name))
