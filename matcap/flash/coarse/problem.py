"""The coarse fit's hypotheses (dielectric, conductor), its cost, and its minimisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from matcap.flash.coarse.cells import (
    COUNT,
    INDEX,
    CoarseCells,
    Doubles,
    Linear,
    Unknowns,
    log_radiance,
    mirror_point,
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
    Unknowns(**{name: np.array(prior[k]) for name, prior in _PRIORS.items()}) for k in (0, 1)
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
    def posterior(self) -> tuple[Doubles, Doubles]:
        """Mean and standard deviation of its product with the distribution of tilts, (2,) each."""
        measured = np.power(self.std, -2.0)
        precision = measured + _TILTS**-2
        return measured * np.array(self.mean) / precision, 1.0 / np.sqrt(precision)


def priors(
    photo: Photo, tilt: tuple[float, float] | None, tilt_prior: TiltPrior | None, *, conductor: bool
) -> tuple[Unknowns, Unknowns]:
    """Mean and standard deviation of a photograph's parameters; arguments as of fit_coarse."""
    mean = replace(_MEAN, tone=np.array([photo.development.log_exponent]))
    deviation = replace(_DEVIATION, tone=np.array([photo.development.deviation]))
    if conductor:
        mean = replace(mean, albedo=np.full(3, CONDUCTOR_F0.mean))
        deviation = replace(deviation, albedo=np.full(3, CONDUCTOR_F0.deviation))
    # A conductor colours all that it reflects; RAW and cards are white under the flash.
    if conductor or photo.radiometric or photo.flash_intensity is not None:
        deviation = replace(deviation, flash_colour=np.full(2, _FIXED))
    if photo.radiometric:
        deviation = replace(deviation, tilt=np.full(2, _TILT_RADIOMETRIC))
    if tilt is not None:
        mean = replace(mean, tilt=np.array(tilt))
        deviation = replace(deviation, tilt=np.full(2, _FIXED))
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
_LEAST, _MOST, _BEYOND = (np.full(COUNT, bound) for bound in (-np.inf, np.inf, np.inf))
_LEAST[INDEX.vignetting], _BEYOND[INDEX.vignetting] = 0.0, _BRIGHTENING
_MOST[INDEX.albedo], _BEYOND[INDEX.albedo] = math.log(WHITE), _WHITER
_COLOUR_NOISE = 0.01  # log radiance, least standard deviation of differences of channels
_MOST_TEXTURE = 0.5  # log radiance; residuals are clipped to +-this before whitening
_LEAST_WHOLE_CELLS = 30  # least number of unclipped cells for whitening
# Error of log albedo over F0 by what the model lacks, and the fit's residual above which it is
# larger. With both, fits of 69 simulated JPEGs deviate by 1.14 of the deviation, else by 1.74.
_LEVEL_ERROR, _USUAL_RESIDUAL = 0.3, 0.2

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
    def image(self) -> Doubles:
        """(2, 3 * directions) image coordinates: the centre, the half-width ring, outside."""
        radii = (0.0, self.highlight.width, 0.5 * sum(SURROUNDINGS))
        centre = np.array(self.highlight.centre)[:, None]
        return np.concatenate([centre + radius * _circle() for radius in radii], axis=1)

    def residuals(self, mirror: Linear, log_radiance: Linear) -> Linear:
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
        centre = (mirror.value - highlight.centre) / centre_deviation
        radiance = np.exp(log_radiance.value)
        limit = max(self.headroom, highlight.peak)  # as the camera clips
        light = np.minimum(radiance, limit).mean(0)
        by = (log_radiance.by * np.where(radiance < limit, radiance, 0.0)).mean(1) / light
        half_way = 0.5 * (highlight.peak + highlight.surroundings)
        expected = np.log([highlight.peak, half_way, highlight.surroundings])
        slope = math.log(highlight.contrast) / (2.0 * highlight.width)

        def measured(light: Doubles, expected: Doubles | float) -> Doubles:
            """(..., 5) symmetry and levels of log light (..., 3 * directions)."""
            rings = light.reshape(*light.shape[:-1], 3, _DIRECTIONS)
            middle = 2.0 * (rings[..., 1:2, :] * _circle()).mean(-1) / slope
            levels = (rings.mean(-1) - expected) / _RADIANCE_DEVIATION
            return np.concatenate([middle / middle_deviation, levels], axis=-1)

        return Linear(
            np.concatenate([centre, measured(np.log(light), expected)]),
            np.concatenate([mirror.by / centre_deviation, measured(by, 0.0)], axis=-1),
        )


@cache
def _circle() -> Doubles:
    """(2, directions) unit vectors at equal angles."""
    turn = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
    return np.stack([np.cos(turn), np.sin(turn)])


@dataclass(frozen=True)
class Problem:
    """The function to minimise."""

    cells: CoarseCells
    """Observations."""
    distance: float
    """Distance of the camera."""
    measurements: HighlightMeasurements | None
    """Measurements of the highlight, or None."""
    prior: Doubles
    """(17,) the prior's mean."""
    precision: Doubles
    """(17, 17) Hessian of the prior's cost."""
    unit: float
    """Cost of a nat of the prior."""
    diffuse_share: DiffuseRings | None = None
    """Colour scatter of the texture by ring, or None."""
    shoulder: float | None = None
    """Shoulder of the tone curve; None without one."""
    whitening: Doubles | None = None
    """(3, 3) of the channels of cells that no bound concerns; None for as they are."""
    conductor: bool = False
    """`albedo` of the parameters is F0, and nothing is diffuse."""

    def log_radiance(self, parameters: Doubles, image: Doubles) -> tuple[Linear, Linear]:
        """(3, n) log radiance at image coordinates (2, n), tone curve included, and (n,) its
        diffuse share.
        """
        linear, share = log_radiance(parameters, image, self.distance, conductor=self.conductor)
        if self.shoulder is None:  # no tone curve, whatever the exponent
            return linear, share
        # The logarithm of ToneCurve.developed().
        exponent = math.exp(parameters[INDEX.tone[0]])
        power = exponent * linear.value
        curved = 1.0 + self.shoulder * np.expm1(power)
        slope = (1.0 - self.shoulder) / curved
        by = linear.by * (exponent * slope)
        by[INDEX.tone] = slope * power
        return Linear(power - np.log(curved), by), share

    def differences(self, parameters: Doubles) -> Doubles:
        """(3, n) log radiance of the model less that of the cells."""
        return self.cells.differences(self.log_radiance(parameters, self.cells.image)[0]).value

    def whitened(self, parameters: Doubles) -> Problem:
        """The problem with channels whitened by the residuals at `parameters`.

        Light is common to all channels, texture is not: channel differences separate the two.
        """
        counted = self._whole & (self.cells.weight > 0.0)
        if int(counted.sum()) < _LEAST_WHOLE_CELLS:
            return self
        rest = self.differences(parameters)[:, counted]
        return replace(self, whitening=_whitening(rest, self.cells.weight[counted]))

    def with_estimated_noise(self, parameters: Doubles) -> Problem:
        """The problem with the prior's weight set from the residuals of a first fit."""
        count = self.cells.observed.size
        rest = self.residuals(parameters).value[:count].clip(-_MOST_TEXTURE, _MOST_TEXTURE)
        nat = float(np.average(np.square(rest), weights=self.weight[:count])) / _CELLS_THAT_COUNT
        return replace(self, precision=self.precision * (nat / self.unit), unit=nat)

    @cached_property
    def weight(self) -> Doubles:
        """(residuals,) weight of each residual."""
        each = [np.tile(self.cells.weight, 3)]
        if self.measurements is not None:
            each.append(np.full(7, self.measurements.weight))
        if self.diffuse_share is not None:
            each.append(np.full(len(self.diffuse_share.log_scatter), self.unit / HUBER**2))
        return np.concatenate(each)

    @cached_property
    def _image(self) -> Doubles:
        """(2, n) image coordinates of cells, of the highlight's measurements and of rings."""
        measured = [] if self.measurements is None else [self.measurements.image]
        rings = [] if self.diffuse_share is None else [self.diffuse_share.image.reshape(2, -1)]
        return np.concatenate([self.cells.image, *measured, *rings], axis=1)

    @cached_property
    def _whole(self) -> NDArray[np.bool_]:
        """(cells,) no channel is a lower bound."""
        return np.asarray((self.cells.above == 1.0).all(0))

    def residuals(self, parameters: Doubles) -> Linear:
        """(residuals,) residuals at the parameters, in log radiance."""
        cells = self.cells
        (log, log_by), share = self.log_radiance(parameters, self._image)
        count = cells.image.shape[1]
        difference, by = cells.differences(Linear(log[:, :count], log_by[..., :count]))
        # Of a lower bound, only a darker model has a residual.
        scale = np.where(difference > 0.0, cells.above, 1.0)
        bounded, bounded_by = difference * scale, by * scale
        if self.whitening is not None:
            bounded = np.where(self._whole, self.whitening @ difference, bounded)
            bounded_by = np.where(self._whole, self.whitening @ by, bounded_by)
        parts = [Linear(bounded.ravel(), bounded_by.reshape(COUNT, -1))]
        if self.measurements is not None:
            mirror = mirror_point(parameters, self.distance)
            end = count + self.measurements.image.shape[1]
            seen = Linear(log[:, count:end], log_by[..., count:end])
            value, by = self.measurements.residuals(mirror, seen)
            parts.append(Linear(HUBER * value, HUBER * by))
            count = end
        if self.diffuse_share is not None:
            shape = self.diffuse_share.image.shape[1:]
            rings, rings_by = (
                each[..., count:].reshape(*each.shape[:-1], *shape).mean(-1) for each in share
            )
            # A conductor's texture is that of its F0, which no other light veils.
            if self.conductor:
                rings, rings_by = np.ones_like(rings), np.zeros_like(rings_by)
            value, by_share = self.diffuse_share.residuals(rings)
            parts.append(Linear(HUBER * value, HUBER * rings_by @ by_share.T))
        return Linear(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))

    def quadratic(self, parameters: Doubles, r: Linear | None = None) -> tuple[Doubles, Doubles]:
        """(17, 17) Gauss-Newton Hessian of the cost and (17,) its gradient, without bounds.

        `r` are the residuals there, if they are known.
        """
        value, by = self.residuals(parameters) if r is None else r
        weighted = by * (self.weight * huber(value, HUBER)[1])
        hessian = weighted @ by.T + self.precision
        return hessian, weighted @ value + self.precision @ (parameters - self.prior)

    def level_deviation(self, parameters: Doubles, residual: float) -> float:
        """Standard deviation of log albedo over F0 of a dielectric, by Laplace's method, widened by
        the model's error and a large residual of the fit.
        """
        hessian, _ = self.quadratic(parameters)
        ratio = np.zeros(COUNT)
        ratio[INDEX.albedo], ratio[INDEX.specular] = 1.0 / 3.0, -1.0
        statistical = math.sqrt(ratio @ np.linalg.solve(hessian / self.unit, ratio))
        return math.hypot(_LEVEL_ERROR, statistical * max(1.0, residual / _USUAL_RESIDUAL))

    def bound_excess(self, parameters: Doubles) -> tuple[Doubles, Doubles]:
        """(17,) each: how far parameters are beyond their bounds, and the prior's precision there.

        Falloff is positive, and no albedo, nor F0 of a conductor, is above WHITE.
        """
        excess = parameters - parameters.clip(_LEAST, _MOST)
        return excess, np.where(excess == 0.0, 0.0, self.unit / np.square(_BEYOND))

    def cost(self, parameters: Doubles, r: Linear | None = None) -> float:
        """Cost at the parameters; `r` are the residuals there, if they are known."""
        loss, _ = huber((self.residuals(parameters) if r is None else r).value, HUBER)
        deviation = parameters - self.prior
        excess, precision = self.bound_excess(parameters)
        prior = deviation @ self.precision @ deviation + np.square(excess) @ precision
        return float(self.weight @ loss + 0.5 * prior)

    def minimised(self, start: Doubles, iterations: int) -> tuple[float, Doubles]:
        """(cost, parameters) after at most `iterations` Levenberg-Marquardt steps."""
        last: tuple[Doubles, Linear | None] = (start, None)  # parameters and their residuals

        def cost(parameters: Doubles) -> float:
            nonlocal last
            last = parameters, self.residuals(parameters)
            return self.cost(*last)

        def quadratic(parameters: Doubles) -> tuple[Doubles, Doubles]:
            known = last[1] if last[0] is parameters else None
            normal, gradient = self.quadratic(parameters, known)
            excess, precision = self.bound_excess(parameters)
            return normal + np.diag(precision), gradient + precision * excess

        return minimised(cost, quadratic, start, iterations, farthest=1.0)


def _whitening(residuals: Doubles, weight: Doubles) -> Doubles:
    """(3, 3) whitening of the channels of residuals (3, n), which keeps their mean variance.

    The direction common to all channels is only scaled, so that an unfitted light does no harm.
    """
    kept = residuals.clip(-_MOST_TEXTURE, _MOST_TEXTURE)
    covariance = np.cov(kept, aweights=weight, ddof=0) + _COLOUR_NOISE**2 * np.eye(3)
    values, vectors = np.linalg.eigh(covariance)
    scale = math.sqrt(np.trace(covariance) / 3.0)
    return np.asarray(scale * (vectors / np.sqrt(values)) @ vectors.T)
