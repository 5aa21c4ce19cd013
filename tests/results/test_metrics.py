"""A-Success, compared with closed forms, PHYRE's published value, and a plain loop."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gym_open.evaluate import a_success, mean_return_within


@pytest.mark.parametrize(
    ("N", "k", "expected"),
    [(100, 2, 0.8498), (100, 5, 0.6513), (100, 10, 0.5011), (100, 30, 0.2630), (100, 100, 0.0022),
     (200, 10, 0.5658), (200, 100, 0.1316)],
)  # fmt: skip
def test_all_solved_at_step_k_has_its_closed_form(N: int, k: int, expected: float) -> None:
    s = np.where(np.arange(1, N + 1) >= k, 1.0, 0.0)
    assert a_success(s) == pytest.approx(1 - math.log(k) / math.log(N + 1), abs=1e-12)
    assert a_success(s) == pytest.approx(expected, abs=5e-5)


def test_phyre_known_value() -> None:
    # PHYRE's metrics_test.py: two tasks, solved at attempt 1 and at attempt 12 of 12, normalised AUCCESS .515603
    rewards = np.zeros((2, 12))
    rewards[0, 0] = 1
    rewards[1, 11] = 1
    assert a_success(mean_return_within(rewards)) == pytest.approx(0.515603, abs=1e-6)


def test_extremes() -> None:
    assert a_success(np.ones(100)) == pytest.approx(1.0)
    assert a_success(np.zeros(100)) == 0.0


@given(hnp.arrays(np.float64, st.integers(1, 200), elements=st.floats(0, 1)))
def test_equals_the_formula_written_as_a_loop(s: np.ndarray) -> None:
    alpha = [math.log(i + 1) - math.log(i) for i in range(1, len(s) + 1)]
    assert a_success(s) == pytest.approx(sum(a * x for a, x in zip(alpha, s, strict=True)) / sum(alpha), abs=1e-9)


@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 5), st.integers(1, 30)), elements=st.floats(0, 1)))
def test_mean_return_is_the_mean_of_running_sums(rewards: np.ndarray) -> None:
    expected = [np.mean([sum(row[: i + 1]) for row in rewards]) for i in range(rewards.shape[1])]
    assert mean_return_within(rewards) == pytest.approx(expected)


@pytest.mark.parametrize("bad", [[], [[1.0, 2.0]], [1.0, float("nan")]])
def test_a_success_refuses_what_is_not_a_curve(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="shape"):
        a_success(bad)


@pytest.mark.parametrize("bad", [[], [1.0, 2.0], [[1.0, float("inf")]]])
def test_mean_return_refuses_what_is_not_a_table(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="shape"):
        mean_return_within(bad)
