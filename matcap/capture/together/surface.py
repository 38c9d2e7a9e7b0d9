"""Height from slopes, weighted by their precision."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.integrate import integrate, poisson
from matcap.capture.together.texels import slopes_of

Floats = NDArray[np.float32]

# Settings of the integration of slopes to heights; docs/notes/several.md.
_MODEL = 0.03  # standard deviation of slopes due to model errors: shadows, parallax, bend
_STEPS = 4  # conjugate gradient steps; more restore shorter wavelengths, and their noise
_EVEN = 4.0  # standard deviation of the smoothing of precision in the preconditioner, texels
_LEAST = 1e-3  # least precision of a slope, as a share of the mean


def surface_of(
    slopes: Tensor,
    texel_size: float,
    precision: Tensor | None = None,
) -> Tensor:
    """(1, H, W) height, plane units, whose central slopes are nearest to slopes (2, H, W).

    Minimises the sum over texels of e^T P e, e being the slope error (2,), by conjugate gradients
    with a Poisson preconditioner. Two photographs hardly measure slopes perpendicular to their
    baseline; the other slope then determines them, as a gradient has no curl.

    Args:
        slopes: along x and y.
        texel_size: in plane units.
        precision: (3, H, W) elements xx, yy and xy of P; None for the identity.
    """
    if precision is None:
        return _even_surface(slopes, texel_size, 4)
    height = _even_surface(slopes, texel_size, 2)
    weight = _doubted(precision, _MODEL)
    weight = weight / weight[:2].mean().clamp_min(1e-12)
    weight[:2] += _LEAST
    left = (slopes - slopes_of(height, texel_size)).numpy()
    return height + texel_size * torch.from_numpy(_nearest(left, weight.numpy()))[None]


def _doubted(precision: Tensor, more: float) -> Tensor:
    """Precision (3, H, W) with an independent error of standard deviation `more` added."""
    xx, yy, xy = precision.double()
    # P (1 + more^2 P)^-1
    more = more**2
    a, b, c = 1.0 + more * xx, 1.0 + more * yy, more * xy
    det = (a * b - c * c).clamp_min(1e-12)
    full = xx * yy - xy * xy
    return torch.stack([(xx + more * full) / det, (yy + more * full) / det, xy / det]).float()


def _even_surface(slopes: Tensor, texel_size: float, rounds: int) -> Tensor:
    """(1, H, W) height at equal precision, by repeated Poisson integration of the residual slopes.

    A difference between neighbours is the mean of their slopes, so central differences of the
    height are smoother than the slopes; the rounds restore the loss.
    """
    height = torch.zeros(1, *slopes.shape[1:])
    for _ in range(rounds):
        left = (slopes - slopes_of(height, texel_size)).numpy() * texel_size
        across = 0.5 * (left[0][:, 1:] + left[0][:, :-1])
        down = -0.5 * (left[1][1:] + left[1][:-1])
        height = height + torch.from_numpy(integrate(across, down))[None]
    return height


def _nearest(slopes: Floats, weight: Floats) -> Floats:
    """(H, W) heights in texels, weighted least squares of (2, H, W) by weights (3, H, W)."""
    evened = _evening(weight, _EVEN)
    correction = np.zeros(slopes.shape[1:], np.float32)
    left = transposed(_weighted(slopes, weight))
    way = evened(left)
    size = float(np.vdot(left, way))
    for _ in range(_STEPS):
        if size <= 0.0:
            break
        back = transposed(_weighted(texel_slopes(way), weight))
        length = np.float32(size / max(float(np.vdot(way, back)), 1e-30))
        correction += length * way
        left = left - length * back
        even = evened(left)
        size, before = float(np.vdot(left, even)), size
        way = even + np.float32(size / before) * way
    return correction


def _evening(weight: Floats, deviation: float) -> Callable[[Floats], Floats]:
    """Preconditioner: the Poisson equation, locally scaled by the smoothed weight."""
    shape = weight.shape[1:]
    across, down = (float(np.mean(each)) for each in weight[:2])
    local = cv2.GaussianBlur(weight[0] / across + weight[1] / down, (0, 0), deviation)
    scale = np.asarray(1.0 / np.sqrt(0.5 * local), np.float32)

    def evened(gradient: Floats) -> Floats:
        whole = np.pad(gradient * scale, [(0, side % 2) for side in shape])
        heights = poisson(whole, across, down)[: shape[0], : shape[1]]
        return np.asarray(-heights * scale, np.float32)

    return evened


def _weighted(slopes: Floats, weight: Floats) -> Floats:
    """P e of slopes e (2, H, W), with elements xx, yy and xy of P in `weight` (3, H, W)."""
    x, y = slopes
    return np.stack([weight[0] * x + weight[2] * y, weight[1] * y + weight[2] * x])


def texel_slopes(height: Floats) -> Floats:
    """(2, H, W) central differences of (H, W) along columns and rows; y points up."""
    return np.asarray(slopes_of(torch.from_numpy(height)[None], 1.0).numpy(), np.float32)


def transposed(slopes: Floats) -> Floats:
    """(H, W) the transpose (adjoint) of texel_slopes applied to (2, H, W)."""
    out = np.zeros(slopes.shape[1:], np.float32)
    x, y = slopes[0], -slopes[1]
    out[:, 2:] += 0.5 * x[:, 1:-1]
    out[:, :-2] -= 0.5 * x[:, 1:-1]
    out[2:] += 0.5 * y[1:-1]
    out[:-2] -= 0.5 * y[1:-1]
    for first, second, end in ((0, 1, 0), (-2, -1, -1)):
        out[:, second] += x[:, end]
        out[:, first] -= x[:, end]
        out[second] += y[end]
        out[first] -= y[end]
    return out
