"""Detail transfer: finest bands from the photograph to maps predicted at a lower resolution.

Network, spectra and statistics work at the scale of training (rectified.py); the photograph has
more detail. The finest bands of its residual to the re-rendering of the enlarged maps, denoised by
a Wiener filter, are assigned to albedo, less the shading of relief. The energy of relief in each
finer octave is extrapolated from its finest predicted octaves; its pattern is that of the residual,
with the sign of the correlation of height and brightness in coarser bands. Integrating apparent
slopes instead would give streaks tangential to the flash (docs/notes/capture.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO_LIMITS, F0_LIMITS, ROUGHNESS_LIMITS, Reflectance
from matcap.brdf.heights import spline_enlarged
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.inpaint import Copies
from matcap.capture.exemplar.network.network import SUBSAMPLING
from matcap.capture.exemplar.octaves import smoothed, split
from matcap.capture.exemplar.predict import with_confidence
from matcap.capture.rectified import AROUND, PlaneLight
from matcap.example.exemplar import Exemplar
from matcap.flash.light import DARKEST, Uniform
from matcap.flash.rectify import Plane

_MOST_DETAIL = 1.0  # log radiance; residuals are clipped to +-this
_HIDDEN = 0.1  # squared diffuse share at which half of the residual is assigned to albedo
_ROUNDS = 2  # iterations of refining albedo
# Largest share of the finest bands' energy that is assigned to relief. With 0.5, leather has an
# NSD of 8.1 instead of 7.4, and is sharper than the photograph.
_RELIEF_AT_MOST = 0.25
_OCTAVES = (slice(2, 3), slice(3, 4), slice(4, 6))  # of filters.BANDS: 16-8, 8-4, 4-2 texels

Floats = NDArray[np.float32]


@torch.no_grad()
def transfer_detail(
    exemplar: Exemplar, plane: Plane, coarse: Uniform, copies: Copies | None = None
) -> Exemplar:
    """Enlarge an exemplar to the photograph's plane and add its finest bands.

    Args:
        exemplar: estimated at a lower resolution; returned unchanged if it has the plane's.
        coarse: its coarse fit, which has the light.
        copies: texels that were copied from others, as their finest bands are, too.
    """
    if exemplar.size == plane.size:
        return exemplar
    light = PlaneLight(coarse, plane.size)
    maps = _enlarged(exemplar, plane)
    noise = _Noise.of(plane, exemplar.size)
    detail = _missing_detail(light.rendered(maps)[0], plane, exemplar.size, noise)
    relief = _relief(exemplar, detail.mean(0).numpy(), maps, light)[None]
    relief = relief if copies is None else copies.read(relief)
    maps = replace(maps, height=maps.height + torch.from_numpy(relief) * plane.texel_size)
    del detail, relief
    enlarged = maps.diffuse
    log, share = light.rendered(maps)
    for _ in range(_ROUNDS):
        more = _missing_detail(log, plane, exemplar.size, noise)
        hidden = share.square().add_(_HIDDEN)
        more *= torch.div(share, hidden, out=hidden)
        diffuse = (maps.diffuse * more.exp_()).clamp_(*ALBEDO_LIMITS)
        ratio = torch.div(diffuse, maps.diffuse, out=more)
        # Only diffuse radiance has changed.
        brighter = torch.sub(ratio, 1.0, out=hidden).mul_(share).add_(1.0)
        share *= ratio.div_(brighter)
        log += brighter.log_()
        maps = replace(maps, diffuse=diffuse)
        del diffuse, more, hidden, ratio, brighter  # 40 MB each, of 2048 texels across
    del log, share
    if copies is not None:
        drawn = torch.from_numpy(copies.read((maps.diffuse / enlarged).numpy()))
        maps = replace(maps, diffuse=enlarged * drawn)
    # Contrast added to log albedo raises the mean; an area's albedo is the mean of its texels'.
    mean = torch.from_numpy(exemplar.diffuse.mean((1, 2), keepdims=True))
    diffuse = maps.diffuse.mul_(mean / maps.diffuse.mean((1, 2), keepdim=True))
    confidence = _resized(exemplar.confidence, plane.size, cv2.INTER_LINEAR)
    maps = replace(maps, diffuse=diffuse.clamp_(*ALBEDO_LIMITS))
    return with_confidence(maps, confidence.clip(0.0, 1.0, out=confidence))


def _enlarged(exemplar: Exemplar, plane: Plane) -> MapSet:
    """Interpolate maps bicubically to a plane's resolution, albedo in logarithms.

    Height by splines, as OpenCV's cubic kernel does not keep slopes.
    """

    def larger(values: Floats) -> Tensor:
        return torch.from_numpy(_resized(values, plane.size, cv2.INTER_CUBIC))

    return MapSet(
        diffuse=larger(np.log(exemplar.diffuse.clip(1e-4))).exp_().clamp_(*ALBEDO_LIMITS),
        specular=larger(exemplar.specular).clamp_(*F0_LIMITS),
        roughness=larger(exemplar.roughness).clamp_(*ROUGHNESS_LIMITS),
        height=torch.from_numpy(spline_enlarged(exemplar.height[0], plane.size))[None],
        texel_size=plane.texel_size,
    )


def _missing_detail(
    rendered: Tensor, plane: Plane, coarse: tuple[int, int], noise: _Noise | None
) -> Tensor:
    """(3, H, W) residual of log radiance, photograph less `rendered`, denoised.

    It has only frequencies above those of a grid of `coarse` = (width, height) texels.
    """
    detail = torch.empty_like(rendered)
    for channel, whole, known, shown in zip(
        detail, plane.linear, plane.measured, rendered, strict=True
    ):
        left = whole.clamp_min(DARKEST).log_().sub_(shown).clamp_(-_MOST_DETAIL, _MOST_DETAIL)
        left = torch.where(known, left, left.clamp_min(0.0))
        channel.copy_(_high_passed(left[None], coarse)[0])
    return detail if noise is None else noise.left_out(detail)


@dataclass(frozen=True)
class _Noise:
    """Local energy of sensor noise in the finest bands.

    Separately for the channels' mean and their chroma: texture is grey, noise is not.
    """

    grey: Tensor
    """(1, H, W) energy of the channels' mean."""
    colours: Tensor
    """(3, H, W) energy of the chroma, channels less their mean."""

    @staticmethod
    def of(plane: Plane, coarse: tuple[int, int]) -> _Noise | None:
        """Noise of a RAW's log radiance; None without a noise model, as of developed pictures."""
        if plane.noise is None:
            return None
        light = np.stack([smoothed(c, AROUND) for c in plane.linear.numpy()])
        noise = plane.noise / torch.from_numpy(light).clamp_min(DARKEST)
        noise = _high_passed(noise.clamp(-_MOST_DETAIL, _MOST_DETAIL), coarse)
        grey = noise.mean(0, keepdim=True)
        return _Noise(_energy(grey), _energy(noise - grey))

    def left_out(self, detail: Tensor) -> Tensor:
        """Wiener filter of detail (3, H, W), mean and chroma separately."""
        grey = detail.mean(0, keepdim=True)
        return _wiener(grey, self.grey) + _wiener(detail - grey, self.colours)


def _wiener(seen: Tensor, chance: Tensor) -> Tensor:
    """Wiener filter of `seen` (C, H, W), with local noise energy `chance` (C, H, W)."""
    return seen * (1.0 - chance / _energy(seen).clamp_min(1e-12)).clamp_min(0.0)


def _energy(picture: Tensor) -> Tensor:
    """(C, H, W) local mean square."""
    return torch.from_numpy(np.stack([smoothed(c, AROUND) for c in picture.square().numpy()]))


def _high_passed(picture: Tensor, coarse: tuple[int, int]) -> Tensor:
    """High-pass of a picture (C, H, W): less its version on a grid of (width, height) texels."""
    whole = picture.numpy()
    size = (whole.shape[-1], whole.shape[-2])
    coarse_part = _resized(_resized(whole, coarse, cv2.INTER_AREA), size, cv2.INTER_CUBIC)
    return torch.from_numpy(np.subtract(whole, coarse_part, out=coarse_part))


def _relief(exemplar: Exemplar, detail: Floats, maps: MapSet, light: PlaneLight) -> Floats:
    """(H, W) height in texels of the finest bands: `detail`, times a signed factor.

    The factor gives it the extrapolated slope energy, limited by the energy of `detail`, the
    residual's detail (H, W) in log radiance.
    """
    octaves = math.log2(maps.size[0] / exemplar.size[0])
    texels = exemplar.height[0] / np.float32(exemplar.texel_size)
    bands = split(texels)
    energies = [_steepness(np.sum(bands[which], axis=0)) for which in _OCTAVES]
    ratio = energies[2] / max(energies[1], 1e-12)
    ratio = min(ratio, 1.0)
    each = range(1, math.ceil(octaves) + 1)
    wanted = energies[2] * sum(ratio**k * min(1.0, octaves - k + 1.0) for k in each)
    some = slice(None, None, SUBSAMPLING)
    planes = maps.diffuse, maps.specular, maps.roughness
    reflectance = Reflectance(*(p[:, some, some] for p in planes))
    sensitivity = light.cut(some, some).slope_sensitivity(reflectance).square().sum(0).mean()
    most = _RELIEF_AT_MOST * float(np.square(detail).mean()) / max(0.5 * float(sensitivity), 1e-6)
    drawn = max(_steepness(detail), 1e-12)
    return _sign(exemplar, bands) * np.float32(math.sqrt(min(wanted, most) / drawn)) * detail


def _steepness(height: Floats) -> float:
    """Mean squared slope."""
    down, across = np.gradient(height)
    return float(np.square(down).mean() + np.square(across).mean())


def _sign(exemplar: Exemplar, bands: list[Floats]) -> np.float32:
    """Sign of the correlation of height and albedo in the coarser bands, 1 or -1."""
    tone = split(np.log(exemplar.diffuse.clip(1e-4)).mean(0))
    weight = exemplar.confidence[0]
    together = sum((weight * bands[k] * tone[k]).mean() for k in (2, 3))
    return np.float32(1.0 if together >= 0.0 else -1.0)


def _resized(planes: Floats, size: tuple[int, int], how: int) -> Floats:
    """Resize planes (C, H, W) to (width, height) with an OpenCV interpolation."""
    resized = np.empty((len(planes), size[1], size[0]), np.float32)
    for plane, into in zip(planes, resized, strict=True):
        cv2.resize(plane, size, dst=into, interpolation=how)
    return resized
