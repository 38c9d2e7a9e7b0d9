"""Stage refine: maps are changed until they re-render to the photograph.

In come predicted maps with their classes, out go refined ones (refine_maps):

1. flatten: the low frequencies of albedo, which a stationary sample does not have, are removed;
2. narrowed: relief is scaled down until the highlight is no wider than photographed;
3. scaled_by_glints: each octave of relief is scaled to the photographed contrast of glints, and
   fine waves raised by what central differences lose (with_slopes_of_means);
4. with_mean_parameters: after 2 and 3, each class's mean parameters are fitted to the highlight
   (mean_parameters.py);
5. refine_albedo: residual log radiance, less white glints of coloured materials (glints.py), is
   assigned to the albedo of every texel, of metal to F0;
6. evened_albedo, flatten, with_photographed_mean: albedo has no more contrast in dim light, and of
   black gloss in the highlight; then as 1, and the mean radiance is the photograph's;
7. refitted_to_highlight, after inpainting, where light above white is measured: F0 and roughness
   once more, with the finished relief.

Glints (3): where the specular fraction s of radiance is high, contrast is due to slopes, as albedo
is diluted, and F0 and roughness are constant. So the photographed energy E_b of log radiance in
octave b, noise subtracted, gives the factor g_b on relief:

    E_b(region) = mean (1 - s)^2 A_b + g_b^2 R_b(region),  of the glossiest and the mattest region,

with the unknown energy A_b of log albedo, and the energy R_b of the re-rendering with constant
albedo. The matte region yields A_b: under a glaze over a pattern, or on polished limestone, part of
the contrast is albedo. Texture differs from place to place, so g_b^2 is the most probable factor
given this and the relief spectrum (posterior_factors): the middle of a worn board is scratched.

Albedo (5): Gauss-Newton steps, by a Wiener filter. Of a residual r of log radiance a parameter with
sensitivity a = d log L / d parameter and prior variance p, the network's expected error, gets

    a p r / (a^2 p + noise variance).

Relief is not changed: misplaced relief would be cancelled instead of moved (docs/notes/capture.md).
A clipped channel is a lower bound. Low-frequency residuals are errors of coarse fit and tone curve,
and are left out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import (
    ALBEDO,
    F0,
    F0_LIMITS,
    ROUGH,
    ROUGHNESS_LIMITS,
    SurfaceParameters,
)
from matcap.brdf.heights import with_slopes_of_means
from matcap.capture.exemplar.glints import without_glints
from matcap.capture.exemplar.mean_parameters import (
    ROUGHNESS_DEVIATION,
    MeanParameterPrior,
    RingTarget,
    fit_mean_parameters,
)
from matcap.capture.exemplar.network.network import ExpectedErrors
from matcap.capture.exemplar.octaves import WIDE, filled, smoothed, split
from matcap.capture.exemplar.predict import NetworkPrediction, albedo_weight, map_set_of
from matcap.capture.exemplar.relief_spectrum import (
    BandEnergies,
    ReliefSpectrum,
    posterior_factors,
    slope_energies,
)
from matcap.capture.rectified import Observation, PhotographLight, channel_weights
from matcap.example.exemplar import Exemplar
from matcap.files.threads import at_once
from matcap.flash.coarse.problem import CONDUCTOR_F0, DIELECTRIC_F0
from matcap.flash.light import DARKEST, cached_rows, strips

Floats = NDArray[np.float32]

# Refinement; docs/notes/capture.md. NSD is the normalised style distance.
# Gauss-Newton steps. The power of granite's finest octave is 0.66, 0.74 and 0.74 of the
# photograph's after 3, 4 and 6.
_STEPS = 5
# Log radiance, lower limit of the noise. Smaller values copy sensor noise into the maps.
_LEAST_NOISE = 0.01
# Largest change of log radiance in a step. Gaps between threads are predicted too bright by more
# than 0.5.
_MOST_CHANGE = 1.5
# Standard deviation of the highlight's log radiance at a specular fraction of 1, of dielectric
# and metal, whose texture is its F0: a brushed steel has an NSD of 2.5 with 0.5, and of 1.8 with
# 0.15.
_SPECULAR_NOISE, _SPECULAR_NOISE_METAL = 0.5, 0.15
# Ratio of the standard deviations of albedo's chroma and lightness. Larger values take sensor
# noise for colour.
_CHROMA = 0.3
# The long side over the standard deviation of the blur that is subtracted from albedo, as the
# sample is stationary.
_STATIONARY = 8.0
_RINGS, _SECTORS = 64, 16  # rings across the long side, and their parts
_MOST_SHIFT = 2.0  # largest factor on the mean radiance

# Mean parameters.
FIT_TEXELS = 192  # short side of the grid of the fit
# Standard deviation of the mean residual of rings, over that of the log scale of relief.
_RESIDUAL_BY_SCALE = 0.05
# Prior standard deviations of mean parameters (log albedo 3, log F0, logit roughness) around their
# values before relief is known, of dielectric and metal.
_DIELECTRIC_DEVIATIONS = [*[1.0] * 3, DIELECTRIC_F0.deviation, ROUGHNESS_DEVIATION]
_METAL_DEVIATIONS = [*[0.05] * 3, CONDUCTOR_F0.deviation, ROUGHNESS_DEVIATION]

# Glints.
# Specular fraction of the radiance that bounds the glossiest region, where slopes dominate.
MIRRORED = 0.4
LEAST_SHARE = 0.01  # least share of the photograph for that region
# Share of the photograph, with the least specular fraction, in the mattest region.
_MATTE_SHARE = 0.33
_BINS = 8  # of the specular fraction, or of light, of the others
# Share of the matte photograph, with the most light, whose contrast of albedo is not exceeded, and
# specular fraction up to which a texel is matte.
_LIT_SHARE, _MATTE = 0.5, 0.3
_BY_CHANCE = 1.25  # contrast in dim light over that in more, up to 1.2 in simulated photographs
_CELLS = 4  # across the picture, parts whose energies tell how much texture differs by place


def refine_maps(
    observed: Observation,
    prediction: NetworkPrediction,
    spectrum: ReliefSpectrum | None = None,
    *,
    finest: bool = False,
) -> NetworkPrediction:
    """Fit mean parameters of the classes, then albedo of every texel, to the photograph.

    Args:
        spectrum: measured in the photograph, or None.
        finest: central differences on this grid, not on a finer one, show the slopes of relief.
    """
    plane, metal = observed.plane, prediction.classes.metal_share
    fitted, matte = at_once(
        partial(fitted_to_highlight, observed, prediction),
        partial(without_glints, plane, observed.coarse, metal=bool(metal.any())),
    )
    steep = scaled_by_glints(
        fitted.residuals, plane.linear, plane.measured, observed.light, observed.noise, spectrum
    )
    if finest:
        height = torch.from_numpy(with_slopes_of_means(steep.height[0].numpy()))
        steep = replace(steep, height=height[None])
    fitted = with_mean_parameters(observed, replace(fitted, residuals=steep))
    photograph = matte.linear, observed.shown, observed.light
    refined = refine_albedo(
        fitted.residuals, fitted.errors, *photograph, metal=metal, noise=observed.noise
    )
    even = flattened(observed, replace(fitted, residuals=evened_albedo(observed, refined)))
    return replace(even, residuals=with_photographed_mean(even.residuals, *photograph, metal))


def evened_albedo(observed: Observation, residuals: SurfaceParameters) -> SurfaceParameters:
    """Log albedo with no more contrast in dim light, or in the highlight, than where it is seen.

    A sample is stationary (_evening). In dim light JPEG codes, relief seen obliquely and errors of
    the falloff add contrast, to chroma up to 2.5 times, so it is evened separately from lightness.
    Of black gloss, relief is seen in the highlight, and what it does not explain is glints, not
    albedo: a share 1 - albedo_weight of contrast is evened by the specular fraction.
    """
    used, specular = observed.plane.valid.numpy(), observed.specular_fraction
    if not used.any():
        return residuals
    seen = torch.from_numpy((1.0 - specular) * used + 1e-6)
    mean = (residuals.diffuse * seen).sum((1, 2), keepdim=True) / seen.sum()
    deviation = residuals.diffuse - mean
    grey = deviation.mean(0, keepdim=True)
    matte = used & (specular <= max(_MATTE, float(np.median(specular[used]))))
    dimness = -observed.light.flash.power.mean(0).numpy()
    excess = torch.zeros_like(deviation)
    for part in (grey, deviation - grey):
        excess += part * (1.0 - _evening(part, dimness, matte, _LIT_SHARE, _BY_CHANCE))
    glints, deviation = 1.0 - albedo_weight(observed), deviation - excess
    if glints > 0.0:
        excess += glints * (1.0 - _evening(deviation, specular, used, _MATTE_SHARE)) * deviation
    return replace(residuals, diffuse=residuals.diffuse - excess)


def _evening(
    planes: Tensor, key: Floats, used: NDArray[np.bool_], share: float, by_chance: float = 1.0
) -> Tensor:
    """(H, W) factors min(1, c sqrt(V_0 / V)) that even contrast against a key.

    Args:
        planes: (C, H, W) of mean 0; V is their variance in a bin of the key.
        key: (H, W) what contrast must not rise with.
        used: (H, W) texels that are measured.
        share: of them, with the least key; V_0 is the variance there.
        by_chance: c, ratio of contrasts up to which a texture may differ by place.
    """
    squares = planes.square().mean(0).numpy()
    edges = np.quantile(key[used], np.linspace(share, 1.0, _BINS + 1))
    here, at = squares[used], np.searchsorted(edges, key)[used]
    # A stain is no contrast of its bin: squares count up to nine times their median.
    medians = [np.median(here[at == n]) if (at == n).any() else 0.0 for n in range(_BINS + 2)]
    here = np.minimum(here, 9.0 * np.array(medians)[at])
    count, total = (np.bincount(at, each, _BINS + 2) for each in (None, here))
    variance = total / np.maximum(count, 1)
    factor = np.minimum(1.0, by_chance * np.sqrt(variance[0] / np.maximum(variance, 1e-12)))
    middle = np.array([edges[0], *(0.5 * (edges[1:] + edges[:-1]))])
    return torch.from_numpy(np.interp(key, middle, factor[: _BINS + 1]).astype(np.float32))


def fitted_to_highlight(observed: Observation, prediction: NetworkPrediction) -> NetworkPrediction:
    """Even albedo; relief and mean parameters of the classes fitted to the highlight's rings."""
    return with_mean_parameters(observed, narrowed(observed, flattened(observed, prediction)))


def flattened(observed: Observation, prediction: NetworkPrediction) -> NetworkPrediction:
    """Remove low-frequency trends of albedo, except those of the class shares (flatten)."""
    plane, means = observed.plane, prediction.classes.flat()
    distances = (observed.from_mirror_point, observed.from_vignetting_centre)
    texels = [(distance / plane.texel_size).numpy() for distance in distances]
    even = flatten(prediction.residuals - means, prediction.confidence[0], texels, plane.unit)
    return replace(prediction, residuals=even + means)


def narrowed(observed: Observation, prediction: NetworkPrediction) -> NetworkPrediction:
    """Scale relief down until it does not make the highlight wider than photographed.

    Roughness makes up for relief that is too flat; nothing narrows the highlight of relief that is
    too steep. The scale s <= 1 is the most probable one of half octaves:

        minimise  r(s)^2 + (_RESIDUAL_BY_SCALE log s)^2,

    with r the mean absolute log residual of rings, their mean parameters fitted to relief s h.
    """

    def scaled(scale: float) -> NetworkPrediction:
        residuals = prediction.residuals
        return replace(prediction, residuals=replace(residuals, height=residuals.height * scale))

    def cost(scale: float) -> float:
        _, residual = _fitted_mean_parameters(observed, scaled(scale), FIT_TEXELS // 2)
        return math.hypot(residual, _RESIDUAL_BY_SCALE * math.log(scale))

    scale, least = 1.0, cost(1.0)
    while (lower := cost(scale * math.sqrt(0.5))) < least:
        scale, least = scale * math.sqrt(0.5), lower
    return scaled(scale)


def with_mean_parameters(observed: Observation, prediction: NetworkPrediction) -> NetworkPrediction:
    """Fit the classes' mean parameters to the highlight's radial profile (mean_parameters.py)."""
    classes = prediction.classes
    moved, _ = _fitted_mean_parameters(observed, prediction, FIT_TEXELS)
    changed = prediction.residuals + classes.flat(moved)
    classes = replace(classes, mean_parameters=classes.mean_parameters + moved)
    return replace(prediction, residuals=changed, classes=classes)


def _fitted_mean_parameters(
    observed: Observation, prediction: NetworkPrediction, texels: int
) -> tuple[Tensor, float]:
    """(K, 5) changes of the classes' mean parameters, and the mean absolute log residual of rings.

    The short side of the grid of the fit has at least `texels`.
    """
    classes = prediction.classes
    target = RingTarget.of(observed, prediction.residuals, classes.metal)
    step = max(1, min(target.distance.shape) // texels)
    shares = classes.shares[:, ::step, ::step]
    deviations = _DIELECTRIC_DEVIATIONS, _METAL_DEVIATIONS
    deviation = torch.tensor([deviations[metal] for metal in classes.metal])
    start = torch.zeros_like(classes.mean_parameters)
    prior = MeanParameterPrior(start, deviation)
    return fit_mean_parameters(target.thinned(texels), shares, start, prior)


@torch.no_grad()
def refitted_to_highlight(exemplar: Exemplar, observed: Observation, metal: Floats) -> Exemplar:
    """F0 and roughness scaled so that the finished relief, of any place, shows the highlight.

    Relief under the highlight, to which they were fitted, is replaced by inpainting, and fields
    show relief of all places: the ring means are those of the maps at four places. A photograph
    that clips at white only bounds its highlight and keeps its gloss: fitted again, it was farther.

    Args:
        exemplar: the inpainted maps.
        metal: (H, W) share of metal in each texel.
    """
    if observed.plane.encoding.limit <= 1.0:
        return exemplar
    maps = map_set_of(exemplar)
    residuals = observed.light.residuals(maps)
    target = replace(
        RingTarget.of(observed, residuals, (bool(metal.any()),)),
        normal=maps.normal,
        tints=(maps.specular / maps.specular.mean(0, keepdim=True),),
    ).thinned(FIT_TEXELS // 2)
    target = target.shifted([(down, right) for down in (0.0, 0.5) for right in (0.0, 0.5)])
    gloss = _METAL_DEVIATIONS if metal.mean() > 0.5 else _DIELECTRIC_DEVIATIONS
    deviation = [*_METAL_DEVIATIONS[:3], *gloss[3:]]
    start, whole = torch.zeros(1, 5), torch.ones_like(target.distance)[None]
    prior = MeanParameterPrior(start, torch.tensor([deviation]))
    (moved,), _ = fit_mean_parameters(target, whole, start, prior)
    roughness = torch.logit(maps.roughness.clamp(*ROUGHNESS_LIMITS)) + moved[ROUGH]
    diffuse = maps.diffuse * moved[ALBEDO].exp()[:, None, None]
    return replace(
        exemplar,
        diffuse=np.asarray(diffuse.numpy().clip(0.0, 1.0), np.float32),
        specular=(exemplar.specular * np.exp(moved[F0].numpy())).clip(*F0_LIMITS),
        roughness=np.asarray(torch.sigmoid(roughness).numpy(), np.float32),
    )


def flatten(
    residuals: SurfaceParameters, confidence: Floats, distances: Sequence[Floats], unit: float
) -> SurfaceParameters:
    """Remove from albedo (of metal: F0) low frequencies, and rings around given points: the
    flash's mirror point, and the vignetting's centre.

    A stationary sample has neither. The mean, weighted by squared confidence, is kept.

    Args:
        residuals: of the exemplar from its classes' mean parameters.
        confidence: (H, W) of albedo, in [0, 1].
        distances: (H, W) each, from these points, texels.
        unit: texels along the photograph's long side.
    """
    weight = torch.from_numpy(confidence).square() + 1e-3

    def even(channels: Tensor) -> Tensor:
        if not bool(channels.any()):
            return channels
        mean = (channels * weight).sum((1, 2), keepdim=True) / weight.sum()
        level = np.stack([c - smoothed(c, unit / _STATIONARY) for c in channels.numpy()])
        for distance in distances:
            level -= _rings(level, distance, confidence)
        return torch.from_numpy(level) + mean

    return replace(residuals, diffuse=even(residuals.diffuse), specular=even(residuals.specular))


def _rings(planes: Floats, distance: Floats, weight: Floats) -> Floats:
    """(C, H, W) means of planes over rings around a point, shrunk by their uncertainty.

    The mean m of a ring becomes m max(1 - e^2 / m^2, 0) (James-Stein), where the standard error e
    is that of the means of its sectors.

    Args:
        planes: (C, H, W) of about zero mean.
        distance: (H, W) distance from the point, texels.
        weight: (H, W) of the texels.
    """
    width = max(distance.shape) / _RINGS
    row, column = divmod(int(distance.argmin()), distance.shape[1])
    rows, columns = (np.arange(n, dtype=np.float32) for n in distance.shape)
    turns = np.arctan2(rows[:, None] - row, columns - column) / (2.0 * np.pi) % 1.0
    sector = np.minimum((turns * _SECTORS).astype(np.int64), _SECTORS - 1)
    ring = (distance / width).astype(np.int64)
    count = int(ring.max()) + 1
    part = (ring * _SECTORS + sector).ravel()

    def sums(values: Floats) -> NDArray[np.float64]:
        flat = np.bincount(part, values.ravel(), count * _SECTORS)
        return flat.reshape(count, _SECTORS).astype(np.float64)

    weights = sums(weight)
    seen = weights > 0.25 * weights.max(axis=1, keepdims=True)
    number = seen.sum(1)
    middles = (np.arange(count) + 0.5) * width
    rings = np.empty_like(planes)
    for plane, means in zip(planes, rings, strict=True):
        parts = sums(weight * plane) / np.maximum(weights, 1e-6)
        mean = (parts * seen).sum(1) / np.maximum(number, 1)
        scatter = (np.square(parts - mean[:, None]) * seen).sum(1)
        error = scatter / np.maximum(number * (number - 1), 1)
        kept = mean * np.clip(1.0 - error / np.maximum(np.square(mean), 1e-12), 0.0, 1.0)
        kept[number < _SECTORS / 4] = 0.0
        means[:] = np.interp(distance, middles, kept)
    return rings


@torch.no_grad()
def refine_albedo(
    residuals: SurfaceParameters,
    errors: ExpectedErrors,
    linear: Tensor,
    valid: Tensor,
    light: PhotographLight,
    *,
    metal: Tensor | float = 0.0,
    noise: Tensor | float = 0.02,
) -> SurfaceParameters:
    """Refine albedo, of metal F0, so that the maps re-render to the photograph.

    Args:
        residuals: of the exemplar from the coarse fit.
        linear: (3, H, W) the photograph on the plane's grid.
        valid: (H, W) or (3, H, W) bool, visible and not clipped.
        metal: (1, H, W) share of metal in each texel.
        noise: standard deviation of the photograph's log radiance; (3, H, W) or one number.
    """
    valid, every = valid.expand_as(linear), slice(None)
    albedo = errors.albedo.exp().square()
    metal = torch.as_tensor(metal).to(linear).expand_as(residuals.height)
    white = torch.as_tensor(noise).to(linear).expand_as(linear).clamp_min(_LEAST_NOISE)
    normal = light.maps(residuals).normal
    diffuse, specular = residuals.diffuse.clone(), residuals.specular.clone()
    residuals = replace(residuals, diffuse=diffuse, specular=specular)
    difference, shares = torch.empty_like(linear), torch.empty_like(linear)

    def compared(rows: slice) -> None:
        here = light.cut(rows, every)
        maps = here.maps(residuals.map(lambda planes: planes[..., rows, :]))
        log, shares[:, rows] = here.flash.onto(normal[:, rows]).log_radiance(maps)
        observed = linear[:, rows].clamp_min(DARKEST).log()
        difference[:, rows] = _log_difference(observed, log, valid[:, rows])

    def stepped(rows: slice, slow: Tensor) -> None:
        change = (difference[:, rows] - slow[:, rows]).clamp(-_MOST_CHANGE, _MOST_CHANGE)
        others = (each[:, rows] for each in (valid, shares, albedo, white, metal))
        common, chroma = _albedo_step(change, *others)
        diffuse[:, rows] += (1.0 - metal[:, rows]) * (common + chroma)
        specular[:, rows] += metal[:, rows] * common

    parts = strips(linear.shape[1], cached_rows(linear.shape[2]))
    for _ in range(_STEPS):
        at_once(*(partial(compared, rows) for rows in parts))
        slow = _slow(difference, valid)
        at_once(*(partial(stepped, rows, slow) for rows in parts))
    return residuals


def _albedo_step(
    difference: Tensor, valid: Tensor, shares: Tensor, albedo: Tensor, white: Tensor, metal: Tensor
) -> tuple[Tensor, Tensor]:
    """Changes (1, H, W) of log albedo, of metal log F0, in all channels; (3, H, W) of its chroma.

    Args:
        difference: (3, H, W) log radiance, photographed less rendered.
        valid: (3, H, W) bool.
        shares: (3, H, W) diffuse share of the radiance.
        albedo: (1, H, W) prior variance.
        white: (3, H, W) standard deviation of the noise.
        metal: (1, H, W) share of metal.
    """
    weights, colour = channel_weights(white), albedo * _CHROMA**2
    informative = valid | (difference > 0.0)
    share = (weights * shares).sum(0, keepdim=True)
    # d log L / d log albedo, and of metal / d log F0.
    sensitivity = (1.0 - metal) * share + metal * (1.0 - share)
    counts = weights * informative
    counts = counts / counts.sum(0, keepdim=True).clamp_min(1e-6)
    grey = (counts * difference).sum(0, keepdim=True)
    specular_noise = _SPECULAR_NOISE + (_SPECULAR_NOISE_METAL - _SPECULAR_NOISE) * metal
    specular_variance = (specular_noise * (1.0 - share)).square()
    # The channels' noise is taken as fully correlated, as development blurs it to blotches.
    variance = (counts * white).sum(0, keepdim=True).square() + specular_variance
    common = sensitivity * albedo * grey / (sensitivity.square() * albedo + variance)
    # A clipped channel that is bright enough gives no information on colour.
    chroma = torch.where(informative, difference - grey, 0.0)
    variance = shares.square() * colour + white.square() + specular_variance
    return common, chroma * shares * colour / variance


@torch.no_grad()
def with_photographed_mean(
    residuals: SurfaceParameters,
    linear: Tensor,
    valid: Tensor,
    light: PhotographLight,
    metal: Tensor | float = 0.0,
) -> SurfaceParameters:
    """Shift log albedo, and F0 of metal, so that the mean radiance is the photograph's.

        shift = log(sum w (L - R) / sum w B),    w = B / (B + R) / U,

    for each channel, with photographed radiance L, rendered radiance B + R whose part B is
    proportional to albedo (of metal: F0), and the radiance U of the uniform material. Contrast that
    refinement adds to log albedo changes the mean radiance: of a black and white weave by 1.5.

    Arguments as of refine_albedo.
    """
    log, diffuse_share = light.rendered(light.maps(residuals))
    even, _ = light.rendered(light.maps(residuals - residuals))
    share = (1.0 - metal) * diffuse_share + metal * (1.0 - diffuse_share)
    radiance = log.exp()
    weight = valid * share / even.exp()
    photographed = (weight * (linear - (1.0 - share) * radiance)).sum((1, 2))
    rendered = (weight * share * radiance).sum((1, 2)).clamp_min(1e-9)
    ratio = (photographed / rendered).clamp(1.0 / _MOST_SHIFT, _MOST_SHIFT)
    shift = ratio.log()[:, None, None]
    return replace(
        residuals,
        diffuse=residuals.diffuse + (1.0 - metal) * shift,
        specular=residuals.specular + metal * shift.mean(),
    )


def radiance_residual(
    residuals: SurfaceParameters, linear: Tensor, valid: Tensor, light: PhotographLight
) -> Tensor:
    """(3, H, W) log radiance of the photograph less the re-rendering's; as of refine_albedo."""
    log, _ = light.rendered(light.maps(residuals))
    return _log_difference(linear.clamp_min(DARKEST).log(), log, valid)


def _log_difference(observed: Tensor, log: Tensor, valid: Tensor) -> Tensor:
    """(3, H, W) photographed less rendered log radiance; of clipped texels only positive ones."""
    difference = observed - log
    return torch.where(valid, difference, difference.clamp_min(0.0))


def _slow(difference: Tensor, valid: Tensor) -> Tensor:
    """Low-frequency part (3, H, W) of a difference, over valid texels."""
    deviation = max(valid.shape) / WIDE
    weights = valid.expand_as(difference).numpy().astype(np.float32) + np.float32(1e-4)

    def slow(plane: Floats, weight: Floats) -> Floats:
        return smoothed(plane * weight, deviation) / smoothed(weight, deviation)

    planes = zip(difference.clamp(-1, 1).numpy(), weights, strict=True)
    return torch.from_numpy(np.stack(at_once(*(partial(slow, *each) for each in planes))))


def scaled_by_glints(
    residuals: SurfaceParameters,
    linear: Tensor,
    measured: Tensor,
    light: PhotographLight,
    noise: Tensor,
    spectrum: ReliefSpectrum | None = None,
) -> SurfaceParameters:
    """Scale each octave of relief by its factor g_b, measured in the glints (module).

    Args:
        residuals, linear: as of refine_albedo.
        measured: (3, H, W) bool: not clipped.
        noise: (3, H, W) standard deviation of log radiance.
    """
    _, diffuse_share = light.rendered(light.maps(residuals))
    around = max(linear.shape) / WIDE
    specular_fraction = 1.0 - smoothed(diffuse_share.mean(0).numpy(), around / 4.0)
    seen = measured.all(0).numpy()
    region = (specular_fraction > MIRRORED) & seen
    if float(region.mean()) < LEAST_SHARE:
        return residuals
    matte = (specular_fraction <= np.quantile(specular_fraction[seen], _MATTE_SHARE)) & seen
    mean = residuals.diffuse.mean((1, 2), keepdim=True)
    maps = light.maps(replace(residuals, diffuse=mean.expand_as(linear)))
    rendered = light.rendered(maps)[0].mean(0).numpy()
    photograph = linear.clamp_min(DARKEST).log().mean(0).numpy()
    variance = (noise.square().mean(0) / 3.0).numpy()
    shown = itertools.product((photograph, rendered), (region, matte))
    tasks = (partial(_squared_bands, plane, where, around) for plane, where in shown)
    *squares, rough, dull_rough = at_once(*tasks)
    diluted = np.square(1.0 - specular_fraction).clip(1e-8)
    share = diluted[region].mean() / diluted[matte].mean()
    raw = squares[0][:, region].mean(1), squares[1][:, matte].mean(1)
    glossy = _denoised(raw[0], float(variance[region].mean()))
    dull = share * _denoised(raw[1], float(variance[matte].mean()))
    whole, flat = rough[:, region].mean(1), dull_rough[:, matte].mean(1)
    # If both regions are equally sensitive to slope, relief and albedo are hardly separable.
    relief = (whole - share * flat).clip(0.5 * whole) + 1e-12
    scatter = _scatter(squares[1], matte) / math.sqrt(max(1.0, _CELLS**2 * float(region.mean())))
    # Noise is subtracted from energies, not from their deviations: what it hides is not zero.
    deviation = scatter * np.hypot(raw[0], share * raw[1])
    glints = BandEnergies(relief, (glossy - dull).clip(0.0), deviation)
    height = residuals.height[0].numpy()
    others = [] if spectrum is None else [BandEnergies.of(slope_energies(height), spectrum)]
    gains = np.sqrt(posterior_factors(glints, *others))
    *bands, rest = split(height)
    steep = sum((float(g) * band for g, band in zip(gains, bands, strict=True)), rest)
    return replace(residuals, height=torch.from_numpy(np.asarray(steep, np.float32))[None])


def _denoised(energy: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """(bands,) energies of log radiance less those of white noise of a variance."""
    # Of white noise, three quarters of the energy are in the finest octave.
    return (energy - 0.75 * variance * 0.25 ** np.arange(len(energy))[::-1]).clip(0.0)


def _squared_bands(plane: Floats, region: NDArray[np.bool_], around: float) -> Floats:
    """(bands, H, W) squares of a plane's bands over a region (H, W), longest first."""
    plane = filled(plane, region)
    plane = plane - smoothed(plane, around)
    return np.square(split(np.where(region, plane, np.float32(0.0)))[:-1])


def _scatter(squares: Floats, region: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(bands,) relative deviation of energies of _CELLS x _CELLS parts of a picture."""
    rows, columns = (np.arange(side) * _CELLS // side for side in region.shape)
    cells = (rows[:, None] * _CELLS + columns)[region]
    counts = np.bincount(cells, minlength=_CELLS**2)
    many = 2 * _CELLS**2 * counts > cells.size
    energies = [np.bincount(cells, each[region], len(counts))[many] for each in squares]
    energy = np.array(energies) / counts[many]
    return np.asarray(energy.std(1) / energy.mean(1).clip(1e-12))
