"""Ridge regression against the normal equations."""

import numpy as np
import pytest
import torch

from gym_open.train.probe.ridge import fit_ridge


def data(n: int, inputs: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, inputs)) * 3 + 1
    y = x[:, :2] @ rng.normal(size=(2, 3)) + rng.normal(size=(n, 3)) + 5
    return torch.from_numpy(x), torch.from_numpy(y)


@pytest.mark.parametrize(("n", "inputs"), [(40, 6), (20, 50)])
def test_it_solves_the_normal_equations(n: int, inputs: int) -> None:
    x, y = data(n, inputs)
    ridge = fit_ridge(x, y, (x, y), [0.3])
    z = x.numpy() - x.numpy().mean(axis=0)
    z /= np.sqrt((z**2).sum(axis=1).mean())
    weights = np.linalg.solve(z.T @ z + 0.3 * np.eye(inputs), z.T @ (y.numpy() - y.numpy().mean(axis=0)))
    np.testing.assert_allclose(ridge.predict(x).numpy(), z @ weights + y.numpy().mean(axis=0), rtol=1e-6)


def test_each_target_takes_the_strength_that_validates_best() -> None:
    x, y = data(30, 25)
    y[:, 2] = torch.from_numpy(np.random.default_rng(7).normal(size=30))  # noise: wants the strongest
    fresh = data(200, 25, seed=0)
    strengths = [1e-6, 1e-2, 1.0, 1e4]

    def errors(strength: float) -> torch.Tensor:
        return (fit_ridge(x, y, (x, y), [strength]).predict(fresh[0]) - fresh[1]).square().mean(dim=0)

    tried = torch.stack([errors(strength) for strength in strengths])
    chosen = (fit_ridge(x, y, fresh, strengths).predict(fresh[0]) - fresh[1]).square().mean(dim=0)
    torch.testing.assert_close(chosen, tried.min(dim=0).values)
    assert len(tried.argmin(dim=0).unique()) > 1


def test_inputs_that_never_vary_are_harmless() -> None:
    x, y = data(10, 3)
    ridge = fit_ridge(torch.ones_like(x), y, (x, y), [1.0])
    torch.testing.assert_close(ridge.predict(torch.ones_like(x)), y.mean(dim=0).expand(10, 3))
