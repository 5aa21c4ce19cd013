"""Each world model learns from real steps: its loss on held-out worlds falls, and ICM identifies the action."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from gym_open.agents.augment import draw_shifts
from gym_open.agents.config import EncoderConfig, ExplorerConfig, WorldModelName
from gym_open.agents.encoder import Encoder, autocast
from gym_open.agents.icm import Icm
from gym_open.agents.world_model import TransitionBatch, WorldModel
from gym_open.agents.world_models import make_world_model
from gym_open.precision import native_precision

pytestmark = pytest.mark.learning
RandomPlay = Callable[[int, int], TransitionBatch]


def joined(parts: list[TransitionBatch]) -> TransitionBatch:
    return TransitionBatch(*(torch.cat(columns) for columns in zip(*parts, strict=True)))


def learned(
    name: WorldModelName, train: TransitionBatch, held_out: TransitionBatch, n_updates: int
) -> tuple[WorldModel, float]:
    """A model after some updates on `train`, and its loss on `held_out` as a share of the initial loss."""
    init, draws = torch.Generator().manual_seed(0), torch.Generator().manual_seed(1)
    encoder = Encoder(EncoderConfig(features=128), init)
    encoder.set_mean_image(train.obs)
    model = make_world_model(name, ExplorerConfig(), encoder, 9, init)
    model.watch(train.obs)

    def loss() -> float:
        return model.world_loss(held_out, torch.Generator().manual_seed(2))

    before = loss()
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=1e-3, fused=True)
    for _ in range(n_updates):
        chosen = torch.randint(len(train.obs), (64,), generator=draws)
        batch = TransitionBatch(train.obs[chosen], train.actions[chosen], train.next_obs[chosen])
        with autocast(native_precision()):
            objective = model.loss(batch, draw_shifts(64, 4, draws), draws)
        optimizer.zero_grad()
        objective.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 0.5)
        optimizer.step()
        model.stepped()
    return model, loss() / before


def accuracy(model: WorldModel, play: TransitionBatch) -> float:
    """Accuracy of the inverse model in steps that changed the image."""
    assert isinstance(model, Icm)
    with torch.no_grad():
        named = model.action_logits(model.latent(play.obs), model.latent(play.next_obs)).argmax(dim=1)
    changed = (play.obs != play.next_obs).flatten(1).any(dim=1)
    return (named == play.actions)[changed].float().mean().item()


def distinct(play: TransitionBatch) -> TransitionBatch:
    """The first step from each image: contrasts between equal images cannot be learned."""
    first: dict[bytes, int] = {}
    for i, image in enumerate(play.obs.numpy()):
        first.setdefault(image.tobytes(), i)
    return TransitionBatch(*(column[list(first.values())] for column in play))


def played(
    random_play: RandomPlay, n_worlds: int, n_train: int, n_held_out: int
) -> tuple[TransitionBatch, TransitionBatch]:
    """Random steps in some worlds: the first steps in each are for learning, the last ones are held out."""
    plays = [random_play(n_train + n_held_out, seed) for seed in range(n_worlds)]
    train = [TransitionBatch(*(column[:n_train] for column in play)) for play in plays]
    held_out = [TransitionBatch(*(column[n_train:] for column in play)) for play in plays]
    return joined(train), distinct(joined(held_out))


def moved_squares(n: int, seed: int) -> TransitionBatch:
    """A square at a random place, which each of the nine actions moves in its own direction (4 does not move it)."""
    rng = np.random.default_rng(seed)
    actions, places = rng.integers(0, 9, n), rng.integers(20, 50, (n, 2))
    obs = np.full((n, 84, 84, 3), 90, np.uint8)
    next_obs = obs.copy()
    for i, (row, column) in enumerate(places):
        down, right = (16 * (step - 1) for step in divmod(int(actions[i]), 3))
        obs[i, row : row + 12, column : column + 12] = 250
        next_obs[i, row + down : row + down + 12, column + right : column + right + 12] = 250
    return TransitionBatch(torch.from_numpy(obs), torch.from_numpy(actions), torch.from_numpy(next_obs))


def test_icm_learns_which_action_it_was() -> None:
    """The loss alone is no proof: it also falls for shuffled actions, whose frequencies can be learned."""
    held_out = moved_squares(200, 1)
    model, left = learned("icm", moved_squares(512, 0), held_out, 20)
    assert left < 0.5
    assert accuracy(model, held_out) > 0.5  # chance is 1/8: the action that changes nothing is left out


@pytest.mark.parametrize(("name", "share"), [("rnd", 0.6), ("curl", 0.6)])
def test_a_few_updates_help_with_steps_never_seen(name: WorldModelName, share: float, random_play: RandomPlay) -> None:
    _, left = learned(name, *played(random_play, 2, 256, 64), 30)
    assert left < share


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("icm", 0.6), ("rnd", 0.35), ("curl", 0.25)])
def test_world_models_learn_worlds(name: WorldModelName, share: float, random_play: RandomPlay) -> None:
    train, held_out = played(random_play, 6, 400, 100)
    model, left = learned(name, train, held_out, 800)
    assert left < share
    if name == "icm":
        assert accuracy(model, held_out) > 0.4  # chance is 1/9


def test_the_fixture_of_random_steps(random_play: RandomPlay) -> None:
    """Its steps are consecutive, repeatable, and change the image."""
    one, again = random_play(30, 3), random_play(30, 3)
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    assert torch.equal(one.obs[1:], one.next_obs[:-1])
    assert len(distinct(one).obs) > 15
