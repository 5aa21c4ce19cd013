"""Encoders that find objects, on images that are painted here: what they must find is known."""

import math
from typing import Literal

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.config import EncoderConfig, ObjectsConfig
from gym_open.agents.objects import Objects
from gym_open.agents.objects.encoders import ObjectEncoder, SlotEncoder
from gym_open.agents.objects.plane import CELLS, UNFITTED, plane_of
from gym_open.agents.world_model import TransitionBatch
from gym_open.envs.constants import CAMERA_POSITION, FIELD_OF_VIEW, PITCH, camera_axes
from gym_open.envs.vector import OpenVectorEnv

MOVES = [(0, 0), (-4, 0), (4, 0), (0, -4), (0, 4)]
COLOURS = np.array([[230, 40, 40], [40, 200, 60], [50, 60, 230]], np.uint8)
"""Of the agent and of two objects that do not move by themselves."""


def scenes(n: int, seed: int) -> TransitionBatch:
    """Three squares on a table that grows darker to one side; the first one moves with each action."""
    rng = np.random.default_rng(seed)
    table = np.broadcast_to((120 + np.arange(84) // 4).astype(np.uint8)[:, None, None], (84, 84, 3))
    images = np.repeat(np.repeat(table[None, None], n, axis=0), 2, axis=1)
    places, actions = rng.integers(8, 72, (n, 3, 2)), rng.integers(0, len(MOVES), n)
    for i in range(n):
        for t in range(2):
            for k in (2, 1, 0):
                row, column = places[i, k] + (np.array(MOVES[actions[i]]) if k == 0 and t == 1 else 0)
                images[i, t, row : row + 4, column : column + 4] = COLOURS[k]
    return TransitionBatch(*map(torch.from_numpy, (images[:, 0], actions, images[:, 1])))


def encoder(architecture: Literal["slots", "keypoints"], slots: int, seen: TransitionBatch) -> ObjectEncoder:
    made = make_image_encoder(EncoderConfig(architecture=architecture, slots=slots), torch.Generator().manual_seed(0))
    assert isinstance(made, ObjectEncoder)
    made.set_mean_image(seen.obs)
    return made


def learned(architecture: Literal["slots", "keypoints"], slots: int, updates: int) -> tuple[Objects, dict[str, float]]:
    seen = scenes(400, 0)
    model = Objects(encoder(architecture, slots, seen), ObjectsConfig(), len(MOVES), torch.Generator().manual_seed(1))
    model.watch(seen.obs)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    figures: dict[str, torch.Tensor] = {}
    rng, none = torch.Generator().manual_seed(2), torch.zeros(64, 2, dtype=torch.int64)
    for _ in range(updates):
        chosen = torch.randint(400, (64,), generator=rng)
        loss, figures = model.measure(TransitionBatch(*(part[chosen] for part in seen)), none, rng)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return model, {name: float(value) for name, value in figures.items()}


def test_the_background_is_the_median_and_holds_no_object() -> None:
    made = encoder("slots", 3, scenes(200, 0))
    assert torch.equal(made.mean_image[0, :, 5], (120 + torch.arange(84) // 4).float())


def test_slots_are_the_colours_and_maps_are_the_objects() -> None:
    seen = scenes(100, 0)
    made = encoder("slots", 3, seen)
    assert isinstance(made, SlotEncoder)
    made.fit_colours(seen.obs, np.random.default_rng(0))
    maps = made.maps(seen.obs[:20])
    assert maps.shape == (20, 42, 42, 3)
    assert maps.sum(dim=(1, 2)).max() == 4  # sixteen pixels, a quarter each
    assert (maps.sum(dim=(1, 2)) > 0).float().mean() > 0.9  # some squares are hidden by others
    for image, found in zip(seen.obs[:20].numpy(), maps.numpy(), strict=True):
        objects = (image.reshape(42, 2, 42, 2, 3).astype(int) - 130).__abs__().max(axis=(1, 3, 4)) > 30
        assert ((found.sum(axis=2) > 0) == objects).all()


@pytest.mark.learning
def test_the_agent_is_the_slot_that_moves_with_the_action() -> None:
    model, figures = learned("slots", 3, 150)
    assert figures["inverse_accuracy"] > 0.9
    colour = (model.encoder.colours[model.encoder.agent] * 255 / 20).round()  # type: ignore[operator]
    assert colour[0] > 50 > colour[2]  # red, against the background


@pytest.mark.learning
def test_keypoints_learn_to_reconstruct_and_to_name_the_action() -> None:
    model, figures = learned("keypoints", 4, 150)
    _, before = learned("keypoints", 4, 1)
    assert figures["reconstruction"] < 0.5 * before["reconstruction"]
    assert figures["inverse_accuracy"] > 0.6
    features = model.encoder.encode(scenes(5, 3).obs)
    assert features.shape == (5, model.encoder.config.width)
    assert features.isfinite().all()


def test_two_encoders_have_two_tables() -> None:
    one, other = (make_image_encoder(EncoderConfig(architecture="slots"), torch.Generator()) for _ in range(2))
    assert isinstance(one, SlotEncoder)
    assert isinstance(other, SlotEncoder)
    before = other.homography.clone()
    one.homography.mul_(2)
    assert torch.equal(other.homography, before)
    assert torch.equal(torch.tensor(UNFITTED), before)


def test_too_few_pixels_of_objects_are_told() -> None:
    seen = scenes(50, 0)
    made = encoder("slots", 3, seen)
    assert isinstance(made, SlotEncoder)
    empty = made.mean_image.permute(1, 2, 0).to(torch.uint8)[None]
    with pytest.raises(ValueError, match="0 pixels differ from the background, expected 3 or more"):
        made.fit_colours(empty, np.random.default_rng(0))


@pytest.mark.learning
def test_moves_in_the_world_show_where_the_true_camera_is() -> None:
    """300 worlds, ten moves in each: places that the encoder derives from its moves are those of the ray caster."""
    env = OpenVectorEnv(50, "sandbox", autoreset_mode=AutoresetMode.DISABLED, copy=True)
    rng, pairs = np.random.default_rng(0), list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for _ in range(6):
        seen, _ = env.reset(seed=rng.integers(0, 2**31, 50).tolist())
        for _ in range(10):
            actions = rng.integers(0, 9, 50)
            after = env.step(actions)[0]
            pairs.append((seen, actions, after))
            seen = after
    play = TransitionBatch(*(torch.from_numpy(np.concatenate(part)) for part in zip(*pairs, strict=True)))
    config = EncoderConfig(architecture="slots")
    made = make_image_encoder(config, torch.Generator())
    assert isinstance(made, SlotEncoder)
    made.set_mean_image(play.obs[::3])
    model = Objects(made, ObjectsConfig(), 9, torch.Generator().manual_seed(0))
    model.watch(play.obs[::3])
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    for step in range(150):
        chosen = torch.from_numpy(np.random.default_rng(step).integers(0, len(play.obs), 128))
        loss, _ = model.measure(TransitionBatch(*(part[chosen] for part in play)), torch.zeros(0), torch.Generator())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    found = model.finish(play)
    assert found["plane_moves"] > 1000
    assert found["plane_error"] < 0.15
    places = plane_of(made.homography.numpy()).places * PITCH
    true = table_places(height=0.04)
    inside = (np.abs(true) < [0.55, 1.0]).all(axis=2)
    assert np.median(np.linalg.norm(places - true, axis=2)[inside]) < 0.05  # metres; a cell is 0.141
    np.testing.assert_allclose(made.reach.numpy() * PITCH, [0.591, 1.072], atol=0.08)


def table_places(height: float) -> np.ndarray:
    """Where the middle of each cell of a map looks at the plane at this height, (42, 42, 2) in metres."""
    right, up, forward = camera_axes()
    position, reach = np.array(CAMERA_POSITION), math.tan(math.radians(FIELD_OF_VIEW / 2))
    across = (np.arange(CELLS) + 0.5) / (CELLS / 2) - 1
    rays = reach * (across[None, :, None] * right - across[:, None, None] * up) + forward
    return (position + (height - position[2]) / rays[..., 2:] * rays)[..., :2]
