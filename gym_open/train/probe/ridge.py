"""Ridge regression in closed form, with its strength chosen on validation data."""

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
    """Minimise `‖y − offset − z·weights‖² + strength·‖weights‖²`, with the best strength for each target.

    z is x centred and divided by one number, so that its rows have mean square length 1: strengths then mean the same
    for any number of inputs. The solution uses eigenvectors of `zᵀz` or `zzᵀ`,
    whichever is smaller (Hastie et al. 2009, 18.3.5).

    Args:
        x: inputs, (n, D).
        y: targets, (n, K).
        validation: inputs (m, D) and targets (m, K); for each target, the strength with the smallest mean square
            error there is the best.
        strengths: the strengths to choose from, each positive.
    """
    centre, offset = x.mean(dim=0), y.mean(dim=0)
    z = x - centre
    scale = z.square().sum(dim=1).mean().sqrt().clamp(min=torch.finfo(x.dtype).tiny)
    z, t = z / scale, y - offset
    wide = z.shape[1] > z.shape[0]
    eigenvalues, Q = torch.linalg.eigh(z @ z.T if wide else z.T @ z)
    rotated = Q.T @ (t if wide else z.T @ t)
    solved = [Q @ (rotated / (eigenvalues.clamp(min=0) + strength)[:, None]) for strength in strengths]
    weights = torch.stack([z.T @ one if wide else one for one in solved])
    found = (validation[0] - centre) / scale @ weights + offset
    best = (found - validation[1]).square().mean(dim=1).argmin(dim=0)
    return Ridge(centre, scale, weights[best, :, torch.arange(y.shape[1])].T, offset)
