"""The non-episodic curriculum of the paper: leave a world when it is learned, for the one that is learned least.

    "we switch environments whenever the loss of the world model drops below a certain threshold. When this happens we
    switch to the environment with the highest loss among the current pool. Exploration terminates when no new
    environment gives the agent a loss higher than a threshold."

The *loss of a world*, in one place:

- of a world never visited: infinite, so fresh worlds come first, the lowest index before the others;
- of a world left behind: the world model's loss, with its weights of now, on the last observations kept of the world;
- of a world being played in: the same, averaged over the last few rollouts since it was entered.

A world is *learned* when its loss is under the threshold. Decisions fall between rollouts. With several streams a world
holds at most one of them: a stream whose world is learned while all unlearned ones are taken stays until one is free.
One stream is the paper's rule.
"""

import math
from collections.abc import Collection, Sequence
from typing import Literal

import msgspec


class Decision(msgspec.Struct, frozen=True):
    """What a stream does next: `stay`, go to `world` because its own is `learned`, or stop: all are (`exhausted`)."""

    kind: Literal["stay", "learned", "exhausted"]
    world: int
    """Where the stream is then; −1 if it stops."""


def decide(losses: Sequence[float], current: int, taken: Collection[int], threshold: float) -> Decision:
    """Decide for one stream.

    Args:
        losses: loss of every world of the pool.
        current: where the stream is.
        taken: worlds that other streams are in.
        threshold: a world is learned when its loss is under this.
    """
    if losses[current] >= threshold:
        return Decision("stay", current)
    unlearned = [world for world, loss in enumerate(losses) if loss >= threshold]
    if not unlearned:
        return Decision("exhausted", -1)
    free = [world for world in unlearned if world not in taken]
    if not free:
        return Decision("stay", current)
    return Decision("learned", max(free, key=lambda world: (losses[world], -world)))


def smoothed(recent: Sequence[float]) -> float:
    """Mean of the last losses measured of a world being played in; infinite before anything was."""
    return sum(recent) / len(recent) if recent else math.inf
