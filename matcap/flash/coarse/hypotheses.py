"""The two hypotheses of the coarse fit, a dielectric and a conductor: Gaussian priors.

One wide prior of F0 cannot replace them: it makes black lacquer metal, and metal a matte surface
under a narrow flash. Values: docs/notes/gloss.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from matcap.flash.coarse.model import Unknowns, numbers
from matcap.photo.photo import Photo
from matcap.photo.tone import Development

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
    """A Gaussian measurement of both tilt angles from elsewhere (space/alignment.py).

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


@dataclass(frozen=True)
class Hypothesis:
    """Gaussian prior of the unknowns, and whether they are a conductor's."""

    mean: Unknowns
    """Mean of the prior."""
    precision: Tensor
    """(17, 17) inverse covariance."""
    conductor: bool
    """Whether `albedo` is F0 and nothing is diffuse."""
    tilt_known: bool
    """Whether the tilt is held."""
    tilt_alone: tuple[Tensor, Tensor] | None
    """Mean and deviation of the tilt without a measurement of it; None without one."""


def hypothesis(
    photo: Photo,
    tilt: tuple[float, float] | None,
    tilt_prior: TiltPrior | None,
    *,
    conductor: bool,
) -> Hypothesis:
    """The prior of a photograph's parameters; arguments as of fit_coarse."""
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
    alone = None
    if tilt is not None:
        mean = replace(mean, tilt=numbers(*tilt))
        deviation = replace(deviation, tilt=numbers(_FIXED, _FIXED))
    elif tilt_prior is not None:
        alone = (mean.tilt, deviation.tilt)
        place, std = tilt_prior.posterior
        mean, deviation = replace(mean, tilt=place), replace(deviation, tilt=std)
    precision = torch.diag(deviation.vector().pow(-2))
    return Hypothesis(mean, precision, conductor, tilt is not None, alone)
