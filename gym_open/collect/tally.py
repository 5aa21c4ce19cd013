"""What happened in a world, counted: visits, steps, where the agent was, what it touched, what got stuck."""

from collections.abc import Iterable

import msgspec

from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS
from gym_open.envs.physics.contacts import Contact
from gym_open.formats.logs.schemas import Stuck

TOUCHED = ("yellow", "green", "heavy", "light", "push", "rectangle", "cone", "wall", "corner", "pen", "ramp")
"""What the agent can touch: kinds of objects, then of scenery; kinds that it never touched are counted as 0."""
STUCK = ("agent", "corner")


class StuckCount(msgspec.Struct):
    """How often something got stuck, and for how many steps at least one thing was."""

    times: int = 0
    steps: int = 0


def _none_touched() -> dict[str, int]:
    return dict.fromkeys(TOUCHED, 0)


def _none_stuck() -> dict[str, StuckCount]:
    return {kind: StuckCount() for kind in STUCK}


class Tally(msgspec.Struct):
    """Counts of one world, all streams together; plain data, for a checkpoint."""

    visits: int = 0
    """How often it was entered."""
    steps: int = 0
    cells: list[int] = msgspec.field(default_factory=lambda: [0] * (ROWS * COLUMNS))
    """Steps after which the agent was in each cell of the placement grid, row by row."""
    touches: dict[str, int] = msgspec.field(default_factory=_none_touched)
    """Things of each kind that the agent touched, counted anew every step."""
    stuck: dict[str, StuckCount] = msgspec.field(default_factory=_none_stuck)
    """By what was stuck: `agent`, or an object in a `corner`."""

    def step(self, agent: tuple[float, float, float], contacts: Iterable[Contact]) -> None:
        """Count a step after which the agent is at a place (metres), with what touched what in it."""
        self.steps += 1
        self.cells[cell_at(agent[0], agent[1])] += 1
        for contact in contacts:
            if "agent" in (contact.a, contact.b):
                other = contact.b if contact.a == "agent" else contact.a
                self.touches[other.split("_")[0]] += 1

    def stuck_step(self, turns: Iterable[Stuck], *, agent: bool, corner: bool) -> None:
        """Count what began to be stuck with a step, and whether the agent, or an object in a corner, is so after it."""
        for turn in turns:
            self.stuck[turn.kind].times += turn.began
        self.stuck["agent"].steps += agent
        self.stuck["corner"].steps += corner

    def cells_seen(self) -> int:
        """Cells of the table in which the agent was."""
        return sum(count > 0 for count in self.cells)


def cell_at(x: float, y: float) -> int:
    """Number, row by row, of the placement grid's cell that a place on the table (metres) is in, or is nearest to."""
    row, column = round((CELL_0[1] - y) / PITCH), round((x - CELL_0[0]) / PITCH)
    return min(max(row, 0), ROWS - 1) * COLUMNS + min(max(column, 0), COLUMNS - 1)
