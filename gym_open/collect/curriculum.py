"""The non-episodic curriculum: when a stream leaves its world, and which one it enters. It decides between rollouts.

The paper's rule, `loss`:

    "we switch environments whenever the loss of the world model drops below a certain threshold. When this happens we
    switch to the environment with the highest loss among the current pool. Exploration terminates when no new
    environment gives the agent a loss higher than a threshold."

The *loss of a world*, defined in one place:

- of a world that was never visited: infinite. So fresh worlds come first, in the order of their indices;
- of a world that was left: the loss of the world model, with its present weights, on the last transitions of the world,
  times the model's scale, so that one threshold serves all models;
- of a world that a stream is in: the same, averaged over the last `window` rollouts, or those since it was entered;
- of any world, for an explorer without a world model: NaN.

Measuring the loss of a world takes no steps in it.

A world is *learned* when its loss is below the threshold. A world that a stream is in is not learned before the window
is full, because a model soon memorises the few images of a first rollout. With several streams, a world holds at most
one of them, and streams decide in turn. If the world of a stream is learned and all unlearned worlds are taken, the
stream stays until one is free. With one stream, this is the paper's rule.

The other rules are for comparison. They decide every `interval` steps in a world, and never end a run.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from typing import ClassVar, Literal

import msgspec

from gym_open import seeding
from gym_open.collect.config import CurriculumConfig, RuleName


class Situation(msgspec.Struct, frozen=True):
    """The input of a stream's decision."""

    losses: Sequence[float]
    """Loss of every world of the pool."""
    last_losses: Sequence[float]
    """The losses at the previous decision of any stream; infinite before the first decision."""
    current: int
    """The world that the stream is in."""
    taken: Collection[int]
    """Worlds that other streams are in."""
    number: int
    """Number of earlier decisions in this run."""

    def free(self) -> list[int]:
        """Worlds that no other stream is in, including the stream's own, in order."""
        return [world for world in range(len(self.losses)) if world not in self.taken]


class Decision(msgspec.Struct, frozen=True):
    """What a stream does next: `stay`, stop because all worlds are learned (`exhausted`), or switch, and why."""

    kind: Literal["stay", "learned", "exhausted", "interval", "uniform", "progress"]
    world: int
    """The next world of the stream; −1 if it stops."""


class Rule(ABC):
    """Decides for one stream at a time.

    Args:
        config: threshold and interval.
        seed: root seed of random decisions.
    """

    needs_losses: ClassVar[bool] = False
    """Whether the rule needs a world model."""

    def __init__(self, config: CurriculumConfig, seed: int) -> None:
        self.config, self.seed = config, seed

    @abstractmethod
    def due(self, loss: float, steps: int) -> bool:
        """Whether a stream must decide now.

        Args:
            loss: loss of its world.
            steps: steps in the world since it was entered, or since the last decision to stay.
        """

    @abstractmethod
    def decide(self, situation: Situation) -> Decision:
        """Decide for a stream that is due."""


class LossRule(Rule):
    """The paper's rule: leave a learned world for the one of highest loss, and stop when all are learned."""

    needs_losses = True

    def due(self, loss: float, steps: int) -> bool:  # noqa: ARG002  # the interface's
        """When its world is learned."""
        return loss < self.config.threshold

    def decide(self, situation: Situation) -> Decision:
        """Enter the free unlearned world with the highest loss."""
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
    """Every `interval` steps, enter the next free world in order."""

    def due(self, loss: float, steps: int) -> bool:  # noqa: ARG002
        """Every `interval` steps in a world."""
        return steps >= self.config.interval

    def decide(self, situation: Situation) -> Decision:
        """Enter the next free world; after the last one, the first."""
        later = [world for world in situation.free() if world > situation.current]
        world = [*later, *situation.free()][0]
        return Decision("stay" if world == situation.current else "interval", world)


class UniformRule(IntervalRule):
    """Every `interval` steps, enter another free world, chosen uniformly at random."""

    def decide(self, situation: Situation) -> Decision:
        """Draw from a generator that depends on the number of the decision."""
        others = [world for world in situation.free() if world != situation.current]
        if not others:
            return Decision("stay", situation.current)
        rng = seeding.generator(self.seed, "collect", "curriculum", situation.number)
        return Decision("uniform", others[int(rng.integers(len(others)))])


class ProgressRule(IntervalRule):
    """Every `interval` steps, enter the free world whose loss changed most since the last decision; fresh ones first.

    The choice includes the stream's own world. The loss of a world that was first entered since then has changed
    infinitely. So the stream stays in it once more: only after that is its progress known.
    """

    needs_losses = True

    def decide(self, situation: Situation) -> Decision:
        """Enter the world in which the model learns or forgets most."""

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
    """Mean of the latest losses of a world that a stream is in; infinite before the first measurement."""
    return sum(recent) / len(recent) if recent else math.inf
