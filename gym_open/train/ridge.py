"""Ridge regression in closed form, its strength chosen on validation data."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Ridge:
    """A linear map `y = (x − centre) / scale · weights + offset`."""

    centre: Tensor
    scale: Tensor
    weights: Tensor
    offset: Tensor

    def predict(self, x: Tensor) -> Tensor:
        """Predictions (n, K) for inputs (n, D)."""
        return (x - self.centre) / self.scale @ self.weights + self.offset


def fit_ridge(x: Tensor, y: Tensor, validation: tuple[Tensor, Tensor], strengths: Sequence[float]) -> Ridge:
    """Minimise `‖y − offset − z·weights‖² + strength·‖weights‖²`, for the strength that is best on validation data.

    z is x centred and divided by one number, so that its rows have mean square length 1: strengths then mean the same
    for any number of inputs. Solved by eigenvectors of `zᵀz` or `zzᵀ`, the smaller (Hastie et al. 2009, 18.3.5).

    Args:
        x: inputs, (n, D).
        y: targets, (n, K).
        validation: inputs (m, D) and targets (m, K); the smallest mean square error there is the best.
        strengths: to choose from, each positive.
    """
    centre, offset = x.mean(dim=0), y.mean(dim=0)
    z = x - centre
    scale = z.square().sum(dim=1).mean().sqrt().clamp(min=torch.finfo(x.dtype).tiny)
    z, t = z / scale, y - offset
    wide = z.shape[1] > z.shape[0]
    eigenvalues, Q = torch.linalg.eigh(z @ z.T if wide else z.T @ z)
    rotated = Q.T @ (t if wide else z.T @ t)
    tried = []
    for strength in strengths:
        solved = Q @ (rotated / (eigenvalues.clamp(min=0) + strength)[:, None])
        ridge = Ridge(centre, scale, z.T @ solved if wide else solved, offset)
        tried.append(((ridge.predict(validation[0]) - validation[1]).square().mean().item(), ridge))
    return min(tried, key=lambda pair: pair[0])[1]


def r_squared(predicted: Tensor, y: Tensor) -> float:
    """`1 − Σ(y − predicted)² / Σ(y − mean y)²` over all K targets together; 0 for guessing the mean, 1 at best."""
    return float(1 - (y - predicted).square().sum() / (y - y.mean(dim=0)).square().sum())
