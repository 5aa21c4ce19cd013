"""The paper's rule: leave a learned world for the one of highest loss, stop when all are learned. And other rules."""

import math
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.collect.config import CurriculumConfig, RuleName
from gym_open.collect.curriculum import RULES, Decision, Situation, smoothed

INF = math.inf
NAN = math.nan
loss = st.one_of(st.just(INF), st.floats(0, 10), st.sampled_from([0.0, 1.0, 2.0]))


def decide(
    rule: RuleName, losses: list[float], current: int, taken: set[int], *, threshold: float = 1.0,
    last: list[float] | None = None, number: int = 0, seed: int = 0,
) -> Decision:  # fmt: skip
    """Decide as a run does: a stream that need not decide stays."""
    made = RULES[rule](CurriculumConfig(rule=rule, threshold=threshold, interval=100), seed)
    if not made.due(losses[current], 100):
        return Decision("stay", current)
    return made.decide(Situation(losses, last or [INF] * len(losses), current, taken, number))


@st.composite
def situations(draw: st.DrawFn) -> tuple[list[float], int, set[int]]:
    """Losses, the world of the stream, and the worlds of other streams."""
    losses = draw(st.lists(loss, min_size=1, max_size=8))
    current = draw(st.integers(0, len(losses) - 1))
    return losses, current, draw(st.sets(st.integers(0, len(losses) - 1), max_size=3)) - {current}


@pytest.mark.parametrize(
    ("losses", "current", "taken", "expected"),
    [
        ([0.5, 3.0, 2.0], 1, set(), Decision("stay", 1)),
        ([0.5, 3.0, 2.0], 0, set(), Decision("learned", 1)),
        ([0.5, 3.0, INF, INF], 0, set(), Decision("learned", 2)),
        ([0.5, 3.0, 2.0], 0, {1}, Decision("learned", 2)),
        ([0.5, 3.0, 0.2], 0, {1}, Decision("stay", 0)),
        ([0.5, 0.9, 0.2], 0, {1}, Decision("exhausted", -1)),
        ([1.0], 0, set(), Decision("stay", 0)),
        ([0.999], 0, set(), Decision("exhausted", -1)),
    ],
)
def test_the_papers_rule(losses: list[float], current: int, taken: set[int], expected: Decision) -> None:
    assert decide("loss", losses, current, taken) == expected


@given(situations())
def test_a_world_is_left_only_when_it_is_learned(situation: tuple[list[float], int, set[int]]) -> None:
    losses, current, taken = situation
    decision = decide("loss", losses, current, taken)
    if losses[current] >= 1:
        assert decision == Decision("stay", current)
    assert (decision.kind == "exhausted") == all(one < 1 for one in losses)
    if losses[current] < 1 <= max(losses):
        free = [world for world in range(len(losses)) if world not in taken and losses[world] >= 1]
        best = sorted(free, key=lambda world: (-losses[world], world))
        assert decision == (Decision("learned", best[0]) if best else Decision("stay", current))


def test_one_stream_visits_all_worlds_in_turn_and_stops() -> None:
    """A model that learns a world in one visit, and forgets nothing: each world is visited exactly once."""
    losses = [INF] * 5
    order, world = [], 0
    while world != -1:
        order.append(world)
        losses[world] = 0.1
        world = decide("loss", losses, world, set()).world
    assert order == [0, 1, 2, 3, 4]


@given(situations(), st.sampled_from(["interval", "uniform", "progress"]), st.integers(0, 99))
def test_the_other_rules_enter_a_free_world_and_never_stop(
    situation: tuple[list[float], int, set[int]], rule: RuleName, number: int
) -> None:
    losses, current, taken = situation
    decision = decide(rule, losses, current, taken, number=number)
    assert decision.world not in taken
    assert decision.kind == ("stay" if decision.world == current else rule)
    if rule != "progress" and len(losses) > len(taken) + 1:
        assert decision.world != current


@pytest.mark.parametrize("rule", ["interval", "uniform", "progress"])
def test_the_other_rules_decide_every_interval(rule: RuleName) -> None:
    made = RULES[rule](CurriculumConfig(rule=rule, interval=100), 0)
    assert [made.due(5.0, steps) for steps in (0, 64, 99, 100, 128)] == [False, False, False, True, True]


def test_the_papers_rule_depends_on_the_loss_alone_and_never_decides_at_all() -> None:
    paper, never = (RULES[rule](CurriculumConfig(rule=rule, threshold=1.0), 0) for rule in ("loss", "never"))
    assert [paper.due(value, 10**9) for value in (INF, 1.0, 0.99)] == [False, False, True]
    assert not never.due(0.0, 10**9)


def test_interval_goes_through_the_worlds_in_order_and_round() -> None:
    world, order = 0, []
    for _ in range(7):
        world = decide("interval", [NAN] * 4, world, {2}).world
        order.append(world)
    assert order == [1, 3, 0, 1, 3, 0, 1]


def test_uniform_is_uniform_over_the_other_free_worlds_and_depends_on_seed_and_number() -> None:
    def drawn(seed: int) -> list[int]:
        return [decide("uniform", [NAN] * 6, 1, {4}, number=number, seed=seed).world for number in range(2000)]

    counts = Counter(drawn(0))
    assert set(counts) == {0, 2, 3, 5}
    assert all(abs(count - 500) < 5 * math.sqrt(2000 * 0.25 * 0.75) for count in counts.values())
    assert drawn(0) == drawn(0) != drawn(1)


@pytest.mark.parametrize(
    ("losses", "last", "taken", "expected"),
    [
        ([2.0, 1.0, 5.0], [2.1, 3.0, 5.0], set(), Decision("progress", 1)),
        ([2.0, 6.0, 5.0], [2.1, 3.0, 5.0], set(), Decision("progress", 1)),  # forgetting counts as well
        ([2.0, 1.0, 5.0], [4.1, 3.0, 5.0], set(), Decision("stay", 0)),
        ([2.0, 1.0, 5.0], [2.1, 3.0, 5.0], {1}, Decision("stay", 0)),
        ([2.0, INF, INF], [INF, INF, INF], set(), Decision("progress", 1)),  # fresh ones first
        ([2.0, 1.0, 5.0], [INF, 3.0, 5.0], set(), Decision("stay", 0)),  # its progress is not known yet
        ([2.0, 2.0, 2.0], [2.0, 2.0, 2.0], set(), Decision("stay", 0)),
    ],
)
def test_progress(losses: list[float], last: list[float], taken: set[int], expected: Decision) -> None:
    assert decide("progress", losses, 0, taken, last=last) == expected


def test_the_smoothed_loss_is_the_mean_and_infinite_before_the_first() -> None:
    assert smoothed([]) == INF
    assert smoothed([1.0, 2.0, 6.0]) == 3.0
