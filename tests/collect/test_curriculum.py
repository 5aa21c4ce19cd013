"""The paper's rule: leave a learned world for the one of highest loss, stop when none is above the threshold."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.collect.curriculum import Decision, decide, smoothed

loss = st.one_of(st.just(math.inf), st.floats(0, 10), st.sampled_from([0.0, 1.0, 2.0]))


@st.composite
def situations(draw: st.DrawFn, *, learned: bool = False) -> tuple[list[float], int, set[int], float]:
    """Losses, the world a stream is in, those taken by others, and the threshold; its world `learned` or any."""
    losses = draw(st.lists(loss, min_size=1, max_size=8))
    current = draw(st.integers(0, len(losses) - 1))
    taken = draw(st.sets(st.integers(0, len(losses) - 1), max_size=3)) - {current}
    threshold = draw(st.floats(0.1, 5))
    if learned:
        losses[current] = threshold / 2
    return losses, current, taken, threshold


@pytest.mark.parametrize(
    ("losses", "current", "taken", "expected"),
    [
        ([0.5, 3.0, 2.0], 1, (), Decision("stay", 1)),
        ([0.5, 3.0, 2.0], 0, (), Decision("learned", 1)),
        ([0.5, 3.0, math.inf, math.inf], 0, (), Decision("learned", 2)),
        ([0.5, 3.0, 2.0], 0, (1,), Decision("learned", 2)),
        ([0.5, 3.0, 0.2], 0, (1,), Decision("stay", 0)),
        ([0.5, 0.9, 0.2], 0, (1,), Decision("exhausted", -1)),
        ([1.0], 0, (), Decision("stay", 0)),
        ([0.999], 0, (), Decision("exhausted", -1)),
    ],
)
def test_cases(losses: list[float], current: int, taken: tuple[int, ...], expected: Decision) -> None:
    assert decide(losses, current, taken, threshold=1.0) == expected


@given(situations())
def test_a_world_is_left_only_when_it_is_learned(situation: tuple[list[float], int, set[int], float]) -> None:
    losses, current, taken, threshold = situation
    decision = decide(losses, current, taken, threshold)
    assert (decision.kind == "stay") == (decision.world == current)
    if decision.kind != "stay":
        assert losses[current] < threshold


@given(situations(learned=True))
def test_the_next_world_is_free_and_the_least_learned(situation: tuple[list[float], int, set[int], float]) -> None:
    losses, current, taken, threshold = situation
    decision = decide(losses, current, taken, threshold)
    free = [world for world in range(len(losses)) if world not in taken and losses[world] >= threshold]
    assert (decision.kind == "learned") == bool(free)
    if free:
        assert decision.world == sorted(free, key=lambda world: (-losses[world], world))[0]


@given(situations())
def test_it_stops_exactly_when_every_world_is_learned(situation: tuple[list[float], int, set[int], float]) -> None:
    losses, current, taken, threshold = situation
    decision = decide(losses, current, taken, threshold)
    assert (decision.kind == "exhausted") == all(one < threshold for one in losses)


def test_one_stream_visits_all_worlds_in_turn_and_stops() -> None:
    """A model that learns a world by visiting it once, and forgets nothing: each world is played in exactly once."""
    losses = [math.inf] * 5
    order, world = [], 0
    while world != -1:
        order.append(world)
        losses[world] = 0.1
        world = decide(losses, world, (), threshold=1.0).world
    assert order == [0, 1, 2, 3, 4]


def test_the_smoothed_loss_is_the_mean_and_infinite_before_the_first() -> None:
    assert smoothed([]) == math.inf
    assert smoothed([1.0, 2.0, 6.0]) == 3.0
