"""A photograph rectified to its sample's plane, after the coarse fit with the alignment branch's
tilt, and its Observation: its light at every texel, and the network's inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import F0_LIMITS, Reflectance, SurfaceParameters
from matcap.brdf.maps import MapSet, normals_from_slopes
from matcap.capture.exemplar.network.network import (
    MOST_RESIDUAL,
    SUBSAMPLING,
    NetworkInputs,
    network_inputs,
    resized,
)
from matcap.capture.exemplar.octaves import smoothed
from matcap.capture.settings import DETAIL
from matcap.files.color import srgb_slope
from matcap.files.threads import at_once, one_thread
from matcap.flash.alignment import tilt_measurement
from matcap.flash.coarse.fit import CoarseFit, Measured, fit_coarse, rescale_to_flash
from matcap.flash.coarse.problem import TiltPrior
from matcap.flash.diffuse_share import blur
from matcap.flash.geometry import flash_mirror_point, points_of
from matcap.flash.light import (
    FlashLight,
    Uniform,
    cached_rows,
    from_vignetting_centre,
    linearised,
    strips,
    uniform_radiance,
)
from matcap.flash.rectify import Plane, inside, read_plane
from matcap.photo.left_out import area_averaged, mirrored
from matcap.photo.photo import Photo, ToneCurve
from matcap.statistics.compare import FilterBankConfig, Weights
from matcap.statistics.lattice import Wave, find_lattice

WINDOW = 160  # side of the windows whose texture statistics are compared, texels
FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Method:
    """A variant of the capture method; by default the one that measured best."""

    weights: Weights = Weights()
    """Weights of the texture statistics in their sum."""
    measured_tilt: bool = True
    """Whether the alignment branch's tilt is a prior of the coarse fit."""


@one_thread()
def fit_photograph(photo: Photo, *, measured: bool = True, metal: bool | None = None) -> CoarseFit:
    """Coarse fit of a photograph, with the alignment branch's two tilt angles as Gaussian prior.

    Albedo is absolute where the flash intensity is known.

    Args:
        measured: whether to use the alignment branch.
        metal: whether the material is metal; None to decide by the photograph.
    """

    def tilt() -> TiltPrior | None:
        return tilt_measurement(photo) if measured else None

    prior, seen = at_once(tilt, partial(Measured.of, photo))
    fitted = fit_coarse(photo, tilt_prior=prior, known_metal=metal, measured=seen)
    return rescale_to_flash(fitted, photo.flash_intensity)


def tilt_document(coarse: CoarseFit) -> dict[str, Any] | None:
    """Tilt about x and y by source, degrees; None without a measurement.

    Keys: `used`; and `branch`, the alignment branch's, with its standard deviation `branch_std`.
    """
    if coarse.tilt_prior is None:
        return None
    return {
        "used": _degrees(coarse.setup.tilt),
        "branch": _degrees(coarse.tilt_prior.mean),
        "branch_std": _degrees(coarse.tilt_prior.std),
    }


def _degrees(angles: Sequence[float]) -> list[float]:
    return [round(math.degrees(angle), 2) for angle in angles]


# A photograph rectified to the plane of its sample, at the resolutions of exemplar and network.
#
# In come a photograph and its coarse fit, out goes a Rectified: both, the plane, and its lattice.
# The exemplar has the resolution asked for. The network's receptive field is about a hundred texels
# and the compared windows have 160; structure of longer wavelength is lost (wood becomes sawdust).
# Such textures are read on half as many texels across, and finer bands are transferred from the
# photograph (exemplar/detail_transfer.py). Figures in docs/notes/capture.md.

# Detection of coarse textures; docs/notes/capture.md.

_FAINTEST = 1e-4  # linear radiance below which the logarithm is clamped, as it is noise
_OCTAVES = 6  # number of bands, separated by Gaussian blurs of 1, 2, 4 ... texels
# Share of variance in the last band (wavelengths of 100 to 200 texels) above which a texture is
# coarse.
_MOST_COARSE = 0.08
_MOST_REGULAR = 0.5  # share of the power on a lattice from which no other is looked for


def coarse_share(linear: Tensor, valid: Tensor) -> float:
    """Share of the variance of log luminance in the texture's coarsest band, in [0, 1].

    Lower frequencies than that band are shading and left out.

    Args:
        linear: (3, H, W) picture of the plane, DETAIL texels across.
        valid: (H, W) bool, texels seen and not clipped.
    """
    seen = valid.numpy().astype(np.float32)
    if not seen.any():
        return 0.0
    log = np.log(np.maximum(linear.mean(0).numpy(), _FAINTEST))
    finer = (log - float(np.median(log[seen > 0.0]))).clip(-MOST_RESIDUAL, MOST_RESIDUAL)
    variances = []
    for scale in (2.0**octave for octave in range(_OCTAVES)):
        # The last blur removed all detail finer than half this scale: from 2 texels on, half as
        # many samples suffice.
        if scale > 2.0:
            finer, seen = _halved(finer), _halved(seen)
        deviation = min(scale, 2.0)
        weight = np.maximum(blur(seen, deviation), 1e-3)
        blurred = blur(finer * seen, deviation) / weight
        variances.append(float(np.average(np.square(finer - blurred), weights=seen)))
        finer = blurred
    whole = sum(variances)
    return variances[-1] / whole if whole > 0.0 else 0.0


def _halved(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Box-filter to half the size."""
    return area_averaged(picture, tuple(max(1, side // 2) for side in picture.shape[::-1]))


def network_input(plane: Plane, waves: tuple[Wave, ...] = ()) -> Plane:
    """The plane at most DETAIL texels across; half of that if its texture is coarse and aperiodic.

    Waves of any period are inputs of the network, so periodic textures need no coarser grid.
    """
    columns = plane.size[0]
    usual = plane.shrunk(DETAIL) if columns > DETAIL else plane
    if columns < DETAIL or waves or coarse_share(usual.linear, usual.valid) <= _MOST_COARSE:
        return usual
    return plane.shrunk(DETAIL // 2)


def lattice_of(plane: Plane) -> tuple[Wave, ...]:
    """Frequency vectors of a plane's lattice, cycles per texel; of the halved plane if it has one.

    Halved, a plane shows what is too long for find_lattice, such as checks of 90 texels.
    """
    lattice, half = find_lattice(plane.encoded(), plane.valid), plane
    while lattice.share < _MOST_REGULAR and half.size[0] >= DETAIL:
        half = half.shrunk(half.size[0] // 2)
        coarse = find_lattice(half.encoded(), half.valid)
        if coarse.share >= _MOST_REGULAR:
            shorter = half.size[0] / plane.size[0]
            return tuple(Wave(shorter * wave.fx, shorter * wave.fy) for wave in coarse.waves)
    return lattice.waves


@dataclass(frozen=True)
class Rectified:
    """A photograph rectified to the plane of its sample, and its lattice."""

    photo: Photo
    """The photograph, its tone curve undone; of several, the first, less ambient light."""
    coarse: CoarseFit
    """Coarse fit of the photograph; of several, with the registered camera."""
    whole: Plane
    """The plane at the resolution of the exemplar."""
    waves: tuple[Wave, ...]
    """Frequency vectors of its lattice, cycles per texel of `whole`; empty without one."""
    network_input: Plane
    """The plane at the resolution that the network takes."""

    @staticmethod
    def of(photo: Photo, coarse: CoarseFit, detail: int) -> Rectified:
        """Rectify a photograph to a grid `detail` texels across, and find its lattice."""
        plane = read_plane(photo, coarse.setup, detail)
        whole, waves = fill_masked(plane, coarse), lattice_of(plane)
        return Rectified(photo, coarse, whole, waves, network_input(whole, waves))

    @property
    def input_waves(self) -> tuple[Wave, ...]:
        """Frequency vectors of the lattice, cycles per texel of `network_input`."""
        longer = self.whole.size[0] / self.network_input.size[0]
        return tuple(Wave(longer * wave.fx, longer * wave.fy) for wave in self.waves)

    def at_input_resolution(self) -> Rectified:
        """The same photograph with an exemplar at the network's resolution."""
        return replace(self, whole=self.network_input, waves=self.input_waves)


@torch.no_grad()
def fill_masked(plane: Plane, uniform: Uniform) -> Plane:
    """Fill masked texels by mirrored ones, times the ratio of the uniform material's radiance.

    With another place's shading they would bias networks and filters whose support includes them.

    Args:
        plane: the photograph; returned unchanged without masked texels.
    """
    if plane.left_out is None:
        return plane
    width, height = plane.size
    points = points_of((height, width))
    size = tuple(max(2, -(-side // SUBSAMPLING)) for side in (height, width))
    light = FlashLight.of(uniform.setup, resized(points, size))
    flat = resized(uniform_radiance(uniform, light)[0], (height, width)).clamp_min(1e-6)
    rows, columns = (torch.from_numpy(at) for at in mirrored(plane.left_out.numpy()))
    linear, ratio = plane.linear.clone(), flat[:, plane.left_out] / flat[:, rows, columns]
    linear[:, plane.left_out] = plane.linear[:, rows, columns] * ratio
    return replace(plane, linear=linear)


# Observation: a rectified photograph, its light at every texel, and the network's inputs.
#
# PhotographLight renders maps in that light, and gives the derivative of log radiance by slope. All
# stages from here on compare such renderings with the photograph. Maps are `residuals`: residuals
# of log parameters (brdf/cook_torrance.py) from the uniform material of the coarse fit.

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
        points = points_of(self.size[::-1], rows, columns=columns)
        return PhotographLight.of(self.coarse, points)

    def rendered(self, maps: MapSet) -> tuple[Tensor, Tensor]:
        """Incident.log_radiance() of maps on their own relief, strip by strip."""
        return _by_strips(self.cut, maps)


def _by_strips(
    light: Callable[[slice, slice], PhotographLight], maps: MapSet
) -> tuple[Tensor, Tensor]:
    """Incident.log_radiance() of maps on their own relief, in the light of each strip of rows."""
    log, share = torch.empty_like(maps.diffuse), torch.empty_like(maps.diffuse)
    height, width = maps.diffuse.shape[-2:]

    def shaded(rows: slice) -> None:
        cut = (m[..., rows, :] for m in (maps.diffuse, maps.specular, maps.roughness))
        incidence = light(rows, slice(None)).flash.onto(maps.normals_of(rows))
        log[..., rows, :], share[..., rows, :] = incidence.log_radiance(Reflectance(*cut))

    at_once(*(partial(shaded, rows) for rows in strips(height, cached_rows(width))))
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
        noise = channel_noise(plane, coarse.tone)
        return Observation(plane, coarse, points, shown, ~mirrors, inputs, light, noise)

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
