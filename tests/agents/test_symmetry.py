"""Symmetries of the table: a group, what it does to actions and features, and a policy that has it exactly."""

import numpy as np
import pytest
import torch

from gym_open.agents.architectures import make_encoder
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import StateEncoder
from gym_open.agents.policy import ActorCritic
from gym_open.agents.symmetry import ACTIONS, ELEMENTS, QUOTIENTS, TurnsBuilder
from gym_open.envs.constants import MOVES
from gym_open.envs.puzzles import Pen, Placement, Puzzle
from gym_open.envs.state import STATE_SIZE, state_vector
from gym_open.envs.world import World

TABLE = EncoderConfig(architecture="slots", slots=2)


def policy(trunk: tuple[int, ...] = (16, 24)) -> ActorCritic:
    torch.manual_seed(0)
    made = ActorCritic(
        make_encoder(TABLE, torch.Generator()), len(MOVES), torch.Generator().manual_seed(0),
        trunk=trunk, symmetric=True, frozen=True,
    )  # fmt: skip
    with torch.no_grad():
        for parameter in made.parameters():  # biases and logits of weight nothing would show nothing
            parameter.add_(0.1 * torch.randn(parameter.shape))
    return made


def test_the_elements_are_a_group_that_begins_with_the_identity_and_the_reflections() -> None:
    found = {element.tobytes() for element in ELEMENTS}
    assert len(found) == 8
    assert all((a @ b).tobytes() in found for a in ELEMENTS for b in ELEMENTS)
    assert (ELEMENTS[0] == np.eye(2)).all()
    assert all(np.count_nonzero(element - np.diag(np.diag(element))) == 0 for element in ELEMENTS[:4])
    for g, element in enumerate(ELEMENTS):
        for h, other in enumerate(ELEMENTS):
            assert (ELEMENTS[QUOTIENTS[g, h]] @ element == other).all()


def test_actions_turn_like_the_moves_that_they_make() -> None:
    for g, element in enumerate(ELEMENTS):
        for action, move in enumerate(MOVES):
            assert MOVES[ACTIONS[g, action]] == tuple(element @ move)


def test_features_turn_like_what_they_stand_for() -> None:
    """A vector is multiplied, a distance to a wall and the mass at a place move, a number stays."""
    builder = TurnsBuilder()
    builder.scalars(1)
    builder.vectors(2)
    builder.directions([(1, 0), (0, 1), (-1, 0), (0, -1)])
    source, sign = builder.build()
    features = torch.tensor([7.0, 1, 2, 3, -4, 10, 20, 30, 40])
    mirror = next(g for g, element in enumerate(ELEMENTS) if (element == [[-1, 0], [0, 1]]).all())
    assert (features[source[mirror]] * sign[mirror]).tolist() == [7, -1, 2, -3, -4, 30, 20, 10, 40]
    quarter = next(g for g, element in enumerate(ELEMENTS) if (element == [[0, -1], [1, 0]]).all())
    assert (features[source[quarter]] * sign[quarter]).tolist() == [7, -2, 1, 4, 3, 40, 10, 20, 30]


@pytest.mark.parametrize("trunk", [(8,), (16, 24), (8, 16, 8)])
def test_a_symmetric_policy_turns_with_the_world(trunk: tuple[int, ...]) -> None:
    made = policy(trunk)
    features = torch.randn(6, TABLE.width)
    assert made.encoder.turns is not None
    source, sign = made.encoder.turns
    with torch.no_grad():
        logits, values = made.heads(features)
        assert logits.std() > 0.01
        for g in range(8):
            turned, same = made.heads(features[:, source[g]] * sign[g])
            torch.testing.assert_close(same, values, rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(turned[:, ACTIONS[g]], logits, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(features[:, source[3]] * sign[3], features)


def test_a_plain_policy_does_not() -> None:
    made = ActorCritic(make_encoder(TABLE, torch.Generator()), 9, torch.Generator().manual_seed(0), trunk=(16,))
    features = torch.randn(6, TABLE.width)
    assert made.encoder.turns is not None
    source, sign = made.encoder.turns
    assert not torch.allclose(made.heads(features)[1], made.heads(features[:, source[3]] * sign[3])[1], atol=1e-3)


def test_a_turned_world_has_the_turned_state() -> None:
    """Turns of the simulator state are those of the simulator: a mirrored puzzle has the mirrored state vector."""
    objects = (Placement("agent", 4, 4), Placement("yellow", 2, 6), Placement("heavy", 12, 1))
    mirrored = (Placement("agent", 4, 4), Placement("yellow", 2, 2), Placement("heavy", 12, 7))
    states = []
    for placed, side, at in ((objects, "east", 3), (mirrored, "west", 5)):
        world = World()
        world.load(Puzzle(task="sandbox", objects=placed, pen=Pen(row=8, column=at, ramp_side=side)))  # type: ignore
        states.append(torch.from_numpy(state_vector(world)))
    source, sign = StateEncoder(EncoderConfig(architecture="state")).turns
    mirror = next(g for g, element in enumerate(ELEMENTS) if (element == [[-1, 0], [0, 1]]).all())
    turned = states[0][source[mirror]] * sign[mirror]
    torch.testing.assert_close(turned, states[1], atol=0.06, rtol=0)  # the cells' middle is not quite the table's


def test_the_configuration_knows_the_size_of_a_state() -> None:
    assert EncoderConfig(architecture="state").width == STATE_SIZE


def test_features_of_a_network_have_no_symmetries() -> None:
    with pytest.raises(ValueError, match="features of architecture 'cnn' have no symmetries"):
        ActorCritic(make_encoder(EncoderConfig(), torch.Generator()), 9, torch.Generator(), trunk=(16,), symmetric=True)


@pytest.mark.parametrize("g", range(1, 4))
def test_the_worlds_physics_has_the_reflections(g: int) -> None:
    """The mirrored moves in the mirrored world lead to the mirrored places, until contacts amplify rounding."""
    x, y = ELEMENTS[g].diagonal().tolist()

    def places(mirrored: bool) -> np.ndarray:
        cells = {"agent": (6, 2), "yellow": (9, 5), "heavy": (3, 6)}
        objects = tuple(
            Placement(kind, 15 - row if mirrored and y < 0 else row, 8 - column if mirrored and x < 0 else column)
            for kind, (row, column) in cells.items()
        )
        world = World()
        world.load(Puzzle(task="sandbox", objects=objects))
        path = []
        for action in [2, 2, 3, 8, 8, 1, 7, 5]:
            world.step(int(ACTIONS[g, action]) if mirrored else action)
            path.append(world.object_state()[world.present][:, :2].copy())
        return np.array(path)

    middle = np.array([-0.581 + 4 * 0.141, 1.0559 - 7.5 * 0.141])  # of the cells, a little off the table's
    np.testing.assert_allclose((places(mirrored=True) - middle) * [x, y], places(mirrored=False) - middle, atol=2e-2)
