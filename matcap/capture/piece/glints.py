"""Strength of relief from the contrast of glints, octave by octave.

Where most light is mirrored, contrast is slope: albedo is diluted and F0 and roughness are even. So
there the energy of log radiance in each octave b, photograph less noise, over that of the
re-rendering whose albedo is flat, is the square of the factor that relief is to be scaled by:

    g_b^2 = (E_b(photograph) - E_b(noise) - E_b(albedo alone)) / E_b(relief alone).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.piece.refine import PieceLight
from matcap.capture.piece.smooth import filled, smoothed, split


@dataclass(frozen=True)
class GlintSettings:
    """What is tuned of it.

    Attributes:
        mirrored: specular fraction of the radiance above which contrast is taken for slope.
        least_share: of the photograph that must be so, and not clipped.
        around: the long side over the deviation of what is too slow for a glint.
        least, most: factors are kept within.
    """

    mirrored: float = 0.4
    least_share: float = 0.01
    around: float = 12.0
    least: float = 0.5
    most: float = 6.0


def scaled_by_glints(
    departures: SurfaceParameters,
    linear: Tensor,
    measured: Tensor,
    light: PieceLight,
    noise: Tensor,
    settings: GlintSettings | None = None,
) -> SurfaceParameters:
    """Departures whose relief is as strong as the glints of the photograph.

    Args:
        departures: of the exemplar.
        linear: (3, H, W) the photograph on the plane's grid.
        measured: (3, H, W) bool: not clipped.
        light: the photograph's own.
        noise: (3, H, W) deviation of log radiance.
        settings: of the measurement.
    """
    settings = settings or GlintSettings()
    maps = light.maps(departures)
    incidence = light.flash.onto(maps.normal)
    log, diffuse_share = light.logs(maps, incidence)
    around = max(linear.shape) / settings.around
    glare = 1.0 - smoothed(diffuse_share.mean(0).numpy(), around / 4.0)
    region = (glare > settings.mirrored) & measured.all(0).numpy()
    if float(region.mean()) < settings.least_share:
        return departures
    flat = replace(departures, diffuse=departures.diffuse.mean((1, 2), keepdim=True) + 0 * log)
    level = replace(departures, height=torch.zeros_like(departures.height))

    def energies(radiance: Tensor) -> NDArray[np.float64]:
        return _energies(radiance.mean(0).numpy(), region, around)

    def rendered(surface: SurfaceParameters) -> Tensor:
        maps = light.maps(surface)
        return light.logs(maps, light.flash.onto(maps.normal))[0]

    photographed = energies(linear.clamp_min(1e-5).log())
    albedo, relief = energies(rendered(level)), energies(rendered(flat))
    grain = np.zeros_like(relief)
    # The sensor's noise is white: half of its energy is in the finest octave, and so on.
    variance = float((noise.square().mean(0) / 3.0)[torch.from_numpy(region)].mean())
    for octave in range(len(grain) - 1):
        grain[len(grain) - 2 - octave] = variance * 0.75 * 0.25**octave
    gains = np.sqrt((photographed - grain - albedo).clip(0.0) / relief.clip(1e-12))
    gains = gains.clip(settings.least, settings.most)
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
