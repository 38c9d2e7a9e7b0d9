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
from matcap.lab.simulate.materials.assemble import assemble
from matcap.lab.simulate.materials.draws import Draws
from matcap.lab.simulate.procedural import Canvas, Raster, Spectrum, bumps, noise

# Ranges of real surfaces: fresh charcoal to snow, polished stone to chalk.
_ALBEDO = (0.01, 0.9)
_ROUGHNESS = (0.08, 0.95)
_EDGE = (
    0.0025  # plane units, deviation of the blur that rounds edges: 0.3 mm where 2 units are 25 cm
)


@dataclass(frozen=True)
class SurfaceFields:
    """Fields of one realisation; each broadcasts to (H, W), diffuse to (3, H, W).

    Attributes:
        diffuse: albedo, linear Rec.709.
        specular: F0; (3, H, W), linear Rec.709, where it has a colour.
        roughness: perceptual.
        height: of any scale; the finish scales it to a slope.
        cavity: 0 on tops to 1 in grooves.
    """

    diffuse: Raster
    specular: Raster | float
    roughness: Raster | float
    height: Raster
    cavity: Raster


# (canvas, parameters) to a realisation.
Lay = Callable[[Canvas, Draws], SurfaceFields]


@dataclass(frozen=True)
class Kind:
    """A family of materials.

    Attributes:
        lay: realises one of them.
        slopes: range of the relief's root mean square slope.
        grain: range of the fine grain's root mean square slope.
        darkest: least diffuse albedo.
    """

    lay: Lay
    slopes: tuple[float, float]
    grain: tuple[float, float] = (0.004, 0.06)
    darkest: float = _ALBEDO[0]


@dataclass(frozen=True)
class _Finish:
    darkening: float  # of the logarithm of albedo, from open surface to cavity
    roughening: float  # likewise of roughness
    spectrum: Spectrum
    tone: float  # standard deviation of the logarithm of albedo by grain
    wear: float  # standard deviation of roughness by grain
    drift: float  # likewise of the logarithm of albedo, over a few features


def finish(canvas: Canvas, kind: Kind, depth: float, parameters: Draws) -> tuple[MapSet, Raster]:
    """Maps of a realisation, and (H, W) its relief, `depth` times the height, without grain."""
    how = _draw_finish(parameters)
    steepness = parameters.log_uniform(*kind.grain)
    surface = kind.lay(canvas, parameters)
    grain = noise(canvas, "grain", how.spectrum)
    drift = noise(canvas, "drift", Spectrum(0.16, 0.05))
    tone = np.exp(how.tone * grain + how.drift * drift - how.darkening * surface.cavity)
    relief = depth * _rounded(canvas, np.broadcast_to(surface.height, grain.shape))
    rough = surface.roughness + how.roughening * surface.cavity + how.wear * grain
    maps = assemble(
        canvas,
        np.clip(surface.diffuse * tone, kind.darkest, _ALBEDO[1]),
        surface.specular,
        np.clip(rough, *_ROUGHNESS),
        relief + steepness * bumps(canvas, "grain", how.spectrum),
        min(kind.darkest, _ALBEDO[0]),
    )
    return maps, relief


def _rounded(canvas: Canvas, height: Raster) -> Raster:
    """Height with steps smoothed, as by wear and the lens's blur."""
    deviation = _EDGE / canvas.texel_size
    return np.asarray(cv2.GaussianBlur(np.ascontiguousarray(height), (0, 0), deviation))


def _draw_finish(rng: Draws) -> _Finish:
    """Cavities darker, and rougher, in 3 of 4 materials each, else the opposite; none in 15 %."""
    tied = not rng.chance(0.15)
    coarse = rng.log_uniform(0.01, 0.06)
    return _Finish(
        darkening=tied * (1.0 if rng.chance(0.75) else -0.4) * rng.log_uniform(0.08, 1.4),
        roughening=tied * (1.0 if rng.chance(0.75) else -0.6) * rng.log_uniform(0.02, 0.35),
        spectrum=Spectrum(coarse, min(rng.log_uniform(0.005, 0.012), 0.7 * coarse), rng.random()),
        tone=rng.log_uniform(0.01, 0.16),
        wear=rng.log_uniform(0.003, 0.05),
        drift=rng.log_uniform(0.01, 0.12),
    )
