"""Refinement by re-rendering: residuals are assigned to maps in proportion to their variance.

Gauss-Newton steps at every texel assign the residual of log radiance to albedo, or to F0 of metal,
in proportion to sensitivity and prior variance (a Wiener filter whose prior is the network's
prediction with its expected errors). Relief is not changed: misplaced relief would be cancelled
instead of moved (docs/notes/capture.md). A clipped channel is a lower bound. Low-frequency
residuals are errors of coarse fit and tone curve, and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.normals import normals_from_slopes
from matcap.brdf.parameters import F0_LIMITS, Reflectance, SurfaceParameters
from matcap.capture.piece.network.inputs import STEP
from matcap.capture.piece.network.network import ExpectedErrors
from matcap.capture.piece.noise import DARKEST, channel_weights
from matcap.capture.piece.smooth import WIDE, smoothed
from matcap.flash.geometry import plane_points
from matcap.flash.light import FlashLight, Incidence, cached_rows, strips
from matcap.flash.uniform import Uniform

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
_GLARE, _GLARE_METAL = 0.5, 0.15
# Ratio of the standard deviations of albedo's chroma and lightness. Larger values take sensor
# noise for colour.
_CHROMA = 0.3
# The long side over the standard deviation of the blur that is subtracted from albedo, as the
# sample is stationary.
_STATIONARY = 8.0
_RINGS, _SECTORS = 64, 16  # rings across the long side, and their parts
_MOST_SHIFT = 2.0  # largest factor on the mean radiance


@dataclass(frozen=True)
class Refined:
    """Refined maps and residuals of their re-rendering.

    Attributes:
        departures: log parameters of the maps less those of the coarse fit.
        residual: (3, H, W) log radiance of the photograph less that of the re-rendering.
        slow: (3, H, W) its low frequencies, which are not assigned to maps.
    """

    departures: SurfaceParameters
    residual: Tensor
    slow: Tensor


@dataclass(frozen=True)
class PhotographLight:
    """The photograph's light at every texel, precomputed.

    Attributes:
        flash: the light.
        uniform: (..., 1, 1) each: log parameters of the uniform material, which `departures` are
            added to.
        hue: (3, H, W) specular tint, F0 over the mean of its channels; None without metal
            (metal.py). Departures of F0 are those of its mean.
    """

    flash: FlashLight
    uniform: SurfaceParameters
    hue: Tensor | None = None

    @staticmethod
    def of(coarse: Uniform, points: Tensor) -> PhotographLight:
        """Light and uniform material of a coarse fit, at plane points (3, H, W)."""
        return PhotographLight(FlashLight.of(coarse.setup, points), coarse.parameters().to(points))

    def cut(self, rows: slice, columns: slice) -> PhotographLight:
        """The light at a rectangle of texels."""
        hue = None if self.hue is None else self.hue[..., rows, columns]
        return replace(self, flash=self.flash.cut(rows, columns), hue=hue)

    def maps(self, departures: SurfaceParameters, texel_size: float = 1.0) -> MapSet:
        """Maps with log parameters `uniform` + departures."""
        maps = (self.uniform + departures).maps(texel_size)
        if self.hue is None:
            return maps
        return replace(maps, specular=(maps.specular * self.hue).clamp(*F0_LIMITS))

    def departures(self, maps: MapSet) -> SurfaceParameters:
        """The inverse of maps()."""
        if self.hue is not None:
            maps = replace(maps, specular=maps.specular.mean(-3, keepdim=True))
        return SurfaceParameters.of(maps) - self.uniform

    def logs(self, maps: MapSet | Reflectance, incidence: Incidence) -> tuple[Tensor, Tensor]:
        """(3, H, W) each: log radiance of maps, and the diffuse share of the radiance."""
        diffuse = incidence.diffuse(maps.diffuse)
        mirrored = incidence.specular(maps.specular, maps.roughness)
        radiance = (diffuse + mirrored).clamp_min(DARKEST)
        return radiance.log(), diffuse / radiance

    def rendered(self, maps: MapSet) -> tuple[Tensor, Tensor]:
        """logs() of maps on their own relief, strip by strip."""
        return _by_strips(self.cut, maps)

    def slope_sensitivity(self, maps: MapSet | Reflectance) -> Tensor:
        """(2, H, W) d log L / d slope along x and y on a flat surface, L averaged over channels."""
        one = torch.ones_like(maps.roughness)

        def tilted(x: float, y: float) -> Tensor:
            incidence = self.flash.onto(normals_from_slopes(x * one, y * one))
            return self.logs(maps, incidence)[0].mean(0)

        across = tilted(STEP, 0.0) - tilted(-STEP, 0.0)
        up = tilted(0.0, STEP) - tilted(0.0, -STEP)
        return torch.stack([across, up]) / (2.0 * STEP)


@dataclass(frozen=True)
class PlaneLight:
    """A photograph's light at the texels of its plane, computed for each rectangle that is cut.

    Attributes:
        coarse: the fit whose light it is.
        size: (width, height) of the plane.
    """

    coarse: Uniform
    size: tuple[int, int]

    def cut(self, rows: slice, columns: slice) -> PhotographLight:
        """The light at a rectangle of texels."""
        width, height = self.size
        top, bottom, step = rows.indices(height)
        points = plane_points(0, top, width, bottom - top, self.size, dtype=torch.float32)
        return PhotographLight.of(self.coarse, points[:, ::step, columns])

    def rendered(self, maps: MapSet) -> tuple[Tensor, Tensor]:
        """PhotographLight.logs() of maps on their own relief, strip by strip."""
        return _by_strips(self.cut, maps)


def _by_strips(
    light: Callable[[slice, slice], PhotographLight], maps: MapSet
) -> tuple[Tensor, Tensor]:
    """PhotographLight.logs() of maps on their own relief, under the light of each strip of rows."""
    log, share = torch.empty_like(maps.diffuse), torch.empty_like(maps.diffuse)
    normal, (height, width) = maps.normal, maps.diffuse.shape[-2:]
    for rows in strips(height, cached_rows(width)):
        cut = (m[..., rows, :] for m in (maps.diffuse, maps.specular, maps.roughness))
        lit = light(rows, slice(None))
        incidence = lit.flash.onto(normal[..., rows, :])
        log[..., rows, :], share[..., rows, :] = lit.logs(Reflectance(*cut), incidence)
    return log, share


def flatten(
    departures: SurfaceParameters,
    confidence: NDArray[np.float32],
    distances: Sequence[NDArray[np.float32]],
    *,
    across: float | None = None,
) -> SurfaceParameters:
    """Remove from albedo (of metal: F0) low frequencies, and rings around given points: the
    flash's mirror point, and the vignetting's centre.

    A stationary sample has neither. The mean, weighted by squared confidence, is kept.

    Args:
        departures: of the exemplar from its classes' mean parameters.
        confidence: (H, W) of albedo, in [0, 1].
        distances: (H, W) each, from these points, texels.
        across: texels of the photograph's long side, if the exemplar extends beyond it.
    """
    weight = torch.from_numpy(confidence).square() + 1e-3

    def even(channels: Tensor) -> Tensor:
        if not bool(channels.any()):
            return channels
        mean = (channels * weight).sum((1, 2), keepdim=True) / weight.sum()
        unit = across or max(channels.shape)
        level = np.stack([c - smoothed(c, unit / _STATIONARY) for c in channels.numpy()])
        for distance in distances:
            level -= _rings(level, distance, confidence)
        return torch.from_numpy(level) + mean

    return replace(departures, diffuse=even(departures.diffuse), specular=even(departures.specular))


def _rings(
    planes: NDArray[np.float32], distance: NDArray[np.float32], weight: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(C, H, W) means of planes over rings around a point, as far as they are no chance.

    Of a ring's mean m with standard error e, from the scatter of its sectors, m (1 - e^2 / m^2) is
    kept, or 0 (James-Stein).

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

    def sums(values: NDArray[np.float32]) -> NDArray[np.float64]:
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
def refine(
    departures: SurfaceParameters,
    errors: ExpectedErrors,
    linear: Tensor,
    valid: Tensor,
    light: PhotographLight,
    *,
    metal: Tensor | None = None,
    noise: Tensor | float = 0.02,
) -> Refined:
    """Refine albedo, of metal F0, so that the maps re-render to the photograph.

    Args:
        departures: of the exemplar from the coarse fit.
        errors: expected errors of the prediction.
        linear: (3, H, W) the photograph on the plane's grid.
        valid: (H, W) or (3, H, W) bool, visible and not clipped.
        light: the photograph's own.
        metal: (1, H, W) share of metal in each texel; None without metal.
        noise: standard deviation of the photograph's log radiance; (3, H, W) or one number.
    """
    observed = linear.clamp_min(DARKEST).log()
    valid = valid.expand_as(linear)
    albedo = errors.albedo.exp().square()
    colour = albedo * _CHROMA**2
    maps = light.maps(departures)
    incidence = light.flash.onto(maps.normal)
    log, shares = light.logs(maps, incidence)
    white = torch.as_tensor(noise).to(linear).expand_as(linear).clamp_min(_LEAST_NOISE)
    weights = channel_weights(white)
    bare = torch.zeros_like(maps.roughness) if metal is None else metal
    for step in range(_STEPS):
        if step:
            log, shares = light.logs(light.maps(departures), incidence)
        residual = _unexplained(observed, log, valid)
        residual = (residual - _slow(residual, valid)).clamp(-_MOST_CHANGE, _MOST_CHANGE)
        informative = valid | (residual > 0.0)
        share = (weights * shares).sum(0, keepdim=True)
        # d log L / d log albedo, and of metal / d log F0.
        base = (1.0 - bare) * share + bare * (1.0 - share)
        counts = weights * informative
        counts = counts / counts.sum(0, keepdim=True).clamp_min(1e-6)
        grey = (counts * residual).sum(0, keepdim=True)
        uncertain = _GLARE + (_GLARE_METAL - _GLARE) * bare
        glare = (uncertain * (1.0 - share)).square()
        # The channels' noise is taken as fully correlated, as development blurs it to blotches.
        unknown = (counts * white).sum(0, keepdim=True).square() + glare
        common = base * albedo * grey / (base.square() * albedo + unknown)
        # A clipped channel that is bright enough gives no information on colour.
        chroma = torch.where(informative, residual - grey, 0.0)
        own = chroma * shares * colour / (shares.square() * colour + white.square() + glare)
        departures = replace(
            departures,
            diffuse=departures.diffuse + (1.0 - bare) * (common + own),
            specular=departures.specular + bare * common,
        )
    return remaining(departures, linear, valid, light)


@torch.no_grad()
def with_photographed_mean(
    departures: SurfaceParameters,
    linear: Tensor,
    valid: Tensor,
    light: PhotographLight,
    metal: Tensor | None = None,
) -> SurfaceParameters:
    """Shift log albedo, and F0 of metal, so that the mean radiance is the photograph's.

        shift = log(sum w (L - R) / sum w B),    w = B / (B + R) / U,

    for each channel, with photographed radiance L, rendered radiance B + R whose part B is
    proportional to albedo (of metal: F0), and the radiance U of the uniform material. Contrast that
    refinement adds to log albedo changes the mean radiance: of a black and white weave by 1.5.

    Args:
        departures, linear, valid, light, metal: as of refine.
    """
    log, diffuse_share = light.rendered(light.maps(departures))
    even, _ = light.rendered(light.maps(departures - departures))
    bare = torch.zeros_like(log[:1]) if metal is None else metal
    share = (1.0 - bare) * diffuse_share + bare * (1.0 - diffuse_share)
    radiance = log.exp()
    weight = valid * share / even.exp()
    photographed = (weight * (linear - (1.0 - share) * radiance)).sum((1, 2))
    rendered = (weight * share * radiance).sum((1, 2)).clamp_min(1e-9)
    ratio = (photographed / rendered).clamp(1.0 / _MOST_SHIFT, _MOST_SHIFT)
    shift = ratio.log()[:, None, None]
    return replace(
        departures,
        diffuse=departures.diffuse + (1.0 - bare) * shift,
        specular=departures.specular + bare * shift.mean(),
    )


def remaining(
    departures: SurfaceParameters, linear: Tensor, valid: Tensor, light: PhotographLight
) -> Refined:
    """Departures with the residuals of their re-rendering; arguments as of refine."""
    maps = light.maps(departures)
    log, _ = light.rendered(maps)
    residual = _unexplained(linear.clamp_min(DARKEST).log(), log, valid)
    return Refined(departures, residual, _slow(residual, valid))


def _unexplained(observed: Tensor, log: Tensor, valid: Tensor) -> Tensor:
    """(3, H, W) residual of log radiance; of clipped texels only its positive part."""
    residual = observed - log
    return torch.where(valid, residual, residual.clamp_min(0.0))


def _slow(residual: Tensor, valid: Tensor) -> Tensor:
    """Low-frequency part (3, H, W) of a residual, over valid texels."""
    deviation = max(valid.shape) / WIDE
    weights = valid.expand_as(residual).numpy().astype(np.float32) + np.float32(1e-4)
    planes = [
        smoothed(plane * weight, deviation) / smoothed(weight, deviation)
        for plane, weight in zip(residual.clamp(-1, 1).numpy(), weights, strict=True)
    ]
    return torch.from_numpy(np.stack(planes))
