"""Scores of probes against closed forms and SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from gym_open.train.probe.scores import ProbeScore, auc, auc_score, mean_score, r2_score, ratio_score, resample

RNG = np.random.default_rng(0)
DRAWS = resample(400, np.random.default_rng(1))


def test_the_interval_of_a_mean_is_that_of_normal_theory() -> None:
    values = RNG.normal(2.0, 3.0, size=400)
    found = ratio_score(values, np.ones(400), DRAWS).record()
    half = 1.96 * values.std() / np.sqrt(400)
    assert found["value"] == pytest.approx(values.mean())
    assert (found["low"], found["high"]) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.1 * half)


def test_r2_of_perfect_useless_and_worse_predictions() -> None:
    guess = RNG.uniform(1, 2, size=400)
    for error, expected in ((0 * guess, 1.0), (guess, 0.0), (2 * guess, -1.0)):
        score = r2_score(error, guess, DRAWS)
        assert score.value == pytest.approx(expected)
        np.testing.assert_allclose(score.resampled, expected, atol=1e-12)


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2, max_size=30))
def test_auc_is_mann_and_whitneys_u(cases: list[tuple[int, bool]]) -> None:
    found, labels = (np.array(column) for column in zip(*cases, strict=True))
    if labels.all() or not labels.any():
        assert auc(found, labels) == 0.5
        return
    u = mannwhitneyu(found[labels], found[~labels]).statistic
    assert auc(found, labels) == pytest.approx(u / (labels.sum() * (~labels).sum()))


def test_worlds_are_resampled_whole() -> None:
    """Twice the same column adds no certainty: the interval is that of one column."""
    found, labels = RNG.normal(size=(400, 1)), RNG.random((400, 1)) < 0.4
    once = auc_score(found, labels, DRAWS).record()
    twice = auc_score(np.repeat(found, 2, axis=1), np.repeat(labels, 2, axis=1), DRAWS).record()
    assert twice == pytest.approx(once)
    assert 0.05 < once["high"] - once["low"] < 0.2  # about 4 × √(1 / (12 · 400 · .4 · .6)) = .12


def test_a_difference_is_taken_resample_by_resample() -> None:
    hard = RNG.uniform(0, 1, size=400)  # worlds differ much, the two scores by .1 in each
    one, other = (ratio_score(hard + bonus, np.ones(400), DRAWS) for bonus in (0.1, 0.0))
    gain = (one - other).record()
    assert list(gain.values()) == pytest.approx([0.1, 0.1, 0.1])
    assert one.record()["high"] - one.record()["low"] > 0.04


def test_mean_of_scores() -> None:
    found = mean_score([ProbeScore(1.0, np.array([0.0, 2.0])), ProbeScore(3.0, np.array([2.0, 2.0]))])
    assert found.value == 2
    np.testing.assert_array_equal(found.resampled, [1, 2])
