"""Scores of the paper (section "Evaluation metrics"): mean return within i actions, and A-Success (PHYRE's AUCCESS)."""

import numpy as np
from numpy.typing import ArrayLike


def mean_return_within(rewards: ArrayLike) -> np.ndarray:
    """Return the mean return within 1…N actions over puzzles.

    Args:
        rewards: extrinsic reward of every action, zeros after an episode's end, shape (puzzles, N).

    Returns:
        s_1…s_N, shape (N,): `s[i - 1]` is the mean over puzzles of the return within i actions.

    Raises:
        ValueError: if `rewards` is not a non-empty two-dimensional array of finite numbers.
    """
    table = np.asarray(rewards, dtype=np.float64)
    if table.ndim != 2 or table.size == 0 or not np.isfinite(table).all():
        raise ValueError(f"rewards must be finite with shape (puzzles, N), got shape {table.shape}")
    return np.cumsum(table, axis=1).mean(axis=0)


def a_success(s: ArrayLike) -> float:
    """Return A-Success: mean returns within 1…N actions, weighted so that early success counts more.

    Σ α_i s_i / Σ α_i with α_i = ln(i + 1) − ln i. If every puzzle is solved at action k, this is 1 − ln k / ln(N + 1).

    Args:
        s: s_1…s_N, mean returns within 1…N actions, shape (N,).

    Raises:
        ValueError: if `s` is not a non-empty one-dimensional array of finite numbers.
    """
    returns = np.asarray(s, dtype=np.float64)
    if returns.ndim != 1 or returns.size == 0 or not np.isfinite(returns).all():
        raise ValueError(f"s must be finite with shape (N,), N ≥ 1, got shape {returns.shape}")
    actions = np.arange(1, returns.size + 1, dtype=np.float64)
    return float(np.average(returns, weights=np.log1p(1.0 / actions)))
