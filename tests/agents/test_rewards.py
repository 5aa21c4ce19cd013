"""Rewards from a world model with known latent and errors."""

import numpy as np
import pytest
import torch
from torch import Tensor

from gym_open.agents.config import EncoderConfig, WorldModelConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.rewards import CountedRide, OwnError, RewardScale, Ride, cells
from gym_open.agents.world_model import TransitionBatch, WorldModel
from gym_open.envs.puzzles import Placement, Puzzle
from gym_open.envs.world import World


class Known(WorldModel):
    """The latent of an image is its first three numbers. The errors are the action, and the change of pixel 0."""

    error_parts = ("action", "change")

    def __init__(self) -> None:
        super().__init__(Encoder(EncoderConfig(features=2), torch.Generator()), WorldModelConfig(), 9)

    def measure(
        self,
        transitions: TransitionBatch,  # noqa: ARG002
        shifts: Tensor,
        generator: torch.Generator,  # noqa: ARG002
        features: Tensor | None = None,  # noqa: ARG002
    ) -> tuple[Tensor, dict[str, Tensor]]:
        return shifts.float().sum(), {}

    def errors(self, transitions: TransitionBatch) -> dict[str, Tensor]:
        change = transitions.next_obs[:, 0, 0, 0].float() - transitions.obs[:, 0, 0, 0].float()
        return {"change": change, "action": transitions.actions.float()}

    def latent(self, images: Tensor, features: Tensor | None = None) -> Tensor:
        return images[:, 0, 0].float() if features is None else features


@pytest.fixture
def images() -> Tensor:
    """Three steps in two worlds."""
    return torch.from_numpy(np.random.default_rng(0).integers(0, 256, (4, 2, 84, 84, 3), dtype=np.uint8))


def test_ride_is_the_distance_that_a_step_went_in_each_world(images: Tensor) -> None:
    first = images[:, :, 0, 0].numpy().astype(np.float64)
    expected = np.sqrt(((first[1:] - first[:-1]) ** 2).sum(axis=-1))
    ride = Ride(Known())
    found = ride(images, torch.zeros(3, 2, dtype=torch.int64))
    assert ride.parts == ("impact",)
    assert found.shape == (3, 2, 1)
    np.testing.assert_allclose(found[..., 0].numpy(), expected, rtol=1e-6)


def test_known_features_are_not_computed_again(images: Tensor) -> None:
    actions, features = torch.zeros(3, 2, dtype=torch.int64), torch.randn(4, 2, 5)
    expected = (features[1:] - features[:-1]).norm(dim=-1)[..., None]
    torch.testing.assert_close(Ride(Known())(images, actions, features), expected)
    torch.testing.assert_close(CountedRide(Known(), 2)(images, actions, features), expected)  # nothing is seen twice


def test_no_change_is_no_impact(images: Tensor) -> None:
    still = images[:1].expand(4, -1, -1, -1, -1)
    assert not Ride(Known())(still, torch.zeros(3, 2, dtype=torch.int64)).any()


def test_counted_ride_is_less_where_the_stream_was_before_and_forgets_when_it_leaves(images: Tensor) -> None:
    a, b = images[0], images[1]
    play = torch.stack([a, b, b, a, b])  # in both worlds: results of steps are counted, not their starts
    actions = torch.zeros(4, 2, dtype=torch.int64)
    plain = Ride(Known())(play, actions)[..., 0].numpy()
    ride = CountedRide(Known(), 2)
    found = ride(play, actions)[..., 0].numpy()
    np.testing.assert_allclose(found, plain / np.sqrt([[1, 1], [2, 2], [1, 1], [3, 3]]), rtol=1e-6)
    ride.entered(1)
    other = CountedRide(Known(), 2)
    other.load_tensors(ride.tensors())
    for one in (ride, other):
        again = one(play, actions)[..., 0].numpy()
        np.testing.assert_allclose(again, plain / np.sqrt([[4, 1], [5, 2], [2, 1], [6, 3]]), rtol=1e-6)


def test_a_cell_is_a_coarse_view_of_the_table() -> None:
    """An agent that moves by a cell changes it; an agent that trembles does not."""
    world = World()
    world.load(Puzzle(task="sandbox", objects=(Placement("agent", 4, 4),)))
    images = [world.observe()]
    for action in (0, 1, 1, 1, 3, 3, 3):
        world.step(action)
        images.append(world.observe())
    first, still, *moved = cells(torch.from_numpy(np.stack(images)))
    assert first == still
    assert len({first, *moved}) >= 5
    grey = torch.full((3, 84, 84, 3), 100, dtype=torch.uint8) + torch.tensor([0, 1, 20], dtype=torch.uint8).view(
        3, 1, 1, 1
    )
    a, b, c = cells(grey)
    assert a == b != c


def test_own_error_is_the_models_errors_by_step_and_in_the_order_of_its_parts(images: Tensor) -> None:
    actions = torch.arange(6).view(3, 2)
    own = OwnError(Known())
    found = own(images, actions).numpy()
    assert own.parts == ("action", "change")
    np.testing.assert_array_equal(found[..., 0], actions.numpy())
    corner = images[:, :, 0, 0, 0].numpy().astype(np.float64)
    np.testing.assert_array_equal(found[..., 1], corner[1:] - corner[:-1])


def test_a_world_is_measured_without_shifts(images: Tensor) -> None:
    play = TransitionBatch(images[:, 0], torch.zeros(4, dtype=torch.int64), images[:, 1])
    assert Known().world_loss(play, torch.Generator()) == 0


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
