"""Symmetries of the table, and the layers of a policy that has them.

If a table is mirrored, every object is mirrored, and the mirrored move does what the move did. The same holds for a
quarter turn, if the policy is told the distances to the walls. A policy of these layers has the symmetry built in
(Cohen & Welling 2016, "Group equivariant convolutional networks"): what it learns in one corner, it knows in all. This
needs features that say where things are on the table: an image from a tilted camera has no such symmetry.

A hidden layer holds one copy of each of its filters per symmetry. Copy g sees the world as g turns it. A turn of the
world permutes the copies, so that the value stays and the actions turn with the world.
"""

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gym_open.agents.config import SYMMETRIES
from gym_open.envs.constants import MOVES

ELEMENTS = np.array([
    [[x, 0], [0, y]] if straight else [[0, x], [y, 0]]
    for straight in (True, False) for x in (1, -1) for y in (1, -1)
])  # fmt: skip
"""The eight symmetries of a square, (8, 2, 2): places p become `element @ p`. The first four, the identity foremost,
are those of a rectangle."""
ACTIONS = torch.tensor([[MOVES.index(tuple((turn @ move).tolist())) for move in np.array(MOVES)] for turn in ELEMENTS])
"""What each action becomes, (8, 9) int64."""
_NUMBER = {turn.tobytes(): g for g, turn in enumerate(ELEMENTS)}
QUOTIENTS = torch.tensor([[_NUMBER[(other @ turn.T).tobytes()] for other in ELEMENTS] for turn in ELEMENTS])
"""Number of `other · turn⁻¹` for each turn and other, (8, 8) int64."""


class Turns(NamedTuple):
    """How features change: under element g, feature f becomes `sign[g, f] · feature[source[g, f]]`."""

    source: Tensor
    """(8, features) int64."""
    sign: Tensor
    """(8, features) float32."""


class TurnsBuilder:
    """Puts the turns of a vector of features together, part by part, in the order of the features."""

    def __init__(self) -> None:
        self._source: list[list[int]] = [[] for _ in ELEMENTS]
        self._sign: list[list[float]] = [[] for _ in ELEMENTS]

    def scalars(self, count: int) -> None:
        """Add `count` numbers that no symmetry changes."""
        begin = len(self._source[0])
        for source, sign in zip(self._source, self._sign, strict=True):
            source.extend(range(begin, begin + count))
            sign.extend([1.0] * count)

    def vectors(self, count: int) -> None:
        """Add `count` pairs (x, y)."""
        begin = len(self._source[0])
        for turn, source, sign in zip(ELEMENTS, self._source, self._sign, strict=True):
            for pair in range(begin, begin + 2 * count, 2):
                for row in turn:
                    axis = int(np.flatnonzero(row)[0])
                    source.append(pair + axis)
                    sign.append(float(row[axis]))

    def directions(self, directions: list[tuple[int, int]]) -> None:
        """Add one number for each of these directions (x, y), such as the distance to the wall that is there."""
        self.places(np.array(directions))

    def places(self, places: np.ndarray, count: int = 1) -> None:
        """Add one number for each of these places (P, 2), which the symmetries permute, `count` times."""
        order = {tuple(place): i for i, place in enumerate(places.tolist())}
        for _ in range(count):
            begin = len(self._source[0])
            for turn, source, sign in zip(ELEMENTS, self._source, self._sign, strict=True):
                # the number at place p comes from the place that the element takes to p
                source.extend(begin + order[tuple(place)] for place in (places @ turn).tolist())
                sign.extend([1.0] * len(places))

    def build(self) -> Turns:
        """The turns of all features that were added."""
        return Turns(torch.tensor(self._source), torch.tensor(self._sign))


class Lift(nn.Module):
    """First layer: features to 8 copies of `filters`.

    Args:
        turns: what the symmetries do to the features.
        filters: of each copy.
        generator: source of the weights, orthogonal of gain √2.
    """

    inverse: Tensor
    sign: Tensor

    def __init__(self, turns: Turns, filters: int, generator: torch.Generator) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(filters, turns.source.shape[1]))
        self.bias = nn.Parameter(torch.zeros(filters))
        nn.init.orthogonal_(self.weight, 2**0.5, generator=generator)
        inverse = turns.source.argsort(dim=1)
        self.register_buffer("inverse", inverse, persistent=False)
        self.register_buffer("sign", turns.sign.gather(1, inverse), persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        """(B, features) to (B, 8 · filters)."""
        tied = (self.weight[:, self.inverse] * self.sign).transpose(0, 1)
        return F.linear(features, tied.flatten(0, 1), self.bias.repeat(SYMMETRIES))


class GroupLayer(nn.Module):
    """Hidden layer: 8 copies of `inputs` filters to 8 copies of `outputs`."""

    quotients: Tensor

    def __init__(self, inputs: int, outputs: int, generator: torch.Generator) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, SYMMETRIES, inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.orthogonal_(self.weight, 2**0.5, generator=generator)  # as a matrix: (outputs, 8 · inputs)
        self.register_buffer("quotients", QUOTIENTS, persistent=False)

    def forward(self, hidden: Tensor) -> Tensor:
        """(B, 8 · inputs) to (B, 8 · outputs)."""
        tied = self.weight[:, self.quotients].transpose(0, 1)  # copy, output, other copy, input
        return F.linear(hidden, tied.flatten(2).flatten(0, 1), self.bias.repeat(SYMMETRIES))


class GroupActor(nn.Module):
    """Policy head: logits that turn with the world."""

    actions: Tensor

    def __init__(self, filters: int, generator: torch.Generator, std: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(ACTIONS.shape[1], filters))
        nn.init.orthogonal_(self.weight, std, generator=generator)
        self.register_buffer("actions", ACTIONS, persistent=False)

    def forward(self, hidden: Tensor) -> Tensor:
        """(B, 8 · filters) to (B, 9)."""
        return F.linear(hidden, self.weight[self.actions].transpose(0, 1).flatten(1))


class GroupCritic(nn.Module):
    """Value head: a value that no symmetry changes."""

    def __init__(self, filters: int, generator: torch.Generator, std: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(1, filters))
        self.bias = nn.Parameter(torch.zeros(1))
        nn.init.orthogonal_(self.weight, std, generator=generator)

    def forward(self, hidden: Tensor) -> Tensor:
        """(B, 8 · filters) to (B, 1)."""
        return F.linear(hidden.unflatten(1, (SYMMETRIES, -1)).mean(dim=1), self.weight, self.bias)
