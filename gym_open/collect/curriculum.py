"""The non-episodic curriculum: when a stream leaves its world, and for which. Decisions fall between rollouts.

The paper's rule, `loss`:

    "we switch environments whenever the loss of the world model drops below a certain threshold. When this happens we
    switch to the environment with the highest loss among the current pool. Exploration terminates when no new
    environment gives the agent a loss higher than a threshold."

The *loss of a world*, in one place:

- of a world never visited: infinite, so fresh worlds come first, the lowest index before the others;
- of a world left behind: the world model's loss, with its weights of now, on the last transitions kept of the world,
  times the model's scale, so that one threshold serves all models;
- of a world being played in: the same, averaged over the last `window` rollouts, or those since it was entered;
- of any world, for an explorer without a world model: not a number.

Probing a world costs no interaction: nothing is played for it.

A world is *learned* when its loss is under the threshold; one being played in, not before the window is full: a model
soon knows the few pictures of a first rollout by heart. With several streams a world holds at most one of them, and
streams decide in turn: one whose world is learned while all unlearned ones are taken stays until one is free. One
stream is the paper's rule.

The other rules are for comparison. They decide every `interval` steps in a world and never end a run.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from typing import ClassVar, Literal

import msgspec

from gym_open import seeding
from gym_open.collect.config import CurriculumConfig, RuleName


class Situation(msgspec.Struct, frozen=True):
    """What a stream decides on."""

    losses: Sequence[float]
    """Of every world of the pool."""
    last_losses: Sequence[float]
    """The same when any stream decided before; infinite before the first decision."""
    current: int
    """The world that the stream is in."""
    taken: Collection[int]
    """Worlds that other streams are in."""
    number: int
    """Decisions that were made before in this run."""

    def free(self) -> list[int]:
        """Worlds that no other stream is in, the stream's own among them, in order."""
        return [world for world in range(len(self.losses)) if world not in self.taken]


class Decision(msgspec.Struct, frozen=True):
    """What a stream does next: `stay`, stop since all worlds are learned (`exhausted`), or go to another, and why."""

    kind: Literal["stay", "learned", "exhausted", "interval", "uniform", "progress"]
    world: int
    """Where the stream is then; −1 if it stops."""


class Rule(ABC):
    """Decides for one stream at a time.

    Args:
        config: threshold and interval.
        seed: root of the randomness of rules that have any.
    """

    needs_losses: ClassVar[bool] = False
    """Whether it means nothing without a world model."""

    def __init__(self, config: CurriculumConfig, seed: int) -> None:
        self.config, self.seed = config, seed

    @abstractmethod
    def due(self, loss: float, steps: int) -> bool:
        """Whether a stream has something to decide.

        Args:
            loss: of its world.
            steps: taken there since it was entered, or since the last decision to stay.
        """

    @abstractmethod
    def decide(self, situation: Situation) -> Decision:
        """Decide for a stream that is due."""


class LossRule(Rule):
    """The paper's: leave a learned world for the one of highest loss, stop when all are learned."""

    needs_losses = True

    def due(self, loss: float, steps: int) -> bool:  # noqa: ARG002  # the interface's
        """When its world is learned."""
        return loss < self.config.threshold

    def decide(self, situation: Situation) -> Decision:
        """Go to the unlearned world of highest loss that is free."""
        losses = situation.losses
        if max(losses) < self.config.threshold:
            return Decision("exhausted", -1)
        free = [world for world in situation.free() if losses[world] >= self.config.threshold]
        if not free:
            return Decision("stay", situation.current)
        return Decision("learned", max(free, key=lambda world: (losses[world], -world)))


class NeverRule(Rule):
    """Each stream stays in its first world."""

    def due(self, loss: float, steps: int) -> bool:  # noqa: ARG002
        """Never."""
        return False

    def decide(self, situation: Situation) -> Decision:
        """Stay."""
        return Decision("stay", situation.current)


class IntervalRule(Rule):
    """Every so many steps to the next world in order that is free."""

    def due(self, loss: float, steps: int) -> bool:  # noqa: ARG002
        """Every `interval` steps in a world."""
        return steps >= self.config.interval

    def decide(self, situation: Situation) -> Decision:
        """Go to the next free world; after the last comes the first."""
        later = [world for world in situation.free() if world > situation.current]
        world = [*later, *situation.free()][0]
        return Decision("stay" if world == situation.current else "interval", world)


class UniformRule(IntervalRule):
    """Every so many steps to another free world, all alike likely."""

    def decide(self, situation: Situation) -> Decision:
        """Draw from a generator of the decision's own number."""
        others = [world for world in situation.free() if world != situation.current]
        if not others:
            return Decision("stay", situation.current)
        rng = seeding.generator(self.seed, "collect", "curriculum", situation.number)
        return Decision("uniform", others[int(rng.integers(len(others)))])


class ProgressRule(IntervalRule):
    """Every so many steps to the free world whose loss changed most since the last decision, fresh ones first.

    The stream's own world is among them. A world first entered since then has changed infinitely, so it is stayed in
    once more: only then is its progress known.
    """

    needs_losses = True

    def decide(self, situation: Situation) -> Decision:
        """Go to where most is being learned or forgotten."""

        def interest(world: int) -> tuple[bool, float, int]:
            now = situation.losses[world]
            fresh = math.isinf(now)
            return fresh, 0.0 if fresh else abs(situation.last_losses[world] - now), -world

        world = max(situation.free(), key=interest)
        return Decision("stay" if world == situation.current else "progress", world)


RULES: dict[RuleName, type[Rule]] = {
    "loss": LossRule,
    "never": NeverRule,
    "interval": IntervalRule,
    "uniform": UniformRule,
    "progress": ProgressRule,
}


def smoothed(recent: Sequence[float]) -> float:
    """Mean of the last losses measured of a world being played in; infinite before anything was."""
    return sum(recent) / len(recent) if recent else math.inf
