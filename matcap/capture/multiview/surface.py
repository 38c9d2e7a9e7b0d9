"""Height from slopes, weighted by their precision."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.integrate import integrate, poisson
from matcap.capture.multiview.texels import slopes_of
from matcap.flash.least_squares import conjugate_gradients

Floats = NDArray[np.float32]

# Settings of the integration of slopes to heights; docs/notes/several.md.
_MODEL = 0.03  # standard deviation of slopes due to model errors: shadows, parallax, bend
_STEPS = 4  # conjugate gradient steps; more restore shorter wavelengths, and their noise
_EVEN = 4.0  # standard deviation of the smoothing of precision in the preconditioner, texels
_LEAST = 1e-3  # least precision of a slope, as a share of the mean


def surface_of(slopes: Tensor, texel_size: float, precision: Tensor) -> Tensor:
    """(1, H, W) height, plane units, whose central slopes are nearest to slopes (2, H, W).

    Minimises the sum over texels of e^T P e, e being the slope error (2,), by conjugate gradients
    with a Poisson preconditioner. Two photographs hardly measure slopes perpendicular to their
    baseline; the other slope then determines them, as a gradient has no curl.

    Args:
        slopes: along x and y.
        texel_size: in plane units.
        precision: (3, H, W) elements xx, yy and xy of P.
    """
    height = integrated(slopes, texel_size, 2)
    weight = _with_error(precision, _MODEL)
    weight = weight / weight[:2].mean().clamp_min(1e-12)
    weight[:2] += _LEAST
    residual = (slopes - slopes_of(height, texel_size)).numpy()
    return height + texel_size * torch.from_numpy(_nearest(residual, weight.numpy()))[None]


def _with_error(precision: Tensor, deviation: float) -> Tensor:
    """(3, H, W) precision of slopes with an independent error added: P (1 + deviation^2 P)^-1."""
    xx, yy, xy = precision.double()
    variance = deviation**2
    a, b, c = 1.0 + variance * xx, 1.0 + variance * yy, variance * xy
    det = (a * b - c * c).clamp_min(1e-12)
    full = xx * yy - xy * xy
    return torch.stack(
        [(xx + variance * full) / det, (yy + variance * full) / det, xy / det]
    ).float()


def integrated(slopes: Tensor, texel_size: float, rounds: int = 4) -> Tensor:
    """(1, H, W) height nearest to slopes (2, H, W) of equal precision, plane units.

    By repeated Poisson integration of the residual slopes. A difference between neighbours is the
    mean of their slopes, so central differences of the height are smoother than the slopes; the
    rounds restore the loss.
    """
    height = torch.zeros(1, *slopes.shape[1:])
    for _ in range(rounds):
        residual = (slopes - slopes_of(height, texel_size)).numpy() * texel_size
        across = 0.5 * (residual[0][:, 1:] + residual[0][:, :-1])
        down = -0.5 * (residual[1][1:] + residual[1][:-1])
        height = height + torch.from_numpy(integrate(across, down))[None]
    return height


def _nearest(slopes: Floats, weight: Floats) -> Floats:
    """(H, W) heights in texels, weighted least squares of (2, H, W) by weights (3, H, W)."""
    return conjugate_gradients(
        lambda heights: transposed(_weighted(texel_slopes(heights), weight)),
        transposed(_weighted(slopes, weight)),
        _STEPS,
        preconditioned=_preconditioner(weight),
    )


def _preconditioner(weight: Floats) -> Callable[[Floats], Floats]:
    """The inverse Laplacian, locally scaled by the smoothed weight (3, H, W)."""
    shape = weight.shape[1:]
    across, down = (float(np.mean(each)) for each in weight[:2])
    local = cv2.GaussianBlur(weight[0] / across + weight[1] / down, (0, 0), _EVEN)
    scale = np.asarray(1.0 / np.sqrt(0.5 * local), np.float32)

    def preconditioned(residual: Floats) -> Floats:
        even = np.pad(residual * scale, [(0, side % 2) for side in shape])
        heights = poisson(even, across, down)[: shape[0], : shape[1]]
        return np.asarray(-heights * scale, np.float32)

    return preconditioned


def _weighted(slopes: Floats, weight: Floats) -> Floats:
    """P e of slopes e (2, H, W), with elements xx, yy and xy of P in `weight` (3, H, W)."""
    x, y = slopes
    return np.stack([weight[0] * x + weight[2] * y, weight[1] * y + weight[2] * x])


def texel_slopes(height: Floats) -> Floats:
    """(2, H, W) central differences of (H, W) along columns and rows; y points up."""
    return np.asarray(slopes_of(torch.from_numpy(height)[None], 1.0).numpy(), np.float32)


def transposed(slopes: Floats) -> Floats:
    """(H, W) the transpose (adjoint) of texel_slopes applied to (2, H, W)."""
    heights = np.zeros(slopes.shape[1:], np.float32)
    x, y = slopes[0], -slopes[1]
    heights[:, 2:] += 0.5 * x[:, 1:-1]
    heights[:, :-2] -= 0.5 * x[:, 1:-1]
    heights[2:] += 0.5 * y[1:-1]
    heights[:-2] -= 0.5 * y[1:-1]
    # One-sided differences at the borders.
    for first, second, end in ((0, 1, 0), (-2, -1, -1)):
        heights[:, second] += x[:, end]
        heights[:, first] -= x[:, end]
        heights[second] += y[end]
        heights[first] -= y[end]
    return heights
