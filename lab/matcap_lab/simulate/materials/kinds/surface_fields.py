"""Fields of a surface (albedo, roughness, height) of each kind, and the finish common to all.

A kind draws its parameters from one generator and its realisation from the canvas, and marks its
cavities. The finish darkens and roughens these, adds fine grain and scales the relief to a slope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.materials.assemble import assemble
from matcap_lab.simulate.materials.draws import Draws
from matcap_lab.simulate.procedural import Canvas, Raster, Spectrum, bumps, noise

# Ranges of real surfaces: fresh charcoal to snow, polished stone to chalk.
_ALBEDO = (0.01, 0.9)
_ROUGHNESS = (0.08, 0.95)
# Deviation of the blur that rounds edges, plane units: 0.3 mm where 2 units are 25 cm.
_EDGE = 0.0025


@dataclass(frozen=True)
class SurfaceFields:
    """Fields of one realisation; each broadcasts to (H, W), diffuse to (3, H, W)."""

    diffuse: Raster
    """Albedo, linear Rec.709."""
    specular: Raster | float
    """F0; (3, H, W), linear Rec.709, where it has a colour."""
    roughness: Raster | float
    """Perceptual roughness."""
    height: Raster
    """Height in any unit; the finish scales it to a slope."""
    cavity: Raster
    """0 on tops to 1 in grooves."""


# (canvas, parameters) to a realisation.
SurfaceFunction = Callable[[Canvas, Draws], SurfaceFields]


@dataclass(frozen=True)
class Kind:
    """A family of materials."""

    surface: SurfaceFunction
    """Realises one of them."""
    slopes: tuple[float, float]
    """Range of the relief's root mean square slope."""
    grain: tuple[float, float] = (0.004, 0.06)
    """Range of the fine grain's root mean square slope."""
    darkest: float = _ALBEDO[0]
    """Least diffuse albedo."""


def finish(canvas: Canvas, kind: Kind, depth: float, rng: Draws) -> tuple[MapSet, Raster]:
    """Maps of a realisation, and (H, W) its relief, `depth` times the height, without grain.

    Cavities are darker, and rougher, in 3 of 4 materials each, else the opposite; neither in 15 %.
    """
    tied = not rng.chance(0.15)
    coarse = rng.log_uniform(0.01, 0.06)
    # Of log albedo and of roughness, from open surface to cavity.
    darkening = tied * (1.0 if rng.chance(0.75) else -0.4) * rng.log_uniform(0.08, 1.4)
    roughening = tied * (1.0 if rng.chance(0.75) else -0.6) * rng.log_uniform(0.02, 0.35)
    spectrum = Spectrum(coarse, min(rng.log_uniform(0.005, 0.012), 0.7 * coarse), rng.random())
    # Standard deviations of log albedo and of roughness by grain; of log albedo over features.
    by_grain, wear = rng.log_uniform(0.01, 0.16), rng.log_uniform(0.003, 0.05)
    by_drift = rng.log_uniform(0.01, 0.12)
    steepness = rng.log_uniform(*kind.grain)
    surface = kind.surface(canvas, rng)
    grain = noise(canvas, "grain", spectrum)
    drift = noise(canvas, "drift", Spectrum(0.16, 0.05))
    tone = np.exp(by_grain * grain + by_drift * drift - darkening * surface.cavity)
    # Steps are smoothed, as by wear and the lens's blur.
    height = np.ascontiguousarray(np.broadcast_to(surface.height, grain.shape))
    rounded = cv2.GaussianBlur(height, (0, 0), _EDGE / canvas.texel_size)
    relief = depth * np.asarray(rounded, np.float64)
    rough = surface.roughness + roughening * surface.cavity + wear * grain
    maps = assemble(
        canvas,
        np.clip(surface.diffuse * tone, kind.darkest, _ALBEDO[1]),
        surface.specular,
        np.clip(rough, *_ROUGHNESS),
        relief + steepness * bumps(canvas, "grain", spectrum),
        min(kind.darkest, _ALBEDO[0]),
    )
    return maps, relief
