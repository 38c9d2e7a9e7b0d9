"""Relief along a grain, too fine or too faint to see, from the shape of the highlight.

Grooves of one direction widen a highlight across themselves. With the elongation

    e = log(length / width) exp(2 i angle)

of the photographed highlight and of the re-rendered one, the maps lack grooves across the direction
arg(e_photograph - e_rendered) / 2. They are added only if the texture has a grain of that
direction: leather over a curved seat has an elongated highlight, too.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.capture.piece.noise import DARKEST
from matcap.flash.highlight import elongation, find_highlight, light_of
from matcap.flash.plane import Plane

# Least |e_photograph| and |e_photograph - e_rendered|: the length is 16 % over the width, or too
# short.
_LEAST_ELONGATION = 0.15
# Least coherence of the texture's gradients in that direction. Leathers have 0.2, woods and
# brushed paints 0.3 to 0.6.
_LEAST_COHERENCE = 0.25
_FINE, _COARSE = 1.0, 3.0  # texels, standard deviations of the blurs that bound the texture
_STRONGEST = 0.95  # quantile of the gradients that stronger ones, edges and specks, are limited to
_SLOPE = 0.06  # standard deviation of the slope across grooves, before glints scale it
_PERIOD, _OCTAVES = 3.0, 0.8  # texels, period of grooves, and its standard deviation in octaves
_LENGTH = 12.0  # texels, standard deviation of a groove's length


def across_grain(photograph: Plane, rendered: Callable[[], Tensor]) -> float | None:
    """Angle across grooves that the maps lack, from right to up, radians; None without any.

    Args:
        photograph: on the plane.
        rendered: radiance (3, H, W) of its maps; called if the photographed highlight is long.
    """
    seen = _elongation(photograph.linear)
    if seen is None or abs(seen) < _LEAST_ELONGATION:
        return None
    drawn = _elongation(rendered())
    if drawn is None or abs(missing := seen - drawn) < _LEAST_ELONGATION:
        return None
    grain = _grain(photograph)
    aligned = (grain * missing.conjugate()).real / abs(missing)
    return cmath.phase(grain) / 2.0 if aligned > _LEAST_COHERENCE else None


def grooves(size: tuple[int, int], across: float) -> Tensor:
    """(1, H, W) height, texels, of grooves whose slopes have a standard deviation of _SLOPE.

    Args:
        size: H, W.
        across: angle of the direction across the grooves, from right to up, radians.
    """
    white = np.random.default_rng(0).standard_normal(size)
    down, right = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None]
    over = right * math.cos(across) - down * math.sin(across)
    along = right * math.sin(across) + down * math.cos(across)
    octaves = np.log2(np.abs(over).clip(1e-6) * _PERIOD) / _OCTAVES
    lengths = 2.0 * math.pi * _LENGTH * along
    plane = np.fft.irfft2(np.fft.rfft2(white) * np.exp(-0.5 * (octaves**2 + lengths**2)), size)
    # Normals are made of the same differences.
    steepness = math.sqrt(sum(np.square(slope).mean() for slope in np.gradient(plane)))
    return torch.from_numpy((_SLOPE / steepness * plane).astype(np.float32))[None]


def _elongation(linear: Tensor) -> complex | None:
    """Elongation e of the highlight of a picture (3, H, W), 1 at clipping; None without one."""
    pixels = linear.clamp_max(1.0).permute(1, 2, 0).contiguous().numpy()
    light = light_of(pixels)
    highlight = find_highlight(light)
    return None if highlight is None else elongation(light, highlight)


def _grain(photograph: Plane) -> complex:
    """Coherence times exp(2 i angle) of the gradients of a photograph's texture."""
    if not photograph.valid.any():
        return 0.0
    plane = photograph.linear.clamp_min(DARKEST).log().mean(0).numpy()
    plane = cv2.GaussianBlur(plane, (0, 0), _FINE) - cv2.GaussianBlur(plane, (0, 0), _COARSE)
    down, right = (slope[photograph.valid.numpy()] for slope in np.gradient(plane))
    slope = right - 1j * down
    size = np.abs(slope).clip(1e-9)
    slope = slope * np.minimum(1.0, np.quantile(size, _STRONGEST) / size)
    return complex(np.square(slope).mean() / np.square(np.abs(slope)).mean())
