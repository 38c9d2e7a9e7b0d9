"""The one minimiser of costs with normal equations."""

import numpy as np
import torch

from matcap.flash.least_squares import jacobian, minimised


def valley(x):
    """Residuals of Rosenbrock's valley, least at (1, 1)."""
    return torch.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def cost(x):
    return float(0.5 * valley(x).square().sum())


def quadratic(x):
    jacobian = torch.autograd.functional.jacobian(valley, x)
    return jacobian.T @ jacobian, jacobian.T @ valley(x)


def test_a_curved_valley_is_followed_to_its_least_cost():
    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    least, found = minimised(cost, quadratic, start, 100)
    assert torch.allclose(found, torch.ones_like(found), atol=1e-6) and least == cost(found)


def test_no_step_is_too_far_and_none_raises_the_cost():
    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    costs = [cost(start)]
    for steps in range(1, 6):
        least, found = minimised(cost, quadratic, start, steps, farthest=0.1)
        assert float((found - start).abs().max()) <= 0.1 * steps + 1e-12
        costs.append(least)
    assert costs == sorted(costs, reverse=True) and costs[-1] < costs[0]


def test_it_stays_where_every_step_is_worse():
    """The gradient points the wrong way."""
    start = torch.tensor([0.5, 0.5], dtype=torch.float64)

    def wrong(x):
        hessian, gradient = quadratic(x)
        return hessian, -gradient

    least, found = minimised(cost, wrong, start, 10)
    assert torch.equal(found, start) and least == cost(start)


def test_finite_differences_are_near_the_derivatives():
    x = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    by_differences = jacobian(lambda at: valley(torch.from_numpy(at)).numpy(), x.numpy(), 1e-6)
    exact = torch.autograd.functional.jacobian(valley, x).numpy()
    np.testing.assert_allclose(by_differences, exact, atol=1e-4)
