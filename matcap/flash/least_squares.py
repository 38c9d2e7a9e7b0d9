"""Least squares: Huber loss, Levenberg-Marquardt for few unknowns, conjugate gradients for many."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

_FIRST, _LEAST = 1e-2, 1e-6  # damping: share of the diagonal that is added to it


def minimised(
    cost: Callable[[Doubles], float],
    quadratic: Callable[[Doubles], tuple[Doubles, Doubles]],
    start: Doubles,
    iterations: int,
    *,
    farthest: float = math.inf,
    tolerance: float = 1e-5,
) -> tuple[float, Doubles]:
    """Least cost and its parameters after at most `iterations` steps.

    Args:
        cost: of parameters (n,).
        quadratic: its (n, n) Gauss-Newton Hessian and (n,) gradient at parameters.
        start: (n,) initial parameters.
        iterations: most steps.
        farthest: largest change of a parameter in a step.
        tolerance: relative decrease of the cost at which it ends.
    """
    parameters, damping, least = start, _FIRST, cost(start)
    for _ in range(iterations):
        normal, gradient = quadratic(parameters)
        candidate, new = parameters, math.inf
        while not new < least and damping * _LEAST < 1.0:
            damped = normal + damping * np.diag(normal.diagonal())
            step = np.linalg.solve(damped, gradient).clip(-farthest, farthest)
            candidate = parameters - step
            new = cost(candidate)
            damping *= 4.0
        if not new < least:
            break
        converged = least - new < tolerance * least
        parameters, least, damping = candidate, new, max(damping / 16.0, _LEAST)
        if converged:
            break
    return least, parameters


def huber(residuals: Doubles, threshold: float) -> tuple[Doubles, Doubles]:
    """Huber loss of residuals, and the weights at which squares have its gradient; any shape."""
    size = np.abs(residuals)
    linear = threshold * (size - 0.5 * threshold)
    loss = np.where(size < threshold, 0.5 * np.square(size), linear)
    return loss, threshold / np.maximum(size, threshold)


def conjugate_gradients(
    product: Callable[[Floats], Floats],
    right: Floats,
    iterations: int,
    *,
    preconditioned: Callable[[Floats], Floats] = lambda residual: residual,
    tolerance: float = 0.0,
) -> Floats:
    """Solution x of A x = right, from x = 0; float32 of any shape.

    Args:
        product: A x, with A symmetric and positive definite; its result is overwritten.
        iterations: most of them.
        preconditioned: an approximation of A^-1 r.
        tolerance: norm of the residual r over that at the start, at which they end, both weighted
            by the preconditioner.
    """
    solution, residual, some = np.zeros_like(right), right.copy(), np.empty_like(right)
    direction = preconditioned(residual).copy()
    energy = start = float(np.vdot(residual, direction))
    for _ in range(iterations):
        if not energy > tolerance**2 * start:  # or NaN
            break
        image = product(direction)
        length = np.float32(energy / max(float(np.vdot(direction, image)), 1e-30))
        solution += np.multiply(direction, length, out=some)
        residual -= np.multiply(image, length, out=image)
        gradient = preconditioned(residual)
        earlier, energy = energy, float(np.vdot(residual, gradient))
        direction *= np.float32(energy / earlier)
        direction += gradient
    return solution


def jacobian(f: Callable[[Doubles], Doubles], at: Doubles, step: float) -> Doubles:
    """(m, n) d f / d x at x (n,) by forward differences; values of f are flattened to (m,)."""
    value = f(at)
    return np.stack([((f(at + d) - value) / step).ravel() for d in step * np.eye(len(at))], 1)
