"""Albedo, F0 and roughness of material classes, from the profile of the highlight.

For rings i of texels around the mirror point (where a mirror would show the flash), the logarithm
of the mean radiance of each class k is compared with the photograph's:

    log mean_i(w_k L) = log mean_i(w_k sum_k w_k L(theta_k)) + noise

where w_k are the class shares of a texel, by robust least squares over the mean parameters
theta_k = (log albedo 3, log F0, logit roughness), with a Gaussian prior. L includes the relief: the
width of a highlight is due to roughness and slopes. Ring means depend on the strength of relief but
not on its registration, and weigh the few texels at the mirror point like the many beyond. The
radiance of a partly clipped ring is a lower bound; taken as equality it would bias roughness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from matcap.brdf.parameters import F0, SurfaceParameters
from matcap.capture.exemplar.network.inputs import STEP
from matcap.capture.exemplar.noise import DARKEST
from matcap.field.single import one_thread
from matcap.flash.light import FlashLight, Incidence

_INNERMOST = 0.02  # r0, plane units; the ring of radius r is _PER_OCTAVE log2(1 + r / r0)
_PER_OCTAVE = 4.0  # rings per octave of radius
_RING_TEXELS = 50.0  # n0 of the weight n / (n + n0) of a ring with n texels of a class
BOUND = 0.05  # clipped share of a ring above which its mean is only a lower bound
# Standard deviation of a ring's log radiance, and threshold of its Huber loss.
_NOISE, _HUBER = 0.1, 0.3
ROUGHNESS_DEVIATION = 0.3  # prior standard deviation of logit roughness
_MOST_STEP = 0.4  # largest change of a parameter in a step
_STEPS = 16  # most Gauss-Newton steps
_LEAST_STEP = 1e-5  # change of all parameters below which there is no further step


@dataclass(frozen=True)
class MeanParameterPrior:
    """Gaussian prior of the mean parameters."""

    mean: Tensor
    deviation: Tensor
    """(K, 5) mean and standard deviation."""
    contrast: tuple[float, float] = (0.0, math.inf)
    """Mean and standard deviation of log F0 of the first class less that of the last."""


@dataclass(frozen=True)
class RingTarget:
    """A photograph with its geometry, light and relief."""

    linear: Tensor
    """(3, H, W) radiance on the plane's grid; 1 is where it clips."""
    measured: Tensor
    """(3, H, W) bool: not clipped."""
    counts: Tensor
    """(H, W) bool: in the picture, clipped or not."""
    distance: Tensor
    """(H, W) plane units from the mirror point."""
    flash: FlashLight
    """The photograph's."""
    normal: Tensor
    """(3, H, W) unit normals of the relief."""
    surface: SurfaceParameters
    """Log parameters to which mean parameters are added; broadcasts to (..., H, W)."""
    tints: tuple[Tensor | float, ...] = (1.0,)
    """Specular tint of each class, F0 over its channel mean: (3, 1, 1) or one number."""

    def thinned(self, texels: int) -> RingTarget:
        """Subsample so that at least `texels` remain along the short side."""
        size = self.distance.shape
        every = slice(None, None, max(1, min(size) // texels))

        def thin(plane: Tensor) -> Tensor:
            return plane[..., every, every] if plane.shape[-2:] == size else plane

        planes = ("linear", "measured", "counts", "distance", "normal")
        parts = (getattr(self.surface, each.name) for each in fields(SurfaceParameters))
        return replace(
            self,
            **{name: thin(getattr(self, name)) for name in planes},
            flash=self.flash.cut(every, every),
            surface=SurfaceParameters(*(thin(part) for part in parts)),
            tints=tuple(thin(tint) if isinstance(tint, Tensor) else tint for tint in self.tints),
        )

    def rendered(
        self, theta: Tensor, incidence: Incidence, duller: float = 0.0
    ) -> list[tuple[Tensor, Tensor]]:
        """Diffuse and specular radiance (3, H, W) of each class at every texel.

        Args:
            theta: (K, 5) mean parameters, added to the surface.
            incidence: of the flash on the relief.
            duller: added to the logit of roughness.
        """
        one = torch.ones_like(self.distance)[None]
        parts = []
        for of_class, tint in zip(theta, self.tints, strict=True):
            surface = self.surface + SurfaceParameters.from_vector(of_class)
            roughness = torch.sigmoid(surface.roughness + duller)
            parts.append(
                (
                    incidence.diffuse(surface.diffuse.exp() * one),
                    incidence.specular(surface.specular.exp() * tint * one, roughness * one),
                )
            )
        return parts


class _Rings:
    """Class-weighted means over rings around the mirror point."""

    def __init__(self, target: RingTarget, shares: Tensor) -> None:
        octaves = torch.log2(1.0 + target.distance / _INNERMOST)
        self._ring = (_PER_OCTAVE * octaves).long().flatten()
        self._many = int(self._ring.max()) + 1
        self._weights = [(share * target.counts).flatten() for share in shares]
        sums = torch.stack([self._sums(weight) for weight in self._weights])
        self._sizes = sums.clamp_min(1e-6)
        self.counts = (sums / (sums + _RING_TEXELS))[:, None].expand(-1, 3, -1)

    def _sums(self, weight: Tensor) -> Tensor:
        return torch.bincount(self._ring, weight, self._many)

    def means(self, picture: Tensor) -> Tensor:
        """(K, C, rings): mean of a picture (C, H, W) over each ring, weighted by class share."""
        flat = picture.flatten(1)
        return torch.stack(
            [
                torch.stack([self._sums(channel * weight) for channel in flat]) / size
                for weight, size in zip(self._weights, self._sizes, strict=True)
            ]
        )


@one_thread()
def fit_mean_parameters(
    target: RingTarget,
    shares: Tensor,
    start: Tensor,
    prior: MeanParameterPrior,
) -> tuple[Tensor, float]:
    """(K, 5) mean parameters fitted to the ring means, and their mean absolute log residual.

    Args:
        target: the photograph.
        shares: (K, H, W) share of each class in each texel; they sum to 1.
        start: (K, 5) initial values.
        prior: of the result.
    """
    rings = _Rings(target, shares)
    observed = rings.means(target.linear.clamp_max(1.0)).clamp_min(DARKEST).log()
    incidence = target.flash.onto(target.normal)
    precision = prior.deviation.flatten().square().reciprocal()
    contrast = torch.zeros_like(start)
    contrast[0, F0], contrast[-1, F0] = 1.0, -1.0
    contrast_mean, contrast_precision = prior.contrast[0], prior.contrast[1] ** -2
    across = contrast.flatten()
    counts = rings.counts.flatten() / _NOISE**2
    open_share = 1.0 - rings.means((~target.measured).float()).flatten() / BOUND
    bound = open_share.clamp(0.0, 1.0)
    theta = start
    for _ in range(_STEPS):
        residual, columns = _linear(target, incidence, rings, shares, theta, observed)
        robust = _HUBER / residual.abs().clamp_min(_HUBER)
        robust = torch.where(residual < 0.0, bound * robust, robust)
        weighted = columns * (counts * robust)
        normal = (
            weighted @ columns.T
            + torch.diag(precision)
            + contrast_precision * across[:, None] * across
        )
        gradient = weighted @ residual - precision * (theta - prior.mean).flatten()
        gradient += contrast_precision * (contrast_mean - across @ theta.flatten()) * across
        step = torch.linalg.solve(normal, gradient).clamp(-_MOST_STEP, _MOST_STEP)
        theta = theta + step.reshape(theta.shape)
        if float(step.abs().max()) < _LEAST_STEP:
            break
    residual, _ = _linear(target, incidence, rings, shares, theta, observed)
    counts = counts * torch.where(residual < 0.0, bound, 1.0)
    return theta, float((residual.abs() * counts).sum() / counts.sum())


def _linear(
    target: RingTarget,
    incidence: Incidence,
    rings: _Rings,
    shares: Tensor,
    theta: Tensor,
    observed: Tensor,
) -> tuple[Tensor, Tensor]:
    """(N,) residuals of the rings' log radiance, and (5 K, N) d log mean / d mean parameter."""
    parts = target.rendered(theta, incidence)
    duller = target.rendered(theta, incidence, STEP)
    # (K, C, rings) of each class: diffuse, specular, and the latter's derivative by roughness.
    means = [
        (
            rings.means(share * diffuse),
            rings.means(share * specular),
            rings.means(share * (moved - specular) / STEP),
        )
        for share, (diffuse, specular), (_, moved) in zip(shares, parts, duller, strict=True)
    ]
    mean = torch.stack([matte + mirrored for matte, mirrored, _ in means]).sum(0)
    mean = mean.clamp_min(DARKEST)
    columns = []
    for matte, mirrored, widened in means:
        for channel in range(3):
            column = torch.zeros_like(mean)
            column[:, channel] = matte[:, channel] / mean[:, channel]
            columns.append(column)
        columns += [mirrored / mean, widened / mean]
    return (observed - mean.log()).flatten(), torch.stack(columns).flatten(1)
