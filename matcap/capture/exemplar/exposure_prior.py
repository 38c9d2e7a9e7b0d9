"""Exposure prior: the most probable flash intensity, which one photograph does not determine.

Twice the albedo and F0 under half the flash give the same picture. The scale is found from a prior
of materials: dielectrics have F0 near 0.04 (index of refraction 1.5) whatever their albedo, which
spans two orders of magnitude; metals have a high F0 and no diffuse albedo. So the ratio of F0 to
albedo, which a highlight measures, determines both: black leather with F0 three times its albedo is
black. Where texels are classified as metal or dielectric (material_classes.py), each part has the
prior of its own class, and metal that of its colour: gold is brighter than steel.
See docs/notes/capture.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.metals import METAL_F0
from matcap.brdf.parameters import ALBEDO, F0
from matcap.example.exemplar import Exemplar
from matcap.files.rec709 import LUMINANCE
from matcap.flash.coarse.hypotheses import CONDUCTOR_F0, DIELECTRIC_F0, Gaussian

_LUMINANCE = np.array(LUMINANCE, np.float32)
_LEAST = 1e-4  # of albedo and F0


@dataclass(frozen=True)
class MaterialKind:
    """Log-normal prior of a material class."""

    albedo: Gaussian
    """Of log mean luminance of diffuse albedo."""
    specular: Gaussian
    """Of log mean F0."""

    def log_likelihood(self, ratio: float) -> float:
        """Log density of the natural logarithm of F0 over albedo, less a constant."""
        deviation = math.hypot(self.albedo.deviation, self.specular.deviation)
        difference = (ratio - self.specular.mean + self.albedo.mean) / deviation
        return -math.log(deviation) - 0.5 * difference**2


# Priors of albedo and F0 of materials; 78 map sets of artists and scanners agree with them.

# A wider F0 prior of dielectrics follows the fitted flash intensity more, and makes black materials
# grey.
DIELECTRIC = MaterialKind(Gaussian(math.log(0.15), 1.0), DIELECTRIC_F0._replace(deviation=0.25))
METAL = MaterialKind(Gaussian(math.log(0.01), 1.5), CONDUCTOR_F0)
_BRIGHTEST = 0.95  # limit of albedo and F0 of the brightest texels
_MOST_OF = 0.999  # quantile that defines the brightest texels
_MOST_OF_METAL = 0.9  # the same of F0 with metal, as F0 of glints is overestimated
_METAL_COLOUR = 0.12  # standard deviation of the log colour of metal around a pure metal's
_CLEAN = 0.1  # standard deviation of the log F0 of metal around the pure metal's of its colour
# Weight of a metal of unknown colour; a pure metal of exactly the colour has weight 1.
_UNKNOWN = 0.3
LEAST_PART = 0.03  # least share of the exemplar for a part, a class, to count


def how_metallic(parameters: Tensor) -> float:
    """Log odds of metal against dielectric, from the ratio of F0 to albedo alone.

    Args:
        parameters: (5,) mean parameters (SurfaceParameters.vector), under any flash intensity.
    """
    luminance = float((torch.from_numpy(_LUMINANCE) * parameters[ALBEDO].exp()).sum())
    ratio = float(parameters[F0]) - math.log(max(luminance, _LEAST))
    return METAL.log_likelihood(ratio) - DIELECTRIC.log_likelihood(ratio)


def most_probable_scale(exemplar: Exemplar, metal: NDArray[np.float32]) -> float:
    """Most probable factor on albedo and F0 (the flash intensity is divided by it).

    Args:
        exemplar: fitted maps.
        metal: (h, w) share of metal in each texel, on any grid.
    """
    brightest = _MOST_OF_METAL if metal.any() else _MOST_OF
    most = max(_most(exemplar.diffuse, _MOST_OF), _most(exemplar.specular, brightest))
    return min(math.exp(_factor_of_parts(exemplar, metal)), max(_BRIGHTEST / most, 1.0))


def _factor_of_parts(exemplar: Exemplar, metal: NDArray[np.float32]) -> float:
    """Log of the factor that maximises the joint probability of metal and dielectric parts."""
    across, down = exemplar.size
    share = cv2.resize(metal, (across, down), interpolation=cv2.INTER_LINEAR)
    # Weights are zero for texels that are half metal, at the borders of parts.
    bare, rest = np.maximum(2.0 * share - 1.0, 0.0), np.maximum(1.0 - 2.0 * share, 0.0)
    parts = ((rest, DIELECTRIC), (bare, _metal_kind(exemplar, bare)))
    total = weights = 0.0
    for part, kind in parts:
        size = float(part.mean())
        if size < LEAST_PART:
            continue
        for measured, (mean, deviation) in zip(
            _logs(exemplar, part), (kind.albedo, kind.specular), strict=True
        ):
            total += size * (mean - measured) / deviation**2
            weights += size / deviation**2
    return total / weights


def _metal_kind(exemplar: Exemplar, share: NDArray[np.float32]) -> MaterialKind:
    """Prior of metal: F0 of pure metals, weighted by likeness of colour, and that of any metal."""
    planes = np.broadcast_to(exemplar.specular, (3, *share.shape))
    colour = np.log((planes * share).sum((1, 2)) / max(float(share.sum()), 1e-6) + _LEAST)
    candidates = [(*METAL.specular, _UNKNOWN)]
    for f0 in METAL_F0.values():
        log = np.log(np.array(f0))
        difference = (colour - colour.mean()) - (log - log.mean())
        likely = math.exp(-0.5 * float(np.square(difference / _METAL_COLOUR).sum()))
        candidates.append((math.log(sum(f0) / 3.0), _CLEAN, likely))
    total = sum(weight for _, _, weight in candidates)
    mean = sum(log_f0 * weight for log_f0, _, weight in candidates) / total
    variance = sum(w * (d**2 + (log_f0 - mean) ** 2) for log_f0, d, w in candidates) / total
    return MaterialKind(METAL.albedo, Gaussian(mean, math.sqrt(variance)))


def _logs(exemplar: Exemplar, part: NDArray[np.float32]) -> tuple[float, float]:
    """Logarithms of mean albedo luminance and mean F0, weighted by `part` (H, W)."""
    weight = part / max(float(part.sum()), 1e-6)
    albedo = float((np.tensordot(_LUMINANCE, exemplar.diffuse, 1) * weight).sum())
    specular = float((exemplar.specular.mean(0) * weight).sum())
    return math.log(max(albedo, _LEAST)), math.log(max(specular, _LEAST))


def scaled(exemplar: Exemplar, factor: float) -> Exemplar:
    """Multiply an exemplar's albedo and F0 by a factor; the flash is to be divided by it."""
    return replace(
        exemplar,
        diffuse=(exemplar.diffuse * np.float32(factor)).clip(0.0, 1.0),
        specular=(exemplar.specular * np.float32(factor)).clip(0.0, 1.0),
    )


def _most(plane: NDArray[np.float32], quantile: float) -> float:
    return max(float(np.quantile(plane, quantile)), _LEAST)
