"""Falloff of a camera, combined from the estimates of its photographs.

Photograph i has the falloff x_i = x + e_i (Falloff's two coefficients): x is the camera's, and
e_i ~ N(0, tau^2 I) is due to tone curves, relief and ambient light. Its coarse fit gives the
likelihood N(x_i; L_i^-1 h_i, L_i^-1) by Laplace's method (FalloffLikelihood), wide if a highlight
hides the falloff. With e_i integrated out and the prior N(m, P) of x,

    x ~ N(C (P^-1 m + sum w_i (I + tau^2 L_i)^-1 h_i), C),
    C = (P^-1 + sum w_i (I + tau^2 L_i)^-1 L_i)^-1,

a random-effects meta-analysis. The weights are those of Student's t, w_i = (nu + 2) / (nu + d_i^2),
where d_i is the Mahalanobis distance between x_i and x, so that outliers hardly count. tau is the
value of greatest likelihood under that t distribution, among those of _SCATTER.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.coarse.problem import FalloffLikelihood
from matcap.photo.camera import LEAST, CameraProfile, Falloff

Doubles = NDArray[np.float64]


# Settings of the combination of falloffs to a camera profile.
_FREEDOM = 4.0  # degrees of freedom nu of Student's t, above 2; smaller reject more outliers
# values of tau among which the likeliest is chosen.
_SCATTER = (0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8)
_ROUNDS = 30  # iterations of the weights


def camera_profile(camera: str, fits: Sequence[CoarseFit]) -> CameraProfile | None:
    """The profile of a camera, or None with fewer than LEAST photographs.

    Args:
        camera: its name.
        fits: coarse fits of its photographs, in any order, with the prior of any camera.
    """
    seen = [fit.falloff for fit in fits if fit.falloff is not None]
    if len(seen) < LEAST:
        return None
    return CameraProfile(camera, shared_falloff(seen), len(seen))


def shared_falloff(seen: Sequence[FalloffLikelihood]) -> Falloff:
    """Predictive Gaussian of the falloff in the next photograph (module equation).

    Args:
        seen: likelihoods, in any order; with fewer than LEAST the prior of any camera is returned.
    """
    prior = Falloff()
    if len(seen) < LEAST:
        return prior
    # In fixed order, as sums of floats depend on it.
    ordered = sorted(seen, key=lambda one: (one.shift, one.precision))
    shifts = np.array([one.shift for one in ordered])
    precisions = np.array([one.precision for one in ordered])[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    tried = (_combined(shifts, precisions, prior, scatter) for scatter in _SCATTER)
    _, mean, covariance = max(tried, key=lambda one: one[0])
    first, second = np.sqrt(np.diagonal(covariance)).tolist()
    across, up = mean.tolist()
    return Falloff((across, up), (first, second), float(covariance[0, 1]) / (first * second))


def _combined(
    shifts: Doubles, precisions: Doubles, prior: Falloff, scatter: float
) -> tuple[float, Doubles, Doubles]:
    """Log likelihood of tau, and mean (2,) and covariance (2, 2) of the next photograph's x_i.

    Args:
        shifts: (n, 2) h_i.
        precisions: (n, 2, 2) L_i.
        prior: of x.
        scatter: tau.
    """
    wider = np.eye(2) + scatter**2 * precisions
    widened = np.linalg.inv(wider)
    precisions, shifts = widened @ precisions, np.einsum("nij,nj->ni", widened, shifts)
    spread = np.linalg.pinv(precisions, hermitian=True)
    weight = np.ones(len(shifts))
    for _ in range(_ROUNDS):
        precision = prior.precision + np.einsum("n,nij->ij", weight, precisions)
        mean = _no_gain(precision, prior.precision @ prior.mean + weight @ shifts)
        deviation = shifts - precisions @ mean
        distances = np.einsum("ni,nij,nj->n", deviation, spread, deviation)
        weight = (_FREEDOM + 2.0) / (_FREEDOM + distances)
    likelihood = -0.5 * np.linalg.slogdet(wider).logabsdet
    likelihood -= 0.5 * (_FREEDOM + 2.0) * np.log1p(distances / _FREEDOM)
    # The variance of Student's t with scale tau.
    variance = scatter**2 * _FREEDOM / (_FREEDOM - 2.0)
    return float(likelihood.sum()), mean, np.linalg.inv(precision) + variance * np.eye(2)


def _no_gain(precision: Doubles, shift: Doubles) -> Doubles:
    """Most likely x (2,) with non-negative coefficients."""
    mean = np.linalg.solve(precision, shift)
    for one, other in ((0, 1), (1, 0)):
        if mean[one] < 0.0:
            mean = np.zeros(2)
            mean[other] = max(0.0, shift[other] / precision[other, other])
    return np.asarray(mean, np.float64)
