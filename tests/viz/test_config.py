"""Selections that are valid, and selections that are refused."""

import msgspec
import pytest

from gym_open.errors import UsageError
from gym_open.viz.config import Choice, parse_steps


def test_steps_are_half_open_and_each_end_is_optional() -> None:
    assert list(parse_steps("3:6")) == [3, 4, 5]
    assert parse_steps(":2") == range(2)
    assert parse_steps("7:").start == 7
    assert 10**15 in parse_steps("7:")


@pytest.mark.parametrize("text", ["", "5", "a:b", "1:2:3", "-1:4", "1.5:2", "٣:٦", "1:2\n"])
def test_another_form_of_steps_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected A:B, such as 1000:2000"):
        parse_steps(text)


@pytest.mark.parametrize("steps", [range(4, 4), range(5, 4), range(-1, 4), range(0, 9, 2)])
def test_a_range_without_steps_is_refused(steps: range) -> None:
    with pytest.raises(UsageError, match="0 <= A < B"):
        Choice(steps=steps)


@pytest.mark.parametrize("name", ["episode", "segment", "stream"])
def test_a_negative_number_is_refused_by_name(name: str) -> None:
    with pytest.raises(UsageError, match=f"--{name}: expected 0 or more, got -1"):
        msgspec.convert({name: -1}, Choice)


def test_an_option_that_does_not_apply_is_refused_by_name() -> None:
    choice = Choice(puzzle="tool-use/017", stream=0)
    choice.refuse_others("scores", {"puzzle", "stream"})
    with pytest.raises(UsageError, match=r"--puzzle does not apply to a log; .*--steps, --stream"):
        choice.refuse_others("a log", {"stream", "steps"})
    Choice().refuse_others("a log", set())
