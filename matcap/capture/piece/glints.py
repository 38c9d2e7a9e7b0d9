"""Amplitude of relief from the contrast of glints, octave by octave.

Where the specular fraction is high, contrast is due to slopes: albedo is diluted, and F0 and
roughness are constant. So the energy E_b of log radiance in octave b, noise subtracted, of the
photograph gives the factor g_b on relief:

    E_b(region) = mean (1 - s)^2 A_b + g_b^2 R_b(region),  of the glossiest and the mattest region,

with the unknown energy A_b of log albedo, specular fraction s and energy R_b of the re-rendering
with constant albedo. The matte region yields A_b: under a glaze over a pattern, or on polished
limestone, part of the contrast is albedo.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.piece.noise import DARKEST
from matcap.capture.piece.refine import PhotographLight
from matcap.capture.piece.smooth import WIDE, filled, smoothed, split

# Specular fraction of the radiance that bounds the glossiest region, where slopes dominate.
MIRRORED = 0.4
LEAST_SHARE = 0.01  # least share of the photograph for that region
# Share of the photograph, with the least specular fraction, in the mattest region.
_MATTE_SHARE = 0.33
_LEAST_FACTOR, _MOST_FACTOR = 0.5, 6.0  # limits of the factors


def scaled_by_glints(
    departures: SurfaceParameters,
    linear: Tensor,
    measured: Tensor,
    light: PhotographLight,
    noise: Tensor,
) -> SurfaceParameters:
    """Scale each octave of relief by its factor g_b, measured in the glints (module equation).

    Args:
        departures: of the exemplar from the coarse fit.
        linear: (3, H, W) the photograph on the plane's grid.
        measured: (3, H, W) bool: not clipped.
        light: the photograph's own.
        noise: (3, H, W) standard deviation of log radiance.
    """
    maps = light.maps(departures)
    _, diffuse_share = light.rendered(maps)
    around = max(linear.shape) / WIDE
    glare = 1.0 - smoothed(diffuse_share.mean(0).numpy(), around / 4.0)
    seen = measured.all(0).numpy()
    region = (glare > MIRRORED) & seen
    if float(region.mean()) < LEAST_SHARE:
        return departures
    mean = departures.diffuse.mean((1, 2), keepdim=True)
    maps = light.maps(replace(departures, diffuse=mean.expand_as(linear)))
    rendered = light.rendered(maps)[0].mean(0).numpy()
    photograph = linear.clamp_min(DARKEST).log().mean(0).numpy()
    variance = (noise.square().mean(0) / 3.0).numpy()

    def energies(where: NDArray[np.bool_]) -> NDArray[np.float64]:
        energy = _energies(photograph, where, around)
        # Sensor noise is white: three quarters of its energy are in the finest octave.
        for octave in range(len(energy) - 1):
            energy[len(energy) - 2 - octave] -= variance[where].mean() * 0.75 * 0.25**octave
        return energy.clip(0.0)

    matte = (glare <= np.quantile(glare[seen], _MATTE_SHARE)) & seen
    diluted = np.square(1.0 - glare).clip(1e-8)
    share = diluted[region].mean() / diluted[matte].mean()
    whole = _energies(rendered, region, around)
    # If both regions are equally sensitive to slope, relief and albedo are hardly separable.
    relief = (whole - share * _energies(rendered, matte, around)).clip(0.5 * whole)
    excess = (energies(region) - share * energies(matte)).clip(0.0)
    gains = np.sqrt(excess / relief.clip(1e-12))
    gains = gains.clip(_LEAST_FACTOR, _MOST_FACTOR)
    gains[-1] = 1.0
    bands = split(departures.height[0].numpy())
    height = sum(float(g) * band for g, band in zip(gains, bands, strict=True))
    return replace(departures, height=torch.from_numpy(np.asarray(height, np.float32))[None])


def _energies(
    plane: NDArray[np.float32], region: NDArray[np.bool_], around: float
) -> NDArray[np.float64]:
    """(bands,) mean square over a region (H, W) of a plane's bands, longest first."""
    plane = filled(plane, region)
    plane = plane - smoothed(plane, around)
    plane = np.where(region, plane, np.float32(0.0))
    return np.array([np.square(band[region]).mean() for band in split(plane)], np.float64)
