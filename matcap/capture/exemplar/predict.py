"""Stage network: the network's prediction of the maps, with errors, confidence and classes.

In comes an observation (rectified.py), out go residuals of log parameters from the coarse fit
(network/network.py), their expected errors e, and the confidence

    visibility * blur(exp(-e / unit)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO, F0, REFLECTANCE, SurfaceParameters
from matcap.brdf.maps import CHANNELS, MapSet
from matcap.capture.exemplar.mean_parameters import (
    DIELECTRIC,
    LEAST_PART,
    METAL,
    ROUGHNESS_DEVIATION,
    MeanParameterPrior,
    RingTarget,
    fit_mean_parameters,
    how_metallic,
)
from matcap.capture.exemplar.network.network import ExpectedErrors, Inverse, NetworkAnswer
from matcap.capture.exemplar.octaves import WIDE, smoothed
from matcap.capture.rectified import Observation, channel_weights, seen_share
from matcap.example.exemplar import Exemplar
from matcap.files.threads import computing, workers
from matcap.flash.coarse.problem import Gaussian
from matcap.flash.light import DARKEST

# Expected errors (log, log, logit, slope) at which confidence is 1/e. Larger values trust
# uncertain maps.
_DOUBTED = (0.3, 0.6, 0.6, 0.15)
_NOISY = 0.3  # noise of log radiance at which confidence is 1/e: the lowest codes of a JPEG
_DIFFUSE = 0.5  # diffuse share of light from which on albedo counts in full


@dataclass(frozen=True)
class NetworkPrediction:
    """Maps between stages, as log-parameter residuals from the coarse fit."""

    residuals: SurfaceParameters
    """Residuals of the maps from the coarse fit."""
    errors: ExpectedErrors
    """The network's expected errors."""
    confidence: NDArray[np.float32]
    """(4, H, W) confidence of diffuse, specular, roughness and height, in [0, 1]."""
    logit: Tensor | None
    """(1, H, W) predicted logit of metal; None if it predicts hardly any."""
    classes: Classes
    """Material classes of the texels; one class before `classified`."""

    @property
    def metal(self) -> NDArray[np.float32]:
        """(H, W) share of metal in each texel."""
        return np.asarray(self.classes.metal_share[0].numpy(), np.float32)


def predict_maps(observed: Observation, network: Inverse) -> tuple[Observation, NetworkPrediction]:
    """Predict the maps; the observation's light gets the specular tint of metal."""
    answer = NetworkAnswer.from_stacked(_predicted(network, observed.inputs.stacked()))
    seen = seen_share(observed.plane.measured)
    confidence = confidence_of(answer.errors, seen, observed.plane.unit)
    confidence[0] = (confidence[0] * (1.0 - observed.specular_fraction)) ** albedo_weight(observed)
    confidence *= np.exp(-np.square(grey_noise(observed) / _NOISY))
    classes = Classes.whole(observed.specular_fraction.shape, metal=observed.coarse.conductor)
    if observed.coarse.conductor:
        observed = tinted(observed, classes.metal_share)
    some = float((answer.metal > 0.0).float().mean()) > _LEAST_SHARE
    logit = answer.metal if some and not observed.coarse.by_hand else None
    return observed, NetworkPrediction(answer.residuals, answer.errors, confidence, logit, classes)


def albedo_weight(observed: Observation) -> float:
    """Exponent of the confidence in albedo, in [0, 1]: min(1, D / _DIFFUSE).

    D is the diffuse share of the light that the uniform material reflects: an error of log albedo
    changes log radiance by D times as much. Of black lacquer or leather the highlight hides an
    albedo that hardly shows anywhere, and shows the relief.
    """
    light = observed.plane.linear.mean(0).numpy() * observed.plane.kept.numpy()
    specular = float((observed.specular_fraction * light).sum() / max(float(light.sum()), 1e-12))
    return min(1.0, (1.0 - specular) / _DIFFUSE)


def grey_noise(observed: Observation) -> NDArray[np.float32]:
    """(H, W) standard deviation of log radiance, its channels weighted by their noise."""
    weights = channel_weights(observed.noise)
    return np.asarray((weights * observed.noise).square().sum(0).sqrt().numpy(), np.float32)


def exemplar_of(observed: Observation, prediction: NetworkPrediction) -> Exemplar:
    """The maps and their confidence."""
    maps = observed.light.maps(prediction.residuals, observed.plane.texel_size)
    return with_confidence(maps, prediction.confidence)


def with_confidence(maps: MapSet, confidence: NDArray[np.float32]) -> Exemplar:
    """The exemplar of maps and a confidence (4, H, W)."""
    return Exemplar(
        maps.diffuse.numpy(),
        maps.specular.numpy(),
        maps.roughness.numpy(),
        maps.height.numpy(),
        confidence,
        maps.texel_size,
    )


def map_set_of(exemplar: Exemplar) -> MapSet:
    """An exemplar's maps as a map set, which shares their memory."""
    maps: Any = {name: torch.from_numpy(getattr(exemplar, name)) for name in CHANNELS}
    return MapSet(**maps, texel_size=exemplar.texel_size)


def confidence_of(
    errors: ExpectedErrors, seen: NDArray[np.float32], unit: float
) -> NDArray[np.float32]:
    """(4, H, W) confidence in [0, 1]: visibility times a blur of exp(-error / unit).

    The blur keeps where the light shows a map, and removes which features are predicted easily.

    Args:
        errors: expected errors by map; units are _DOUBTED.
        seen: (H, W) visibility, in [0, 1].
        unit: texels along the photograph's long side.
    """
    error = errors.stacked().clamp(-8.0, 4.0).exp().numpy()
    error = error / np.array(_DOUBTED, np.float32)[:, None, None]
    certain = np.stack([np.exp(-smoothed(plane, unit / WIDE)) for plane in error])
    return np.ascontiguousarray(certain * seen, dtype=np.float32)


def _predicted(network: Inverse, inputs: Tensor) -> Tensor:
    """(ANSWERS, H, W) prediction for inputs (C, H, W) of any size."""
    height, width = inputs.shape[-2:]
    multiple = network.config.multiple
    mode = "reflect" if multiple <= min(height, width) else "replicate"
    whole = F.pad(inputs[None], (0, -width % multiple, 0, -height % multiple), mode=mode)
    del inputs  # half a hundred megabytes, and the largest need of a capture is next
    with computing(workers()):
        answer: Tensor = network(whole.contiguous(memory_format=torch.channels_last))
    return answer[0, :, :height, :width]


# Specular tint of metal: F0 over the mean of its channels.
#
# Dielectrics have an achromatic F0. Metals have no diffuse albedo, so under a white flash their
# radiance has the colour of F0: with the share m of metal in a texel and the colour of radiance,
# normalised to a channel mean of 1, the specular tint of the texel is 1 + m (colour - 1).

_LEAST_SHARE = 0.005  # least share of metal in an exemplar
_COLOUR_SIDE = 5  # texels, side of the neighbourhood whose colour is averaged, against noise
# Radiance (1 at clipping) at which the local colour weighs as much as the mean: darker texels
# mirror little, and show dirt and noise.
_DARK = 0.05


def seen_colour(linear: Tensor, weight: Tensor) -> Tensor:
    """(..., 3, H, W) local mean colour of radiance, normalised to a channel mean of 1.

    Args:
        linear: (..., 3, H, W) radiance.
        weight: (..., 1, H, W) weight of a texel, 0 if clipped. Without weight nearby, the result is
            the mean colour of the whole; without any, grey.
    """
    counted = linear.clamp_min(0.0) * weight.to(linear)
    around = _mean(counted) + _DARK * whole_colour(linear, weight)
    return around / around.mean(-3, keepdim=True)


def whole_colour(linear: Tensor, weight: Tensor) -> Tensor:
    """(..., 3, 1, 1) mean colour, weighted by brightness; arguments as of seen_colour."""
    counted = linear.clamp_min(0.0) * weight.to(linear)
    whole = (counted * counted.mean(-3, keepdim=True)).sum((-2, -1), keepdim=True) + 1e-6
    return whole / whole.mean(-3, keepdim=True)


def specular_tint(metal: Tensor, colour: Tensor) -> Tensor:
    """(..., 3, H, W) specular tint, F0 over its channel mean: 1 without metal.

    Args:
        metal: (..., 1, H, W) share of metal, in [0, 1].
        colour: (..., 3, H, W) colour of the metal (seen_colour).
    """
    return 1.0 + metal * (colour - 1.0)


def tinted(observed: Observation, metal: Tensor) -> Observation:
    """The observation with the specular tint of texels, by their share (1, H, W) of metal."""
    seen = seen_colour(observed.plane.linear, metal * observed.shown.all(0, keepdim=True))
    return replace(observed, light=replace(observed.light, tint=specular_tint(metal, seen)))


def _mean(picture: Tensor) -> Tensor:
    """Local mean with equal weights, so that channels are averaged over the same texels."""
    flat = picture.reshape(-1, *picture.shape[-3:])
    blurred = F.avg_pool2d(flat, _COLOUR_SIDE, stride=1, padding=_COLOUR_SIDE // 2)
    return torch.as_tensor(blurred.reshape(picture.shape))


# Material classes: dielectric, metal, or a mixture of both, each with mean parameters.
#
# F0 is constant in a class, and roughness follows height: under one flash, those of a texel cannot
# be separated from its albedo and slope, and a network predicts noise with rings around the mirror
# point. Texels of a class differ in albedo (of metal: F0) and relief.
#
# The coarse fit decides whether all is metal. Metal and a dielectric in one sample (rust, chipped
# paint) are two classes, fitted by expectation maximisation [dempster1977] from the network's
# prediction: mean parameters to the radial profile around the mirror point (mean_parameters.py),
# and each texel's class shares to its radiance under either.

# Slope of logit roughness on height, true over predicted (docs/notes/gloss.md).
BY_HEIGHT = 2.5
# Logit of metal per standard deviation of metal_score. Larger values follow the network's
# borders more, and the photograph less.
_BY_NETWORK = 2.0
_TEXELS = 128  # short side of the grid of the fit
_ROUNDS = 3  # iterations of fitting mean parameters and classifying texels
# Prior standard deviations of mean log albedo and log F0.
_ALBEDO_DEVIATION, _F0_DEVIATION = 1.5, 2.0
# Scale of a texel's residual chroma of log radiance; of the channels' mean, with relief, it is 1.
_CHROMA_SCALE = 0.2
# Standard deviation of the blur of log odds, in the picture's long side. Larger values round
# borders, smaller ones classify by relief.
_BLUR = 0.002
_COUNTS = 3.0  # factor on the blurred log odds, as the residuals of neighbours are correlated
# Diffuse albedo of metal, and standard deviation of its logarithm.
_METAL_ALBEDO, _METAL_ALBEDO_DEVIATION = 0.004, 0.3
_LEAST_CONTRAST = 1.5  # least log ratio of F0 of metal to that of the dielectric; 2.5 is typical
_LEAST_ODDS = 1.0  # least log odds that the dielectric is none but a dielectric
# Least correlation of the photograph's and the network's classification for two classes.
_LEAST_CORRELATION = 0.4
_MOST_RING_RESIDUAL = 0.2  # largest residual of ring means (log radiance) over the correlation
_LEAST = 1e-6  # of the change of a threshold, at which its iterations end


@dataclass(frozen=True)
class Classes:
    """K material classes and their share of each texel."""

    shares: Tensor
    """(K, H, W) class shares; they sum to 1 over K."""
    metal: tuple[bool, ...]
    """Whether each class is metal."""
    mean_parameters: Tensor
    """(K, 5) log albedo 3, log F0 and logit roughness, less those of the coarse fit."""

    @staticmethod
    def whole(size: tuple[int, ...], *, metal: bool) -> Classes:
        """A single class for all texels (H, W)."""
        return Classes(torch.ones(1, *size), (metal,), torch.zeros(1, 5))

    @property
    def metal_share(self) -> Tensor:
        """(1, H, W) share of metal in each texel."""
        is_metal = torch.tensor(self.metal, dtype=self.shares.dtype)
        return (self.shares * is_metal[:, None, None]).sum(0, keepdim=True)

    def flat(self, parameters: Tensor | None = None) -> SurfaceParameters:
        """Maps of `parameters` mixed by class shares, flat; residuals from the coarse fit."""
        parameters = self.mean_parameters if parameters is None else parameters
        planes = torch.einsum("kc,khw->chw", parameters, self.shares)
        diffuse, specular, roughness = planes.split(list(REFLECTANCE.values()))
        return SurfaceParameters(diffuse, specular, roughness, torch.zeros_like(specular))

    def class_means(self, residuals: SurfaceParameters) -> Tensor:
        """(K, 5) mean reflectance parameters over each class."""
        planes = torch.cat([getattr(residuals, name) for name in REFLECTANCE])
        total = self.shares.sum((1, 2)).clamp_min(1e-6)
        return torch.einsum("chw,khw->kc", planes, self.shares) / total[:, None]

    def constrained(self, residuals: SurfaceParameters, gloss: Tensor) -> SurfaceParameters:
        """Residuals varying only in albedo (dielectric) or F0 (metal), relief, and roughness by it.

        Other parameters become their mean over the class.

        Args:
            residuals: predicted, from the coarse fit.
            gloss: (H, W) weight of the predicted roughness.
        """
        metal = self.metal_share
        of_class = replace(
            residuals,
            diffuse=(1.0 - metal) * residuals.diffuse,
            specular=metal * residuals.specular,
        )
        varying = of_class - self.flat(self.class_means(of_class))
        return replace(varying, roughness=self._following(varying, gloss)) + self.flat()

    def _following(self, varying: SurfaceParameters, gloss: Tensor) -> Tensor:
        """(1, H, W) logit roughness that follows height: pits are rougher than worn ridges.

        Of each class, BY_HEIGHT k h, with the weighted least-squares slope k of the predicted
        roughness on height h, both high-passed. All texels measure the slope.
        """
        local = _high_passed(torch.cat([varying.height, varying.roughness]))
        height, rough = torch.from_numpy(local)
        total = torch.zeros_like(rough)
        for share in self.shares:
            weighted = share * gloss * height
            slope = (weighted * rough).sum() / (weighted * height).sum().clamp_min(1e-12)
            total += BY_HEIGHT * slope * share * height
        return total[None]


def find_mixture(residuals: SurfaceParameters, logit: Tensor, target: RingTarget) -> Classes | None:
    """Metal and dielectric in one photograph, metal first, by expectation maximisation.

    None unless shares, contrast of F0, residual of ring means and agreement with the network
    indicate both.

    Args:
        residuals: predicted, from the coarse fit.
        logit: (1, H, W) predicted logit of metal.
        target: the photograph, with the uniform material as its surface.
    """
    by_network = _BY_NETWORK * metal_score(residuals, logit)
    step = max(1, min(logit.shape[-2:]) // _TEXELS)
    coarse, coarse_by_network = target.thinned(_TEXELS), by_network[:, ::step, ::step]
    metal = torch.sigmoid(coarse_by_network)
    predicted = _pair(torch.sigmoid(by_network)).class_means(residuals)
    predicted[0, ALBEDO] = math.log(_METAL_ALBEDO) - target.surface.vector()[ALBEDO]
    prior = MeanParameterPrior(
        predicted,
        torch.tensor(
            [
                [*[_METAL_ALBEDO_DEVIATION] * 3, _F0_DEVIATION, ROUGHNESS_DEVIATION],
                [*[_ALBEDO_DEVIATION] * 3, _F0_DEVIATION, ROUGHNESS_DEVIATION],
            ]
        ),
        Gaussian(
            METAL.specular.mean - DIELECTRIC.specular.mean,
            math.hypot(DIELECTRIC.specular.deviation, METAL.specular.deviation),
        ),
    )
    theta, residual = predicted, 0.0
    for number in range(_ROUNDS):
        coarse = _coloured(coarse, metal)
        if number:
            by_radiance = _log_likelihood_ratio(coarse, theta)
            metal = _share(by_radiance, coarse_by_network, float(metal.mean()))
            coarse = _coloured(coarse, metal)
        theta, residual = fit_mean_parameters(coarse, _pair(metal).shares, theta, prior)
    by_radiance = _log_likelihood_ratio(replace(target, tints=coarse.tints), theta)
    metal = _share(by_radiance, by_network, float(metal.mean()))
    both = torch.stack([by_radiance.flatten(), by_network.flatten()])
    correlation = float(torch.corrcoef(both)[0, 1].nan_to_num())
    bare, rest = theta
    share = float(metal.mean())
    likely = (
        min(share, 1.0 - share) > LEAST_PART
        and float(bare[F0] - rest[F0]) > _LEAST_CONTRAST
        and how_metallic(target.surface.vector() + rest) < -_LEAST_ODDS
        and residual < _MOST_RING_RESIDUAL * correlation
        and correlation > _LEAST_CORRELATION
    )
    return replace(_pair(metal), mean_parameters=theta) if likely else None


def _two_means(score: Tensor) -> float:
    """The threshold halfway between the means of the values above and below it (2-means)."""
    last, threshold = math.inf, float(score.mean())
    while abs(threshold - last) > _LEAST:
        above = score > threshold
        if above.any() == above.all():
            break
        last, threshold = threshold, 0.5 * float(score[above].mean() + score[~above].mean())
    return threshold


def _pair(metal: Tensor) -> Classes:
    """Two classes, metal with the given share (1, H, W) of each texel first."""
    return Classes(torch.cat([metal, 1.0 - metal]), (True, False), torch.zeros(2, 5))


def _coloured(target: RingTarget, metal: Tensor) -> RingTarget:
    """The target with the specular tint of metal set to the mean colour of its texels (1, H, W)."""
    seen = metal * target.measured.all(0, keepdim=True) * target.counts
    return replace(target, tints=(whole_colour(target.linear, seen), 1.0))


def metal_score(residuals: SurfaceParameters, logit: Tensor) -> Tensor:
    """(1, H, W) score of metal in the predicted maps, of standard deviation 1, positive if likely.

    Sum of high-passed maps, weighted by their signed squared correlation with the high-passed logit
    of metal (1, H, W). Low frequencies of the logit are biased: to metal near a highlight.
    """
    albedo = residuals.diffuse
    lightness = albedo.mean(0, keepdim=True)
    colour = (albedo - lightness)[::2]
    maps = [logit, lightness, colour, residuals.roughness, residuals.specular]
    local = _high_passed(torch.cat(maps))
    local /= local.std((1, 2), keepdims=True) + np.float32(1e-6)
    together = (local * local[0]).mean((1, 2))
    score = np.tensordot(together * np.abs(together), local, 1)
    scaled = torch.from_numpy((score / (score.std() + np.float32(1e-6))).astype(np.float32))[None]
    return scaled - _two_means(scaled)


def _high_passed(planes: Tensor) -> NDArray[np.float32]:
    """Planes (C, H, W) less their low frequencies."""
    around = max(planes.shape) / WIDE
    return np.stack([plane - smoothed(plane, around) for plane in planes.numpy()])


def _log_likelihood_ratio(target: RingTarget, theta: Tensor) -> Tensor:
    """(1, H, W) log odds of metal by the likelihood of the radiance alone.

    Args:
        theta: (2, 5) mean parameters of the classes.
    """
    observed = target.linear.clamp_min(DARKEST).log()
    costs = []
    incidence = target.flash.onto(target.normal)
    for surface in target.surfaces(theta):
        residual = observed - incidence.log_radiance(surface)[0]
        residual = torch.where(target.measured, residual, residual.clamp_min(0.0))
        grey = residual.mean(0, keepdim=True)
        colour = (residual - grey).square().sum(0, keepdim=True)
        # Cauchy distribution: misplaced relief gives occasional large residuals.
        costs.append(torch.log1p(grey.square()) + torch.log1p(colour / _CHROMA_SCALE**2))
    bare, rest = costs
    # Blurred: classes form patches, and slopes towards and away from the light cancel.
    around = _BLUR * target.linear.shape[-1]
    plane = cv2.GaussianBlur((rest - bare)[0].numpy(), (0, 0), around)
    return torch.from_numpy(_COUNTS * plane)[None]


def _share(by_radiance: Tensor, by_network: Tensor, before: float) -> Tensor:
    """(1, H, W) posterior probability of metal in each texel.

    Args:
        by_radiance, by_network: (1, H, W) log odds.
        before: prior share of metal.
    """
    common = min(max(before, LEAST_PART), 1.0 - LEAST_PART)
    return torch.sigmoid(math.log(common / (1.0 - common)) + by_radiance + by_network)
