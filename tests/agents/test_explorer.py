"""The explorer: its parts, its rewards, what it learns, and that its whole state is restored."""

import copy
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from gym_open.agents.config import (
    INTRINSIC_REWARDS,
    CurlConfig,
    EncoderConfig,
    ExplorerConfig,
    IcmConfig,
    PPOConfig,
    RewardName,
    RndConfig,
    WorldModelName,
)  # fmt: skip
from gym_open.agents.encoder import Encoder, ImageEncoder, StateEncoder
from gym_open.agents.explorer import Acted, Explorer, LearnedRollout
from gym_open.agents.rewards import make_reward
from gym_open.agents.world_model import TransitionBatch
from gym_open.agents.world_models import WORLD_MODELS

MakeImages = Callable[..., Tensor]
PPO = PPOConfig(learning_rate=1e-3, minibatch_size=16, update_epochs=1, shift_pad=2, precision="fp32")
LEARNERS: list[tuple[WorldModelName, RewardName]] = [
    (model, reward) for model in WORLD_MODELS for reward in (*INTRINSIC_REWARDS, "none")
]
every_learner = pytest.mark.parametrize(("model", "reward"), LEARNERS)


def explorer(
    model: WorldModelName = "curl",
    reward: RewardName = "ride",
    *,
    seed: int = 0,
    share: bool = True,
    ppo: PPOConfig = PPO,
) -> Explorer:
    config = ExplorerConfig(
        world_model=model, reward=reward, share_encoder=share, encoder=EncoderConfig(features=32),
        icm=IcmConfig(hidden=16), rnd=RndConfig(hidden=16, outputs=16), curl=CurlConfig(latent=8, pad=2), ppo=ppo,
    )  # fmt: skip
    return Explorer(config, n_actions=9, n_streams=2, seed=seed)


@pytest.fixture
def seen(make_images: MakeImages) -> Tensor:
    """Observations around 8 steps in 2 worlds."""
    return torch.stack([make_images(2, seed) for seed in range(9)])


def play(one: Explorer, seen: Tensor) -> tuple[list[Acted], LearnedRollout]:
    acted = [one.act(images) for images in seen]
    return acted, one.learn(seen, acted)


def first_weights(encoder: ImageEncoder | StateEncoder) -> Tensor:
    assert isinstance(encoder, Encoder)
    return encoder.layers[0].get_parameter("weight").detach().clone()


def transitions(seen: Tensor) -> TransitionBatch:
    return TransitionBatch(seen[:-1].flatten(0, 1), torch.arange(16) % 9, seen[1:].flatten(0, 1))


@every_learner
def test_rewards_and_parts_come_from_the_model_before_it_learned(
    model: WorldModelName, reward: RewardName, seen: Tensor
) -> None:
    one, twin = explorer(model, reward), explorer(model, reward)
    acted, learned = play(one, seen)
    assert learned.parts.shape == (8, 2, len(one.reward_parts))
    torch.testing.assert_close(learned.reward, learned.parts.sum(dim=-1))
    assert twin.model is not None
    twin.model.watch(seen[1:].flatten(0, 1))
    if reward == "none":
        assert one.reward_parts == ()
        assert not learned.reward.any()
        return
    made = make_reward(reward, twin.model, 2)
    assert one.reward_parts == made.parts
    actions = torch.stack([now.actions for now in acted[:-1]])
    torch.testing.assert_close(learned.parts, made(seen, actions), rtol=1e-4, atol=1e-6)
    assert learned.reward.any()


@every_learner
def test_one_optimiser_holds_every_learned_parameter_once(model: WorldModelName, reward: RewardName) -> None:
    for share in (True, False):
        one = explorer(model, reward, share=share)
        assert one.optimizer is not None
        held = [id(parameter) for group in one.optimizer.param_groups for parameter in group["params"]]
        wanted = {
            id(p) for part in (one.policy, one.model) if part is not None for p in part.parameters() if p.requires_grad
        }
        assert len(held) == len(set(held))
        assert set(held) == wanted


@pytest.mark.parametrize("model", WORLD_MODELS)
def test_policy_and_model_share_an_encoder_unless_configured_otherwise(model: WorldModelName, seen: Tensor) -> None:
    together, apart = explorer(model), explorer(model, share=False)
    for one, shared in ((together, True), (apart, False)):
        assert one.policy is not None
        assert one.model is not None
        assert one.encoder is one.policy.encoder
        assert (one.policy.encoder is one.model.encoder) == shared
        one.set_mean_image(seen[0])
        for encoder in (one.policy.encoder, one.model.encoder):
            assert isinstance(encoder, Encoder)
            torch.testing.assert_close(encoder.mean_image.permute(1, 2, 0), seen[0].float().mean(dim=0))


@pytest.mark.parametrize("model", WORLD_MODELS)
@pytest.mark.parametrize("share", [True, False])
def test_the_world_models_gradient_reaches_the_policys_encoder_only_if_it_is_shared(
    model: WorldModelName, share: bool, seen: Tensor
) -> None:
    """Without a gradient from the policy (no advantage, entropy or value), only the model's gradient changes it."""
    still = PPOConfig(
        learning_rate=1e-3, minibatch_size=16, update_epochs=1, ent_coef=0.0, vf_coef=0.0, shift_pad=0, precision="fp32"
    )
    one = explorer(model, share=share, ppo=still)
    assert one.policy is not None
    assert one.model is not None
    with torch.no_grad():
        one.policy.actor.weight.zero_()  # so that the policy's loss has no gradient for the features
    before, own = first_weights(one.policy.encoder), first_weights(one.model.encoder)
    play(one, seen)
    assert torch.equal(first_weights(one.policy.encoder), before) != share
    assert not torch.equal(first_weights(one.model.encoder), own)


def test_actions_follow_the_policy_and_figures_are_its_own(make_images: MakeImages) -> None:
    one = explorer()
    assert one.policy is not None
    images = make_images(1).expand(2000, -1, -1, -1)
    with torch.no_grad():
        assert isinstance(one.policy.actor, torch.nn.Linear)
        one.policy.actor.bias.copy_(torch.linspace(-1, 1, 9))
        logits, values = one.policy(one.policy.encoder.prepare(images[:1]))
    acted = one.act(images)
    p = np.exp(logits.numpy()[0]) / np.exp(logits.numpy()[0]).sum()
    np.testing.assert_allclose(np.bincount(acted.actions, minlength=9) / 2000, p, atol=4 * np.sqrt(0.25 / 2000))
    np.testing.assert_allclose(acted.logprobs.numpy(), np.log(p)[acted.actions.numpy()], rtol=1e-4)
    np.testing.assert_allclose(acted.entropy[0].item(), -(p * np.log(p)).sum(), rtol=1e-4)
    np.testing.assert_allclose(acted.values[0].item(), values.item(), rtol=1e-4)


@pytest.mark.parametrize(("model", "reward"), [("none", "none"), ("curl", "none"), ("icm", "none")])
def test_random_exploration_is_uniform_and_has_value_zero(
    model: WorldModelName, reward: RewardName, make_images: MakeImages
) -> None:
    one = explorer(model, reward)
    assert one.policy is None
    acted = one.act(make_images(1).expand(4500, -1, -1, -1))
    np.testing.assert_allclose(np.bincount(acted.actions, minlength=9), 500, atol=5 * np.sqrt(500))
    np.testing.assert_allclose(acted.entropy.numpy(), np.log(9), rtol=1e-6)
    np.testing.assert_allclose(acted.logprobs.numpy(), -np.log(9), rtol=1e-6)
    assert not acted.values.any()


def test_plain_random_exploration_learns_nothing_and_reports_so(seen: Tensor) -> None:
    one = explorer("none", "none")
    assert not one.learns
    assert one.encoder is None
    assert one.optimizer is None
    one.set_mean_image(seen[0])
    _, learned = play(one, seen)
    assert learned.parts.shape == (8, 2, 0)
    assert torch.equal(learned.reward, torch.zeros(8, 2))
    assert all(math.isnan(value) for value in vars(learned.stats).values())
    assert math.isnan(one.world_loss(transitions(seen), torch.Generator()))


def test_random_exploration_with_a_model_trains_the_model_alone(seen: Tensor) -> None:
    one = explorer("curl", "none")
    assert one.model is not None
    assert one.encoder is one.model.encoder
    before = first_weights(one.model.encoder)
    _, learned = play(one, seen)
    assert not torch.equal(first_weights(one.model.encoder), before)
    assert math.isfinite(learned.stats.world_model_loss)
    assert math.isnan(learned.stats.policy_loss)


@pytest.mark.parametrize("model", WORLD_MODELS)
def test_the_loss_of_a_world_is_the_models_times_its_scale(model: WorldModelName, seen: Tensor) -> None:
    one = explorer(model)
    assert one.model is not None
    raw = one.model.world_loss(transitions(seen), torch.Generator().manual_seed(1))
    one.model.loss_scale = 0.25
    found = one.world_loss(transitions(seen), torch.Generator().manual_seed(1))
    np.testing.assert_allclose(found, 0.25 * raw, rtol=1e-6)


@pytest.mark.learning
@pytest.mark.parametrize("model", WORLD_MODELS)
def test_the_world_model_learns_a_fixed_rollout(model: WorldModelName, seen: Tensor) -> None:
    one = explorer(model)
    assert one.model is not None
    one.set_mean_image(seen.flatten(0, 1))

    def loss() -> float:
        return one.world_loss(transitions(seen), torch.Generator().manual_seed(1))

    acted = [one.act(images) for images in seen]
    acted = [Acted(torch.arange(2 * t, 2 * t + 2) % 9, a.logprobs, a.entropy, a.values) for t, a in enumerate(acted)]
    one.model.watch(seen[1:].flatten(0, 1))
    before = loss()
    for _ in range(50):
        one.learn(seen, acted)
    assert loss() < 0.7 * before


@pytest.mark.learning
def test_the_policy_learns_to_have_impact(make_images: MakeImages) -> None:
    """In a world where action 3 changes everything and the others nothing, action 3 becomes likely."""
    one = explorer()
    assert one.policy is not None
    here, there = make_images(2, 0), make_images(2, 1)
    first = one.act(here)
    for turn in range(8):
        images: list[Tensor] = [here]
        acted: list[Acted] = []
        for t in range(60):
            thought = one.act(images[-1])
            action = (t + turn) % 9
            logprobs = one.policy(one.policy.encoder.prepare(images[-1]))[0].log_softmax(1)[:, action].detach()
            acted.append(Acted(torch.full((2,), action), logprobs, thought.entropy, thought.values))
            moved = there if images[-1] is here else here
            images.append(moved if action == 3 else images[-1])
        acted.append(one.act(images[-1]))
        learned = one.learn(torch.stack(images), acted)
        impact = learned.reward.numpy()
        assert all((impact[t] > 0).all() == ((t + turn) % 9 == 3) for t in range(60))
    assert first.entropy.mean() > 2.1
    for place in (here, there):
        assert (one.policy(one.policy.encoder.prepare(place))[0].softmax(1)[:, 3] > 0.3).all()


@every_learner
def test_its_whole_state_is_restored(model: WorldModelName, reward: RewardName, seen: Tensor) -> None:
    """A second explorer with the restored state continues exactly like the first."""
    one, other = explorer(model, reward, share=False), explorer(model, reward, share=False, seed=9)
    play(one, seen)
    other.load_tensors({name: tensor.clone() for name, tensor in one.tensors().items()})
    assert one.optimizer is not None
    assert other.optimizer is not None
    other.optimizer.load_state_dict(copy.deepcopy(one.optimizer.state_dict()))
    (acted, learned), (acted_too, learned_too) = play(one, seen), play(other, seen)
    assert all(torch.equal(a.actions, b.actions) for a, b in zip(acted, acted_too, strict=True))
    assert torch.equal(learned.reward, learned_too.reward)
    mine, theirs = one.tensors(), other.tensors()
    assert mine.keys() == theirs.keys()
    assert [name for name in mine if not torch.equal(mine[name], theirs[name])] == []


@every_learner
def test_the_seed_decides_everything(model: WorldModelName, reward: RewardName, seen: Tensor) -> None:
    def after(seed: int) -> dict[str, Tensor]:
        torch.manual_seed(torch.seed())  # whatever others draw
        one = explorer(model, reward, seed=seed)
        play(one, seen)
        return one.tensors()

    first, again, different = after(4), after(4), after(5)
    assert all(torch.equal(first[name], again[name]) for name in first)
    name = "model.encoder.layers.0.weight"
    assert not torch.equal(first[name], different[name])
