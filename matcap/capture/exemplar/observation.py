"""Observation: a rectified photograph, its light at every texel, and the network's inputs.

PhotographLight renders maps in that light, and gives the derivative of log radiance by slope. All
stages from here on compare such renderings with the photograph. Maps are `residuals`: residuals of
log parameters (brdf/cook_torrance.py) from the uniform material of the coarse fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import F0_LIMITS, Reflectance, SurfaceParameters
from matcap.brdf.maps import MapSet, normals_from_slopes
from matcap.capture.exemplar.network.network import NetworkInputs, network_inputs
from matcap.capture.exemplar.relief_spectrum import smoothed
from matcap.files.color import srgb_slope
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import flash_mirror_point, points_of
from matcap.flash.light import (
    FlashLight,
    Uniform,
    cached_rows,
    from_vignetting_centre,
    linearised,
    strips,
)
from matcap.flash.rectify import Plane, inside
from matcap.photo.photo import ToneCurve

AROUND = 8.0  # texels, standard deviation of local averages
# Log radiance added in quadrature to the noise before channels are weighted by it. Fine detail of a
# JPEG is the same difference of codes in all channels: too much contrast in the dark ones of a
# saturated colour, which 0.1 passes on to the others.
_COMMON_NOISE = 0.02
_SPREAD_OF_LIGHT = 1.5  # texels, standard deviation of the blur of clipping
# Radiance (1 at clipping) below which a neighbourhood is unlit: the lowest 8-bit codes, or noise.
_UNLIT = 1e-3
# Largest albedo, of the brightest texels of those with a smaller specular fraction.
_WHITEST, _BRIGHTEST, _MATTE = 0.9, 0.99, 0.5


@dataclass(frozen=True)
class PhotographLight:
    """The photograph's light at every texel, precomputed."""

    flash: FlashLight
    """The light."""
    uniform: SurfaceParameters
    """(..., 1, 1) each: log parameters of the uniform material, which `residuals` are added to."""
    tint: Tensor | float = 1.0
    """(3, H, W) specular tint, F0 over the mean of its channels; 1 without metal
    (predict.py). Residuals of F0 are those of its mean."""

    @staticmethod
    def of(coarse: Uniform, points: Tensor) -> PhotographLight:
        """Light and uniform material of a coarse fit, at plane points (3, H, W)."""
        return PhotographLight(FlashLight.of(coarse.setup, points), coarse.parameters().to(points))

    def cut(self, rows: slice, columns: slice) -> PhotographLight:
        """The light at a rectangle of texels."""
        tint = self.tint if isinstance(self.tint, float) else self.tint[..., rows, columns]
        return replace(self, flash=self.flash.cut(rows, columns), tint=tint)

    def maps(self, residuals: SurfaceParameters, texel_size: float = 1.0) -> MapSet:
        """Maps with log parameters `uniform` + residuals."""
        maps = (self.uniform + residuals).maps(texel_size)
        return replace(maps, specular=(maps.specular * self.tint).clamp(*F0_LIMITS))

    def residuals(self, maps: MapSet) -> SurfaceParameters:
        """The inverse of maps()."""
        mean = maps.specular.mean(-3, keepdim=True)
        return SurfaceParameters.of(replace(maps, specular=mean)) - self.uniform

    def rendered(self, maps: MapSet) -> tuple[Tensor, Tensor]:
        """Incident.log_radiance() of maps on their own relief, strip by strip."""
        return _by_strips(self.cut, maps)

    def slope_sensitivity(self, maps: MapSet | Reflectance) -> Tensor:
        """(2, H, W) d log L / d slope along x and y on a flat surface, a mean over channels."""
        level = torch.zeros_like(maps.roughness)
        _, _, others = linearised(self.flash, normals_from_slopes(level, level), maps)
        return others[2:].mean(1)


@dataclass(frozen=True)
class PlaneLight:
    """A photograph's light at the texels of its plane, computed for each rectangle that is cut."""

    coarse: Uniform
    """The fit whose light it is."""
    size: tuple[int, int]
    """(width, height) of the plane."""

    def cut(self, rows: slice, columns: slice) -> PhotographLight:
        """The light at a rectangle of texels."""
        points = points_of(self.size[::-1], rows)
        return PhotographLight.of(self.coarse, points[:, :: rows.step, columns])

    def rendered(self, maps: MapSet) -> tuple[Tensor, Tensor]:
        """Incident.log_radiance() of maps on their own relief, strip by strip."""
        return _by_strips(self.cut, maps)


def _by_strips(
    light: Callable[[slice, slice], PhotographLight], maps: MapSet
) -> tuple[Tensor, Tensor]:
    """Incident.log_radiance() of maps on their own relief, in the light of each strip of rows."""
    log, share = torch.empty_like(maps.diffuse), torch.empty_like(maps.diffuse)
    normal, (height, width) = maps.normal, maps.diffuse.shape[-2:]
    for rows in strips(height, cached_rows(width)):
        cut = (m[..., rows, :] for m in (maps.diffuse, maps.specular, maps.roughness))
        incidence = light(rows, slice(None)).flash.onto(normal[..., rows, :])
        log[..., rows, :], share[..., rows, :] = incidence.log_radiance(Reflectance(*cut))
    return log, share


@dataclass(frozen=True)
class Observation:
    """A rectified photograph, and its light."""

    plane: Plane
    """The photograph; valid where visible, unclipped and lit."""
    coarse: CoarseFit
    """Coarse fit of the photograph."""
    points: Tensor
    """(3, H, W) plane points of the texels."""
    shown: Tensor
    """(3, H, W) bool by channel: unclipped and lit, or outside of the photograph."""
    within: Tensor
    """(H, W) bool: inside of the photograph and its mask."""
    inputs: NetworkInputs
    """Inputs of the network."""
    light: PhotographLight
    """The photograph's, at every texel."""
    noise: Tensor
    """(3, H, W) standard deviation of log radiance, of the sensor or the 8-bit codes."""

    @staticmethod
    def of(plane: Plane, coarse: CoarseFit) -> Observation:
        """Observation of a rectified photograph; texels below the noise become invalid."""
        points = points_of(plane.size[::-1], extent=plane.extent)
        # Texels outside of the photograph are mirrored ones, and count as valid inputs.
        own = torch.from_numpy(inside(plane.margins.inside_of(plane.size[::-1]), coarse.setup))
        mirrors = ~(plane.margins.padded(own) & plane.kept)
        inputs = network_inputs(plane.linear, plane.valid | mirrors, coarse, points)
        bright = lit(plane.linear)
        shown = (plane.measured | mirrors) & bright
        plane = replace(plane, valid=plane.valid & bright, channels=plane.measured & bright)
        light = PhotographLight.of(coarse, points)
        return Observation(
            plane, coarse, points, shown, ~mirrors, inputs, light, channel_noise(plane, coarse.tone)
        )

    def below_white(self) -> Observation:
        """The same picture of less albedo and F0 under more light, if its white were above 1.

        The fit bounds the mean of albedo; the white tiles of a chequerboard are twice that.
        """
        matte = (self.inputs.gloss[0] < _MATTE) & self.plane.valid
        if self.coarse.conductor or not bool(matte.any()):
            return self
        over = np.quantile(self.inputs.log[:, matte].numpy(), _BRIGHTEST, axis=1)
        factor = _WHITEST / float((np.exp(over) * self.coarse.diffuse).max())
        return self if factor >= 1.0 else Observation.of(self.plane, self.coarse.scaled(factor))

    @property
    def specular_fraction(self) -> NDArray[np.float32]:
        """(H, W) specular fraction of the uniform material's radiance."""
        return np.asarray(self.inputs.gloss[0].clamp(0.0, 1.0).numpy(), np.float32)

    @property
    def from_mirror_point(self) -> Tensor:
        """(H, W) distance from the flash's mirror point, plane units."""
        x, y = flash_mirror_point(self.coarse.setup)
        return torch.hypot(self.points[0] - x, self.points[1] - y)

    @property
    def from_vignetting_centre(self) -> Tensor:
        """(H, W) distance from the vignetting's centre in the photograph, in half widths."""
        return torch.hypot(*from_vignetting_centre(self.points, self.coarse.setup))


def seen_share(measured: Tensor) -> NDArray[np.float32]:
    """(H, W) visibility in [0, 1] of a texel and its neighbours, from unclipped channels (3, H, W).

    Two of three channels suffice, as both show the texture: of red cloth the red one clips first.
    Light of clipped texels blurs into neighbours: next to an isolated sparkle visibility is little
    lower, next to a large clipped area it is 0.
    """
    share = (measured.float().sum(0) / 2.0).clamp_max(1.0).numpy()
    around = cv2.GaussianBlur(share, (0, 0), _SPREAD_OF_LIGHT, borderType=cv2.BORDER_REFLECT)
    return np.asarray(np.minimum(share, np.clip(2.0 * around - 1.0, 0.0, 1.0)), np.float32)


def lit(linear: Tensor) -> Tensor:
    """(H, W) bool: where the local mean of radiance (3, H, W) is above _UNLIT.

    Radiance is limited to 2 _UNLIT first, so that bright neighbours do not light a dark texel.
    """
    grey = linear.mean(0).clamp_max(2.0 * _UNLIT).numpy()
    return torch.from_numpy(smoothed(grey, AROUND) > _UNLIT)


def channel_noise(plane: Plane, tone: ToneCurve | None = None) -> Tensor:
    """(3, H, W) standard deviation of log radiance by sensor noise or quantisation, at most 1.

    Of a RAW, by its sensor model (photo/raw.py); of a developed photograph by the step of
    its 8-bit codes, which is large in dark channels. Local averages, so that it does not depend on
    a texel's own darkness.

    Args:
        tone: the tone curve that was undone, or None; d log y / d log light = exponent (1 - w y).
    """
    tone = tone or ToneCurve()
    level = np.stack([smoothed(c, AROUND) for c in plane.linear.numpy()])
    slope: NDArray[np.floating] | float = 1.0
    if plane.noise is not None:
        drawn = plane.noise.square().numpy()
        deviation = np.sqrt(np.stack([smoothed(c, AROUND) for c in drawn]))
    elif plane.developed:
        level = tone.developed(level)
        deviation = code_step(level)
        slope = tone.exponent * (1.0 - tone.shoulder * level.clip(0.0, 1.0))
    else:
        return torch.zeros_like(plane.linear)
    share = deviation / np.maximum(level, np.maximum(deviation, np.float32(1e-9))) / slope
    return torch.from_numpy(np.asarray(share.clip(0.0, 1.0), np.float32))


def channel_weights(noise: Tensor) -> Tensor:
    """(3, H, W) weights of the channels for a mean over them; they sum to 1."""
    weight = 1.0 / (noise.square() + _COMMON_NOISE**2)
    return weight / weight.sum(0, keepdim=True)


def code_step(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Step of linear radiance (any shape) per 8-bit code, by the derivative of the sRGB curve."""
    return np.asarray(1.0 / (255.0 * srgb_slope(linear)), np.float32)
