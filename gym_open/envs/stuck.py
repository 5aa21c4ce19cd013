"""Detect an agent that cannot move, and objects wedged in a corner of the table. Nothing is reset because of it.

A *push* is any action except the no-op, during which no time passes.

- The agent becomes stuck when it stays within 2 cm for 32 pushes in a row. It is free again when it gets further. An
  agent that pushes into a wall is not stuck: it bounces off by 3 cm.
- An object becomes wedged when it has been in a corner for 256 pushes without a gap. It is free again when it leaves
  the corner. An object is in a corner while the gaps between it and two walls are both narrower than the agent, which
  then cannot get behind the object.
"""

import math
from typing import Literal

import msgspec
import numpy as np

from gym_open.envs.constants import RADIUS, RECTANGLE_LENGTH, WALL_X, WALL_Y
from gym_open.envs.physics.model import INVENTORY, kind_of

REACH_M = 0.02
AGENT_PUSHES = 32
CORNER_PUSHES = 256

_AGENT = INVENTORY.index("agent")
_GAP = 2 * RADIUS
"""Width of the agent."""
_LONGER = np.array([RECTANGLE_LENGTH / 2 - RADIUS if kind_of(name) == "rectangle" else 0.0 for name in INVENTORY])
"""(objects,) metres: half the length of an object minus half its height."""
_NEAR_X, _NEAR_Y = WALL_X - RADIUS - _GAP - _LONGER, WALL_Y - RADIUS - _GAP - _LONGER
"""(objects,) metres from the table's middle beyond which an object can be in a corner, in any orientation."""


class Stuck(msgspec.Struct, frozen=True):
    """The agent, or an object in a corner, cannot move any more, or can move again. Nothing is reset because of it."""

    step: int
    """Steps that the stream had taken."""
    segment: int
    """Number of the segment within its stream."""
    kind: Literal["agent", "corner"]
    name: str
    """Name of the object."""
    began: bool
    """True: stuck from here on. False: free again."""
    position: tuple[float, float, float]
    """Metres."""


class Watch(msgspec.Struct):
    """Watches one world during one segment. It is plain data, for a checkpoint."""

    segment: int
    """Number of the segment within its stream."""
    place: tuple[float, float, float]
    """Position in metres that the agent must leave by more than 2 cm; then its new position replaces it."""
    pushes: int = 0
    """Pushes since the last such change of `place`."""
    cornered: dict[str, int] = {}
    """Objects in a corner now, each with its number of pushes there without a gap."""

    @property
    def agent(self) -> bool:
        """Whether the agent is stuck."""
        return self.pushes >= AGENT_PUSHES

    @property
    def wedged(self) -> list[str]:
        """Objects wedged in a corner."""
        return [name for name, pushes in self.cornered.items() if pushes >= CORNER_PUSHES]

    def push(self, states: np.ndarray, step: int) -> list[Stuck]:
        """Update the watch after a push.

        Args:
            states: states of all objects, (objects, 13).
            step: number of steps that the stream has taken.

        Returns:
            A record for each agent or object that became stuck or free.
        """
        before = self._stuck()
        here = position(states, _AGENT)
        if math.dist(here, self.place) > REACH_M:
            self.place, self.pushes = here, 0
        else:
            self.pushes += 1
        self.cornered = {name: self.cornered.get(name, 0) + 1 for name in in_corner(states)}
        after = self._stuck()
        ceased = [self._record(name, states, step, began=False) for name in before if name not in after]
        return ceased + [self._record(name, states, step, began=True) for name in after if name not in before]

    def leave(self, states: np.ndarray, step: int) -> list[Stuck]:
        """Records that end all stuck states because the stream leaves the world; arguments as of `push`."""
        return [self._record(name, states, step, began=False) for name in self._stuck()]

    def _stuck(self) -> list[str]:
        return ["agent", *self.wedged] if self.agent else self.wedged

    def _record(self, name: str, states: np.ndarray, step: int, *, began: bool) -> Stuck:
        place = position(states, INVENTORY.index(name))
        return Stuck(step, self.segment, "agent" if name == "agent" else "corner", name, began, place)


def in_corner(states: np.ndarray) -> list[str]:
    """Names of the objects, except the agent, in a corner of the table; `states` is (objects, 13)."""
    x, y = np.abs(states[:, 0]), np.abs(states[:, 1])
    near = np.flatnonzero((x > _NEAR_X) & (y > _NEAR_Y) & (y < WALL_Y))
    return [INVENTORY[index] for index in near.tolist() if index != _AGENT and _no_way_behind(states[index], index)]


def _no_way_behind(state: np.ndarray, index: int) -> bool:
    """Whether the gaps between an object and two walls are too narrow for the agent."""
    x, y, _, w, qx, qy, qz = state[:7].tolist()
    # The reach of a rectangle towards a wall follows from the direction of its long axis, the x axis of its body.
    reach_x = RADIUS + _LONGER[index] * abs(1 - 2 * (qy * qy + qz * qz))
    reach_y = RADIUS + _LONGER[index] * abs(2 * (qx * qy + w * qz))
    return bool(WALL_X - reach_x - abs(x) < _GAP and WALL_Y - reach_y - abs(y) < _GAP)


def position(states: np.ndarray, index: int = _AGENT) -> tuple[float, float, float]:
    """Position in metres of an object, by default the agent; `states` is (objects, 13)."""
    x, y, z = states[index, :3].tolist()
    return x, y, z
