"""The coarse fit's hypotheses (dielectric, conductor), its cost, and its minimisation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.flash.coarse.cells import (
    COUNT,
    INDEX,
    CoarseCells,
    Unknowns,
    log_radiance,
    mirror_point,
    numbers,
)
from matcap.flash.diffuse_share import DiffuseRings
from matcap.flash.highlight import SURROUNDINGS, Highlight
from matcap.flash.least_squares import huber, minimised
from matcap.photo.photo import Development, Photo

# The two hypotheses of the coarse fit, a dielectric and a conductor: Gaussian priors.
#
# One wide prior of F0 cannot replace them: it makes black lacquer metal, and metal a matte surface
# under a narrow flash. Values: docs/notes/gloss.md.

# Prior standard deviation of the tilt of a RAW, radians; larger than that of developed pictures,
# whose tone curve looks like tilt.
_TILT_RADIOMETRIC = 0.1
# Standard deviation of hand-held tilts, radians: 5 degrees. Patterns of real photographs show 8
# about x and 4 about y (root mean square; docs/guide/paper.md).
_TILTS = 0.087
_FIXED = 1e-4  # standard deviation of a parameter that is known


class Gaussian(NamedTuple):
    """A normal distribution of one number."""

    mean: float
    deviation: float


# Of log F0: index of refraction 1.5, and metals.
DIELECTRIC_F0, CONDUCTOR_F0 = Gaussian(math.log(0.04), 0.15), Gaussian(math.log(0.5), 0.5)
TONE = Gaussian(0.12, 0.08)  # of the log exponent of a tone curve
# Mean and standard deviation of each unknown.
_PRIORS = {
    "albedo": ([math.log(0.2)] * 3, [1.5] * 3),
    "specular": ([DIELECTRIC_F0.mean], [DIELECTRIC_F0.deviation]),
    "roughness": ([0.0], [1.5]),
    "intensity": ([3.0], [5.0]),
    "flash_colour": ([0.0] * 2, [0.3] * 2),  # white balance is the whole picture's, not the flash's
    "offset": ([0.0] * 2, [0.12] * 2),
    "tilt": ([0.0] * 2, [0.05] * 2),
    # 95 photographs by one phone had a + b = 0.73 on the median, with a deviation of 0.35.
    "vignetting": ([0.3, 0.5], [0.35, 0.7]),
    "centre": ([0.0] * 2, [0.2] * 2),
    "tone": ([Development().log_exponent], [Development().deviation]),
}
_MEAN, _DEVIATION = (
    Unknowns(**{name: numbers(*prior[k]) for name, prior in _PRIORS.items()}) for k in (0, 1)
)


@dataclass(frozen=True)
class TiltPrior:
    """A Gaussian measurement of both tilt angles from elsewhere (flash/alignment.py).

    Times the distribution of tilts it takes the place of the fit's own prior, which is as narrow as
    it is because errors of the tone curve look like tilt, and not because tilts are small.
    """

    mean: tuple[float, float]
    """(tilt_x, tilt_y) in radians."""
    std: tuple[float, float]
    """Their standard deviations, radians."""

    @property
    def posterior(self) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of its product with the distribution of tilts, (2,) each."""
        measured = numbers(*self.std).pow(-2)
        precision = measured + _TILTS**-2
        return measured * numbers(*self.mean) / precision, precision.rsqrt()


def priors(
    photo: Photo, tilt: tuple[float, float] | None, tilt_prior: TiltPrior | None, *, conductor: bool
) -> tuple[Unknowns, Unknowns]:
    """Mean and standard deviation of a photograph's parameters; arguments as of fit_coarse."""
    mean = replace(_MEAN, tone=numbers(photo.development.log_exponent))
    deviation = replace(_DEVIATION, tone=numbers(photo.development.deviation))
    if conductor:
        mean = replace(mean, albedo=numbers(*[CONDUCTOR_F0.mean] * 3))
        deviation = replace(deviation, albedo=numbers(*[CONDUCTOR_F0.deviation] * 3))
    # A conductor colours all that it reflects; RAW and cards are white under the flash.
    if conductor or photo.radiometric or photo.flash_intensity is not None:
        deviation = replace(deviation, flash_colour=numbers(_FIXED, _FIXED))
    if photo.radiometric:
        deviation = replace(deviation, tilt=numbers(_TILT_RADIOMETRIC, _TILT_RADIOMETRIC))
    if tilt is not None:
        mean = replace(mean, tilt=numbers(*tilt))
        deviation = replace(deviation, tilt=numbers(_FIXED, _FIXED))
    elif tilt_prior is not None:
        place, std = tilt_prior.posterior
        mean, deviation = replace(mean, tilt=place), replace(deviation, tilt=std)
    return mean, deviation


# The coarse fit's cost, its normal equations, and its minimisation.
#
# With the residuals r_i in log radiance of cells, of the highlight (HighlightMeasurements) and of
# the diffuse share by ring (flash/diffuse_share.py), their weights w_i, the parameters x and the
# prior's mean m and precision P,
#
# cost = sum_i w_i huber(r_i) + (x - m)^T P (x - m) / 2.
#
# Minimised by Levenberg-Marquardt steps, with weights of the Huber loss renewed at each.

HUBER = 0.1  # threshold of the Huber loss, log radiance
# Number of residuals per nat of the prior in a RAW, chosen empirically; about the number of cells,
# whose whitened channels are independent.
_CELLS_THAT_COUNT = 600.0
_BRIGHTENING = 0.02  # prior deviation of negative falloff, which ambient light imitates
# Albedo of a white surface, and prior deviation of the logarithm beyond it.
WHITE, _WHITER = 0.8, 0.1
# Bounds of the parameters, and the prior's deviation beyond them.
_LEAST, _MOST, _BEYOND = numbers(-math.inf, math.inf, math.inf)[:, None].repeat(1, COUNT)
_LEAST[INDEX.vignetting], _BEYOND[INDEX.vignetting] = 0.0, _BRIGHTENING
_MOST[INDEX.albedo], _BEYOND[INDEX.albedo] = math.log(WHITE), _WHITER
_COLOUR_NOISE = 0.01  # log radiance, least standard deviation of differences of channels
_MOST_TEXTURE = 0.5  # log radiance; residuals are clipped to +-this before whitening
_LEAST_WHOLE_CELLS = 30  # least number of unclipped cells for whitening
_STEP = 1e-5  # of finite differences in parameters, all of which are of order 1

# Measurements of the highlight.
# Weight of the seven measurements; in a RAW they only help convergence, a tone curve changes the
# surroundings. Where one of several minima is chosen it is greater: laminate, whose sharp highlight
# covers few cells, would else be satin under a narrow flash.
WEIGHT, WEIGHT_BETWEEN = 0.005, 0.05
# Standard deviation of the highlight's centre from the mirror point: plane units, plus a share of
# its half width; the same of the centre of its half-way ring.
_CENTRE_DEVIATION, _MIDDLE_DEVIATION = (0.006, 0.1), (0.004, 0.03)
_RADIANCE_DEVIATION = 0.1  # of peak, half-way level and surroundings, log radiance
_DIRECTIONS = 12  # points of a ring


@dataclass(frozen=True)
class HighlightMeasurements:
    """Seven measurements of a highlight, and their weight as a share of the picture's.

    The mirror point (2) converges from any distance, but is only near the centre of a wide
    highlight; the symmetry of the half-width ring (2) is exact; radiance of peak, ring and
    surroundings (3).
    """

    highlight: Highlight
    headroom: float = 1.0
    """Radiance at which the photograph clips."""
    weight: float = WEIGHT

    @cached_property
    def image(self) -> Tensor:
        """(2, 3 * directions) image coordinates: the centre, the half-width ring, outside."""
        radii = (0.0, self.highlight.width, 0.5 * sum(SURROUNDINGS))
        centre = numbers(*self.highlight.centre)[:, None]
        return torch.cat([centre + radius * _circle() for radius in radii], dim=1)

    def residuals(self, mirror: Tensor, log_radiance: Tensor) -> Tensor:
        """(7,) standardised residuals of a model.

        Args:
            mirror: (2,) image coordinates of its mirror point.
            log_radiance: (3, 3 * directions) at `image`.
        """
        highlight = self.highlight
        centre_deviation, middle_deviation = (
            least + share * highlight.width
            for least, share in (_CENTRE_DEVIATION, _MIDDLE_DEVIATION)
        )
        centre = (mirror - numbers(*highlight.centre)) / centre_deviation
        radiance = log_radiance.exp()
        limit = max(self.headroom, highlight.peak)  # as the camera clips
        light = radiance.clamp_max(limit).mean(0).log()
        rings = light.unflatten(0, (3, _DIRECTIONS))
        slope = math.log(highlight.contrast) / (2.0 * highlight.width)
        middle = 2.0 * (rings[1] * _circle()).mean(1) / slope
        half_way = 0.5 * (highlight.peak + highlight.surroundings)
        expected = torch.tensor([highlight.peak, half_way, highlight.surroundings]).double().log()
        radiances = (rings.mean(1) - expected) / _RADIANCE_DEVIATION
        return torch.cat([centre, middle / middle_deviation, radiances])


@cache
def _circle() -> Tensor:
    """(2, directions) unit vectors at equal angles."""
    turn = torch.arange(_DIRECTIONS, dtype=torch.float64) * (2.0 * math.pi / _DIRECTIONS)
    return torch.stack([turn.cos(), turn.sin()])


@dataclass(frozen=True)
class Problem:
    """The function to minimise."""

    cells: CoarseCells
    """Observations."""
    distance: float
    """Distance of the camera."""
    measurements: HighlightMeasurements | None
    """Measurements of the highlight, or None."""
    prior: Tensor
    """(n,) the prior's mean."""
    precision: Tensor
    """(n, n) Hessian of the prior's cost."""
    unit: float
    """Cost of a nat of the prior."""
    diffuse_share: DiffuseRings | None = None
    """Colour scatter of the texture by ring, or None."""
    shoulder: float | None = None
    """Shoulder of the tone curve; None without one."""
    whitening: Tensor | None = None
    """(3, 3) of the channels of cells that no bound concerns; None for as they are."""
    conductor: bool = False
    """`albedo` of the parameters is F0, and nothing is diffuse."""

    def log_radiance(self, parameters: Tensor, image: Tensor) -> tuple[Tensor, Tensor]:
        """(3, n) log radiance at image coordinates (2, n), tone curve included, and (n,) its
        diffuse share.
        """
        unknowns = Unknowns.of(parameters)
        linear, share = log_radiance(unknowns, image, self.distance, conductor=self.conductor)
        if self.shoulder is None:  # no tone curve, whatever the exponent
            return linear, share
        # The logarithm of ToneCurve.developed().
        power = unknowns.tone.exp() * linear
        return power - (1.0 + self.shoulder * power.expm1()).log(), share

    def differences(self, parameters: Tensor) -> Tensor:
        """(3, n) log radiance of the model less that of the cells."""
        return self.cells.differences(self.log_radiance(parameters, self.cells.image)[0])

    def whitened(self, parameters: Tensor) -> Problem:
        """The problem with channels whitened by the residuals at `parameters`.

        Light is common to all channels, texture is not: channel differences separate the two.
        """
        if int(self._whole.sum()) < _LEAST_WHOLE_CELLS:
            return self
        rest = self.differences(parameters)[:, self._whole]
        return replace(self, whitening=_whitening(rest, self.cells.weight[self._whole]))

    def with_estimated_noise(self, parameters: Tensor) -> Problem:
        """The problem with the prior's weight set from the residuals of a first fit."""
        count = self.cells.observed.numel()
        rest = self.residuals(parameters)[:count].clamp(-_MOST_TEXTURE, _MOST_TEXTURE)
        variance = (self.weight[:count] * rest.square()).sum() / self.weight[:count].sum()
        nat = float(variance) / _CELLS_THAT_COUNT
        return replace(self, precision=self.precision * (nat / self.unit), unit=nat)

    @cached_property
    def weight(self) -> Tensor:
        """(residuals,) weight of each residual."""
        each = self.cells.weight.repeat(3)
        if self.measurements is not None:
            each = F.pad(each, (0, 7), value=self.measurements.weight)
        if self.diffuse_share is not None:
            each = F.pad(each, (0, len(self.diffuse_share.log_scatter)), value=self.unit / HUBER**2)
        return each

    @cached_property
    def _image(self) -> Tensor:
        """(2, n) image coordinates of cells, of the highlight's measurements and of rings."""
        measured = [] if self.measurements is None else [self.measurements.image]
        rings = [] if self.diffuse_share is None else [self.diffuse_share.image.flatten(1)]
        return torch.cat([self.cells.image, *measured, *rings], dim=1)

    @cached_property
    def _whole(self) -> Tensor:
        """(cells,) bool, no channel is a lower bound."""
        return (self.cells.above == 1.0).all(0)

    def residuals(self, parameters: Tensor) -> Tensor:
        """(residuals,) residuals at the parameters, in log radiance."""
        cells, unknowns = self.cells, Unknowns.of(parameters)
        everywhere, share = self.log_radiance(parameters, self._image)
        count = cells.image.shape[1]
        difference = cells.differences(everywhere[:, :count])
        # Of a lower bound, only a darker model has a residual.
        bounded = torch.where(difference > 0.0, difference * cells.above, difference)
        if self.whitening is not None:
            bounded = torch.where(self._whole, self.whitening @ difference, bounded)
        parts = [bounded.flatten()]
        if self.measurements is not None:
            mirror = mirror_point(unknowns, self.distance)
            end = count + self.measurements.image.shape[1]
            parts.append(HUBER * self.measurements.residuals(mirror, everywhere[:, count:end]))
            count = end
        if self.diffuse_share is not None:
            rings = share[count:].unflatten(0, self.diffuse_share.image.shape[1:]).mean(1)
            # A conductor's texture is that of its F0, which no other light veils.
            seen = torch.ones_like(rings) if self.conductor else rings
            parts.append(HUBER * self.diffuse_share.residuals(seen))
        return torch.cat(parts)

    def quadratic(self, parameters: Tensor, r: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(n, n) Gauss-Newton Hessian of the cost and (n,) its gradient, without bounds.

        `r` are the residuals there, if they are known.
        """
        r = self.residuals(parameters) if r is None else r
        jacobian = _jacobian(self.residuals, parameters, r)
        weight = self.weight * huber(r, HUBER)[1]
        hessian = (jacobian * weight[:, None]).T @ jacobian + self.precision
        return hessian, jacobian.T @ (weight * r) + self.precision @ (parameters - self.prior)

    def level_deviation(self, parameters: Tensor) -> float:
        """Standard deviation of log albedo over F0 of a dielectric, by Laplace's method."""
        hessian, _ = self.quadratic(parameters)
        ratio = torch.zeros_like(parameters)
        ratio[INDEX.albedo], ratio[INDEX.specular] = 1.0 / 3.0, -1.0
        return float((ratio @ torch.linalg.solve(hessian / self.unit, ratio)).sqrt())

    def bound_excess(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """(n,) each: how far parameters are beyond their bounds, and the prior's precision there.

        Falloff is positive, and no albedo, nor F0 of a conductor, is above WHITE.
        """
        excess = parameters - parameters.clamp(_LEAST, _MOST)
        return excess, torch.where(excess == 0.0, 0.0, self.unit / _BEYOND.square())

    def cost(self, parameters: Tensor, r: Tensor | None = None) -> float:
        """Cost at the parameters; `r` are the residuals there, if they are known."""
        loss, _ = huber(self.residuals(parameters) if r is None else r, HUBER)
        deviation = parameters - self.prior
        prior = 0.5 * deviation @ self.precision @ deviation
        excess, precision = self.bound_excess(parameters)
        prior = prior + 0.5 * (excess.square() * precision).sum()
        return float((self.weight * loss).sum() + prior)

    def minimised(self, start: Tensor, iterations: int) -> tuple[float, Tensor]:
        """(cost, parameters) after at most `iterations` Levenberg-Marquardt steps."""
        last: tuple[Tensor, Tensor | None] = (start, None)  # parameters and their residuals

        def cost(parameters: Tensor) -> float:
            nonlocal last
            last = parameters, self.residuals(parameters)
            return self.cost(*last)

        def quadratic(parameters: Tensor) -> tuple[Tensor, Tensor]:
            known = last[1] if last[0] is parameters else None
            normal, gradient = self.quadratic(parameters, known)
            excess, precision = self.bound_excess(parameters)
            return normal + torch.diag(precision), gradient + precision * excess

        return minimised(cost, quadratic, start, iterations, farthest=1.0)


def _whitening(residuals: Tensor, weight: Tensor) -> Tensor:
    """(3, 3) whitening of the channels of residuals (3, n), which keeps their mean variance.

    The direction common to all channels is only scaled, so that an unfitted light does no harm.
    """
    share = weight / weight.sum()
    kept = residuals.clamp(-_MOST_TEXTURE, _MOST_TEXTURE)
    kept = kept - (kept * share).sum(1, keepdim=True)
    covariance = (kept * share) @ kept.T
    covariance = covariance + _COLOUR_NOISE**2 * torch.eye(3, dtype=covariance.dtype)
    values, vectors = torch.linalg.eigh(covariance)
    scale = (covariance.trace() / 3.0).sqrt()
    return scale * (vectors * values.rsqrt()) @ vectors.T


def _jacobian(residuals: Callable[[Tensor], Tensor], parameters: Tensor, here: Tensor) -> Tensor:
    """(residuals, parameters) Jacobian by forward differences from the residuals `here`.

    Accurate to 1e-5 in float64, enough for the accepted steps. Faster than `torch.func.jacfwd` for
    few parameters, which also takes two seconds to import PyTorch's compiler.
    """
    steps = _STEP * torch.eye(len(parameters), dtype=parameters.dtype)
    return (torch.vmap(residuals)(parameters + steps) - here).T / _STEP
