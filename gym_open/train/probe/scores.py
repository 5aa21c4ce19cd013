"""Scores of predictions over worlds, with the same scores of resampled worlds for intervals."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

RESAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class ProbeScore:
    """A score, and its value on each resample of the worlds (bootstrap; Efron and Tibshirani 1993)."""

    value: float
    resampled: np.ndarray
    """(B,)"""

    def __sub__(self, other: "ProbeScore") -> "ProbeScore":
        """The difference of two scores on the same resamples. The difficulty of a world, which both share, cancels."""
        return ProbeScore(self.value - other.value, self.resampled - other.resampled)

    def record(self) -> dict[str, float]:
        """`value` and the percentile interval `low`…`high` of level 95%."""
        low, high = np.quantile(self.resampled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        return {"value": self.value, "low": float(low), "high": float(high)}


def mean_score(scores: list[ProbeScore]) -> ProbeScore:
    """The mean of several scores on the same resamples."""
    return ProbeScore(float(np.mean([s.value for s in scores])), np.mean([s.resampled for s in scores], axis=0))


def resample(worlds: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the worlds of each resample with replacement: (B, W) int64."""
    return rng.integers(worlds, size=(RESAMPLES, worlds))


def ratio_score(above: np.ndarray, below: np.ndarray, resamples: np.ndarray) -> ProbeScore:
    """`Σ above / Σ below` over worlds, for arrays (W,); `resamples` come from `resample`."""
    return ProbeScore(float(above.sum() / below.sum()), above[resamples].sum(axis=1) / below[resamples].sum(axis=1))


def r2_score(error: np.ndarray, guess_error: np.ndarray, resamples: np.ndarray) -> ProbeScore:
    """`1 − Σ error / Σ guess_error` of squared errors by world (W,): 0 if no better than the guess, 1 at best."""
    ratio = ratio_score(error, guess_error, resamples)
    return ProbeScore(1 - ratio.value, 1 - ratio.resampled)


def auc_score(found: np.ndarray, labels: np.ndarray, resamples: np.ndarray) -> ProbeScore:
    """Area under the ROC curve: how often a true case outranks a false one. Ties count half; chance is ½.

    Args:
        found: ratings, (W, T).
        labels: (W, T) bool.
        resamples: from `resample`.
    """
    return ProbeScore(auc(found, labels), np.array([auc(found[worlds], labels[worlds]) for worlds in resamples]))


def auc(found: np.ndarray, labels: np.ndarray) -> float:
    """Area under the ROC curve by ranks (Mann and Whitney 1947); ½ if all labels are the same."""
    true = int(labels.sum())
    false = labels.size - true
    if not true or not false:
        return 0.5
    ranks = rankdata(found, axis=None)[labels.ravel()]
    return float((ranks.sum() - true * (true + 1) / 2) / (true * false))
