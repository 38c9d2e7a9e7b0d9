"""Mean albedo, F0 and roughness of classes by the highlight's profile, and the exposure prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import (
    ALBEDO,
    F0,
    METAL_F0,
    LobeGradient,
    Reflectance,
    SurfaceParameters,
)
from matcap.brdf.maps import normals_from_height
from matcap.capture.rectified import Observation
from matcap.example.exemplar import Exemplar
from matcap.files.color import LUMINANCE
from matcap.files.threads import one_thread
from matcap.flash.coarse.cells import CRUSHED
from matcap.flash.coarse.problem import CONDUCTOR_F0, DIELECTRIC_F0, Gaussian
from matcap.flash.least_squares import Doubles, huber, minimised
from matcap.flash.light import DARKEST, FlashLight

# Exposure prior: the most probable flash intensity, which one photograph does not determine.
#
# Twice the albedo and F0 under half the flash give the same picture. The scale is found from a
# prior of materials: dielectrics have F0 near 0.04 (index of refraction 1.5) whatever their albedo,
# which spans two orders of magnitude; metals have a high F0 and no diffuse albedo. So the ratio of
# F0 to albedo, which a highlight measures, determines both: black leather with F0 three times its
# albedo is black. Where texels are classified as metal or dielectric (predict.py), each
# part has the prior of its own class, and metal that of its colour: gold is brighter than steel.
# See docs/notes/capture.md.

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


# Albedo, F0 and roughness of material classes, from the profile of the highlight.
#
# For rings i of texels around the mirror point (where a mirror would show the flash), the logarithm
# of the mean radiance of each class k is compared with the photograph's:
#
# log mean_i(w_k L) = log mean_i(w_k sum_k w_k L(theta_k)) + noise
#
# where w_k are the class shares of a texel, by robust least squares over the mean parameters
# theta_k = (log albedo 3, log F0, logit roughness), with a Gaussian prior. L includes the relief:
# the width of a highlight is due to roughness and slopes. Ring means depend on the strength of
# relief but not on its registration, and weigh the few texels at the mirror point like the many
# beyond. The radiance of a partly clipped ring is a lower bound; taken as equality it would bias
# roughness.

_INNERMOST = 0.02  # r0, plane units; the ring of radius r is _PER_OCTAVE log2(1 + r / r0)
_PER_OCTAVE = 4.0  # rings per octave of radius
_RING_TEXELS = 50.0  # n0 of the weight n / (n + n0) of a ring with n texels of a class
BOUND = 0.05  # clipped share of a ring above which its mean is only a lower bound
# Standard deviation of a ring's log radiance, and threshold of its Huber loss.
_NOISE, _HUBER = 0.1, 0.3
ROUGHNESS_DEVIATION = 0.3  # prior standard deviation of logit roughness
_MOST_STEP = 0.4  # largest change of a parameter in a step
_STEPS = 16  # most Levenberg-Marquardt steps


@dataclass(frozen=True)
class MeanParameterPrior:
    """Gaussian prior of the mean parameters."""

    mean: Tensor
    deviation: Tensor
    """(K, 5) mean and standard deviation."""
    contrast: Gaussian = Gaussian(0.0, math.inf)
    """Of log F0 of the first class less that of the last."""


@dataclass(frozen=True)
class RingTarget:
    """A photograph with its geometry, light and relief."""

    linear: Tensor
    """(3, H, W) radiance on the plane's grid."""
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
    limit: float = 1.0
    """Radiance at which the photograph clips; resampling may exceed it."""
    toe: float = 0.0
    """Share of a ring's brightest channel that is added before logarithms."""

    @staticmethod
    def of(
        observed: Observation, residuals: SurfaceParameters, metal: tuple[bool, ...]
    ) -> RingTarget:
        """The photograph around its mirror point, with a surface.

        Args:
            residuals: log parameters of the surface less those of the coarse fit.
            metal: whether each of its classes is metal.
        """
        return RingTarget(
            linear=observed.plane.linear,
            measured=observed.shown,
            counts=observed.within,
            distance=observed.from_mirror_point,
            flash=observed.light.flash,
            normal=normals_from_height(residuals.height, 1.0),
            surface=observed.light.uniform + residuals,
            tints=tuple(observed.light.tint if each else 1.0 for each in metal),
            limit=observed.plane.encoding.limit,
            # As in the coarse fit: a developed channel near 0 may be clipped by the colour space.
            toe=CRUSHED if observed.plane.noise is None else 0.0,
        )

    def thinned(self, texels: int) -> RingTarget:
        """Subsample so that at least `texels` remain along the short side."""
        size = self.distance.shape
        every = slice(None, None, max(1, min(size) // texels))

        def thin(plane: Tensor) -> Tensor:
            return plane[..., every, every] if plane.shape[-2:] == size else plane

        names = ("linear", "measured", "counts", "distance", "normal")
        planes: dict[str, Any] = {name: thin(getattr(self, name)) for name in names}
        parts = (getattr(self.surface, each.name) for each in fields(SurfaceParameters))
        return replace(
            self,
            **planes,
            flash=self.flash.cut(every, every),
            surface=SurfaceParameters(*(thin(part) for part in parts)),
            tints=tuple(thin(tint) if isinstance(tint, Tensor) else tint for tint in self.tints),
        )

    def shifted(self, shifts: Sequence[tuple[float, float]]) -> RingTarget:
        """The target once per shift of its maps, (down, right) in shares of the picture.

        Ring means of one sample depend on where its relief lies; those of several less so.
        """
        height, width = self.distance.shape
        steps = [(round(down * height), round(right * width)) for down, right in shifts]

        def repeated(plane: Tensor) -> Tensor:
            whole = plane.shape[-2:] == (height, width)
            return torch.cat([plane] * len(steps), -2) if whole else plane

        def moved(plane: Tensor | float) -> Tensor | float:
            if isinstance(plane, float) or plane.shape[-2:] != (height, width):
                return plane
            return torch.cat([plane.roll(step, (-2, -1)) for step in steps], -2)

        names = ("linear", "measured", "counts", "distance")
        planes: dict[str, Any] = {name: repeated(getattr(self, name)) for name in names}
        light = self.flash
        parts: Any = (moved(getattr(self.surface, each.name)) for each in fields(SurfaceParameters))
        normal: Any = moved(self.normal)
        return replace(
            self,
            **planes,
            flash=FlashLight(*(repeated(a) for a in (light.to_light, light.to_view, light.power))),
            normal=normal,
            surface=SurfaceParameters(*parts),
            tints=tuple(moved(tint) for tint in self.tints),
        )

    def surfaces(self, theta: Tensor) -> list[Reflectance]:
        """Reflectance (3 or 1, H, W) of each class, by mean parameters (K, 5)."""
        one = torch.ones_like(self.distance)[None]
        surfaces = []
        for of_class, tint in zip(theta, self.tints, strict=True):
            surface = self.surface + SurfaceParameters.from_vector(of_class)
            f0, roughness = surface.specular.exp() * tint, torch.sigmoid(surface.roughness)
            surfaces.append(Reflectance(surface.diffuse.exp() * one, f0 * one, roughness * one))
        return surfaces


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
    target: RingTarget, shares: Tensor, start: Tensor, prior: MeanParameterPrior
) -> tuple[Tensor, float]:
    """(K, 5) mean parameters fitted to the ring means, and their mean absolute log residual.

    Args:
        shares: (K, H, W) share of each class in each texel; they sum to 1.
        start: (K, 5) initial values.
        prior: of the result.
    """
    fit = _RingFit(target, shares, prior)
    problem = fit.cost, fit.quadratic, start.flatten().numpy(), _STEPS
    theta = torch.from_numpy(minimised(*problem, farthest=_MOST_STEP, tolerance=1e-7)[1])
    residual = fit.residuals(theta)
    weight = fit.weights(residual)
    return theta.reshape(start.shape), float((residual.abs() * weight).sum() / weight.sum())


class _RingFit:
    """Robust cost of the ring means of N rings, classes and channels, in 5 K mean parameters."""

    def __init__(self, target: RingTarget, shares: Tensor, prior: MeanParameterPrior) -> None:
        self._target, self._shares, self._prior = target, shares, prior
        self._rings = _Rings(target, shares)
        self._incidence = target.flash.onto(target.normal)
        means = self._rings.means(target.linear.clamp_max(target.limit))
        self._toe = DARKEST + target.toe * means.amax(1, keepdim=True)
        self._observed = (means + self._toe).log().flatten()
        self._counts = self._rings.counts.flatten() / _NOISE**2
        clipped = self._rings.means((~target.measured).float()).flatten()
        self._open = (1.0 - clipped / BOUND).clamp(0.0, 1.0)
        self._contrast = torch.zeros_like(prior.mean)
        self._contrast[0, F0], self._contrast[-1, F0] = 1.0, -1.0

    def residuals(self, theta: Tensor) -> Tensor:
        """(N,) residuals of log radiance, photographed less rendered ring means."""
        radiance = torch.zeros(1)
        surfaces = self._target.surfaces(theta.unflatten(0, (-1, 5)))
        for share, surface in zip(self._shares, surfaces, strict=True):
            radiance = radiance + share * self._incidence.radiance(*surface)
        return self._observed - (self._rings.means(radiance) + self._toe).log().flatten()

    def weights(self, residual: Tensor) -> Tensor:
        """(N,) weights of residuals; that of a clipped ring's is small if the model is brighter."""
        return self._counts * torch.where(residual < 0.0, self._open, 1.0)

    def cost(self, parameters: Doubles) -> float:
        """Huber loss of the residuals plus that of the prior, of parameters (5 K,)."""
        theta = torch.from_numpy(parameters)
        residual = self.residuals(theta)
        likelihood = self.weights(residual).numpy() @ huber(residual.numpy(), _HUBER)[0]
        off, excess = self._prior_residuals(theta)
        return float(likelihood + 0.5 * (off.square().sum() + excess.square()))

    def quadratic(self, parameters: Doubles) -> tuple[Doubles, Doubles]:
        """(5 K, 5 K) Gauss-Newton Hessian of the cost, and (5 K,) its gradient."""
        theta = torch.from_numpy(parameters)
        residual, columns = self._linear(theta)
        robust = torch.from_numpy(huber(residual.numpy(), _HUBER)[1])
        weighted = columns * (self.weights(residual) * robust)
        deviation, contrast = self._prior.deviation.flatten(), self._contrast.flatten()
        off, excess = self._prior_residuals(theta)
        steep = contrast / self._prior.contrast.deviation
        hessian = weighted @ columns.T + torch.diag(deviation**-2) + steep[:, None] * steep
        gradient = off / deviation + excess * steep - weighted @ residual
        return hessian.numpy(), gradient.numpy()

    def _prior_residuals(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Deviations of mean parameters (5 K,) and of the contrast of F0 from the prior's."""
        mean, deviation = self._prior.contrast
        off = (theta - self._prior.mean.flatten()) / self._prior.deviation.flatten()
        return off, (self._contrast.flatten() @ theta - mean) / deviation

    def _linear(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """(N,) residuals, and (5 K, N) d log mean / d mean parameter."""
        # (K, C, rings) of each class: diffuse, and derivatives of specular by both parameters.
        means, incidence, whole = self._rings.means, self._incidence, torch.zeros(1)
        parts = []
        surfaces = self._target.surfaces(theta.unflatten(0, (-1, 5)))
        for share, surface in zip(self._shares, surfaces, strict=True):
            matte = incidence.diffuse(surface.diffuse)
            mirrored = incidence.specular(surface.specular, surface.roughness)
            grey = surface.specular.mean(0, keepdim=True)
            lobe = LobeGradient.of(grey, surface.roughness, incidence.angles)
            by_gloss = mirrored * lobe.log_specular, mirrored * lobe.logit_roughness
            parts.append([share * each for each in (matte, *by_gloss)])
            whole = whole + share * (matte + mirrored)
        mean = means(whole) + self._toe
        columns = []
        for matte, *gloss in parts:
            albedo = means(matte) / mean
            columns += [albedo * unit[:, None] for unit in torch.eye(3)]
            columns += [means(one) / mean for one in gloss]
        return self._observed - mean.log().flatten(), torch.stack(columns).flatten(1)
