"""Statistics over runs, compared with closed forms, SciPy, and simulations with known true values."""

import itertools
import statistics as plain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gym_open.results.statistics import (
    difference_bootstrap,
    first_reached,
    interquartile_mean,
    least_p_value,
    mean,
    mean_and_deviation,
    median,
    optimality_gap,
    percentiles,
    probability_of_improvement,
    stratified_bootstrap,
    two_level_bootstrap,
)

SCORES = st.lists(st.floats(0, 1).map(lambda x: round(x, 3)), min_size=1, max_size=8)
TASKS = st.lists(SCORES, min_size=1, max_size=4).map(lambda tasks: [np.array(runs) for runs in tasks])


def _rng() -> np.random.Generator:
    return np.random.default_rng(7)


@given(st.lists(st.floats(0, 1), min_size=2, max_size=10))
def test_the_deviation_is_that_of_a_sample(runs: list[float]) -> None:
    value, deviation = mean_and_deviation(runs)
    assert value == pytest.approx(plain.mean(runs))
    assert deviation == pytest.approx(plain.stdev(runs), abs=1e-12)


def test_one_run_has_no_deviation_and_none_no_mean() -> None:
    assert mean_and_deviation([0.4]) == (0.4, None)
    for bad in ([], [[0.1, 0.2]], [0.1, float("nan")]):
        with pytest.raises(ValueError, match="shape"):
            mean_and_deviation(bad)


def test_the_interquartile_mean_is_the_mean_of_the_middle_half_of_all_scores() -> None:
    strata = [np.array([0.9, 0.1, 0.3, 0.2]), np.array([0.8, 0.4, 0.0, 1.0])]
    assert interquartile_mean(strata) == pytest.approx(np.mean([0.2, 0.3, 0.4, 0.8]))
    assert interquartile_mean([np.array([0.0, 0.1, 1.0])]) == pytest.approx(1.1 / 3)  # of three, none is cut


@given(TASKS)
def test_aggregates_lie_between_the_extremes_and_follow_a_shift(strata: list[np.ndarray]) -> None:
    every = np.concatenate(strata)
    for statistic in (mean, median, interquartile_mean):
        value = float(statistic(strata))
        assert every.min() - 1e-9 <= value <= every.max() + 1e-9
        assert float(statistic([runs + 0.5 for runs in strata])) == pytest.approx(value + 0.5)
    assert float(optimality_gap(strata)) == pytest.approx(1 - float(mean(strata)))  # no score is above 1


def test_what_lies_above_the_best_makes_up_for_nothing() -> None:
    assert float(optimality_gap([np.array([0.5, 1.5])])) == pytest.approx(0.25)


def test_tasks_count_alike_however_many_runs_they_have() -> None:
    strata = [np.array([0.0]), np.array([0.6, 0.6, 0.6, 0.6]), np.array([0.9, 0.9])]
    assert float(mean(strata)) == pytest.approx(0.5)
    assert float(median(strata)) == pytest.approx(0.6)


@given(SCORES, SCORES)
def test_probability_of_improvement_is_mann_whitneys_u_over_pairs(x: list[float], y: list[float]) -> None:
    ours = float(probability_of_improvement([np.array(x)], [np.array(y)]))
    assert ours == pytest.approx(stats.mannwhitneyu(x, y, method="asymptotic").statistic / (len(x) * len(y)))
    assert ours + float(probability_of_improvement([np.array(y)], [np.array(x)])) == pytest.approx(1)


def test_probability_of_improvement_is_averaged_over_tasks() -> None:
    ours, theirs = [np.array([1.0, 2.0]), np.array([5.0])], [np.array([0.0, 1.5]), np.array([6.0])]
    assert float(probability_of_improvement(ours, theirs)) == pytest.approx((3 / 4 + 0) / 2)


@pytest.mark.parametrize("sizes", [(1, 1), (3, 3), (5, 2)])
def test_the_least_p_value_is_that_of_complete_separation(sizes: tuple[int, int]) -> None:
    n, m = sizes
    found = stats.mannwhitneyu(np.arange(n), 100 + np.arange(m), method="exact").pvalue
    assert least_p_value(n, m) == pytest.approx(found)


def test_of_one_stratum_it_is_the_bootstrap_of_scipy() -> None:
    runs = _rng().normal(size=30)
    draws = stratified_bootstrap([runs], mean, _rng(), 20_000)
    expected = stats.bootstrap((runs,), np.mean, n_resamples=20_000, method="percentile", rng=_rng())
    assert percentiles(draws) == pytest.approx(tuple(expected.confidence_interval), abs=0.02)


def test_runs_are_drawn_within_their_own_task() -> None:
    draws = stratified_bootstrap([np.array([0.0, 0.0]), np.array([1.0, 1.0, 1.0])], mean, _rng(), 50)
    assert (draws == 0.5).all()


def test_the_spread_over_runs_and_tasks_has_its_closed_form() -> None:
    strata = [_rng().normal(size=4), 10 * _rng().normal(size=7)]
    draws = stratified_bootstrap(strata, mean, _rng(), 40_000)
    expected = sum(runs.var() / len(runs) for runs in strata) / 4
    assert draws.var() == pytest.approx(expected, rel=0.04)


def test_both_levels_contribute_their_variance() -> None:
    """For scores a_r + b_p, the variance of the mean is the sum of the variances of both levels."""
    runs, puzzles = _rng().normal(size=5), _rng().normal(size=20)
    draws = two_level_bootstrap(runs[:, None] + puzzles[None, :], _rng(), 40_000)
    assert draws.mean() == pytest.approx(runs.mean() + puzzles.mean(), abs=0.02)
    assert draws.var() == pytest.approx(runs.var() / 5 + puzzles.var() / 20, rel=0.04)


def test_of_one_run_only_puzzles_vary_and_curves_keep_their_shape() -> None:
    values = _rng().normal(size=(1, 30, 6))
    draws = two_level_bootstrap(values, _rng(), 20_000)
    assert draws.shape == (20_000, 6)
    assert draws.var(axis=0) == pytest.approx(values[0].var(axis=0) / 30, rel=0.06)


def test_puzzles_that_both_agents_play_cancel_in_a_difference() -> None:
    x = _rng().normal(size=(1, 40))
    assert difference_bootstrap(x + 0.25, x, _rng(), 200) == pytest.approx(np.full(200, 0.25))
    apart = difference_bootstrap(x, _rng().permuted(x, axis=1), _rng(), 20_000)
    assert apart.std() > 0.1


def test_the_two_level_interval_covers_the_truth_as_often_as_it_says() -> None:
    """Each trial draws effects of runs, of puzzles and of pairs; the true mean is 0."""
    rng, hits, trials = np.random.default_rng(1), 0, 200
    for _ in range(trials):
        values = 0.06 * rng.normal(size=(5, 1)) + 0.2 * rng.normal(size=100) + 0.28 * rng.normal(size=(5, 100))
        low, high = percentiles(two_level_bootstrap(values, rng, 300))
        hits += low <= 0 <= high
    assert 0.88 <= hits / trials <= 0.99  # puzzles alone: .70, runs alone: .75


def test_an_interval_holds_the_share_it_is_asked_for() -> None:
    low, high = percentiles(np.arange(1001.0), 0.9)
    assert (low, high) == pytest.approx((50, 950))


@given(st.lists(st.integers(1, 100), min_size=1, max_size=6, unique=True).map(sorted), st.data())
def test_a_threshold_is_reached_where_the_straight_line_crosses_it(steps: list[int], data: st.DataObject) -> None:
    scores = data.draw(st.lists(st.floats(0, 1), min_size=len(steps), max_size=len(steps)))
    threshold = data.draw(st.floats(0.01, 1))
    found = first_reached(threshold, steps, scores)
    if found is None:
        assert max(scores) < threshold
    else:
        assert np.interp(found, steps, scores) >= threshold - 1e-9
        before = np.linspace(steps[0], found, 50)[:-1] if found > steps[0] else []
        assert all(np.interp(x, steps, scores) < threshold + 1e-9 for x in before)


def test_the_first_of_several_crossings_counts() -> None:
    assert first_reached(0.5, [100, 200, 300, 400], [0.0, 1.0, 0.2, 0.9]) == pytest.approx(150)
    assert first_reached(0.5, [100, 200], [0.5, 0.1]) == 100
    assert first_reached(0.5, [100, 200], [0.1, 0.4]) is None


def test_equal_generators_give_equal_draws() -> None:
    values = _rng().normal(size=(3, 10))
    for one, other in itertools.pairwise(two_level_bootstrap(values, _rng(), 50) for _ in range(2)):
        assert (one == other).all()
