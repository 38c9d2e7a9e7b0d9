"""Relief of one strength everywhere: a stationary sample's slopes do not know where the flash was.

One flash shows the slope along its own light and hardly the other, and under its foot neither; a
network shrinks what it cannot see. Relit, such relief shows a bull's-eye: weak in the middle,
ridges running around it. So band by band the slopes are given the covariance that the photograph
tells (strengths.py) in every neighbourhood: whitened by their own there, coloured by the wanted,
and made a height again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.capture.exemplar.integrate import integrate
from matcap.capture.exemplar.smooth import BLURS, coarse_smoothed, enlarged, split
from matcap.capture.exemplar.strengths import Strengths, slope_strengths

Height = NDArray[np.float32]
Array = NDArray[np.float64]

# Which of strengths.BANDS each band is about.
_ABOUT = ((3, 4), (2,), (1,), (0,), (0,), (0,))
_AROUND = 64.0  # texels: deviation of a neighbourhood
_GAINS = (0.25, 5.0)  # slopes are not weakened or strengthened more than this
_TRUSTED = 0.8  # of the photograph's own word, where it stands out clearly
_LEAST = 1e-4  # slope


def equalise(height: Height, strengths: Strengths | None) -> Height:
    """A height (H, W) in texels whose slopes are as strong everywhere as the photograph says.

    Args:
        height: as the network gives it.
        strengths: of the photograph; None keeps each band's own on the whole.
    """
    even_x, even_y = np.zeros_like(height), np.zeros_like(height)
    wanted = _wanted(height, strengths)
    # What is slower than all bands is the bowl that a highlight's error leaves, not relief.
    for index, band in enumerate(split(height)[:-1]):
        x, y = slopes(band)
        around = max(_AROUND, 2.0 * BLURS[index])
        gain = _gain(_covariance(x, y, around), wanted[index] * _own(x, y), height.shape)
        even_x += gain[0] * x + gain[1] * y
        even_y += gain[1] * x + gain[2] * y
    return integrate(even_x, even_y)


def _wanted(height: Height, strengths: Strengths | None) -> list[float]:
    """What each band's energy must be multiplied by to be what the photograph says."""
    if strengths is None:
        return [1.0] * len(_ABOUT)
    found, told = np.square(slope_strengths(height)), np.square(strengths.slope)
    factors = []
    for bands in _ABOUT:
        here = told[list(bands)].sum()
        trust = (strengths.trust * told)[list(bands)].sum() / max(here, 1e-12)
        ratio = max(here, 1e-8) / max(found[list(bands)].sum(), 1e-8)
        factors.append(float(ratio ** (_TRUSTED * trust)))
    return factors


def _own(x: Height, y: Height) -> Array:
    """(3,) xx, xy and yy of a band's slopes over the whole picture.

    What a flash in the middle does to directions cancels there; what is left is the material's.
    """
    return np.array([np.square(x).mean(), (x * y).mean(), np.square(y).mean()], np.float64)


def _covariance(x: Height, y: Height, deviation: float) -> Array:
    """(3, h, w) xx, xy and yy of slopes in every neighbourhood, on a coarser grid."""
    products = (x * x, x * y, y * y)
    return np.stack([coarse_smoothed(p, deviation) for p in products]).astype(np.float64)


def _gain(local: Array, wanted: Array, shape: tuple[int, ...]) -> Height:
    """(3, H, W) the symmetric matrix that gives slopes of one covariance another, clipped.

    The one of all such matrices that moves slopes least: W = L^-1/2 (L^1/2 T L^1/2)^1/2 L^-1/2.
    """
    half, inverse = _roots(local)
    target = np.broadcast_to(wanted[:, None, None], local.shape)
    middle, _ = _roots(_sandwich(half, target))
    gain = _sandwich(inverse, middle)
    values, vectors = _eigen(gain)
    gain = _compose(np.clip(values, *_GAINS), vectors)
    return np.stack([enlarged(g.astype(np.float32), shape) for g in gain])


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (2, ...) and the first one's direction (2, ...) of [xx, xy, yy] (3, ...)."""
    xx, xy, yy = matrix
    middle, apart = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return np.stack([middle + apart, middle - apart]), np.stack([np.cos(angle), np.sin(angle)])


def _compose(values: Array, vectors: Array) -> Array:
    """The inverse of _eigen."""
    c, s = vectors
    a, b = values
    return np.stack([a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c])


def _roots(matrix: Array) -> tuple[Array, Array]:
    """Square root and its inverse."""
    values, vectors = _eigen(matrix)
    values = np.sqrt(np.maximum(values, _LEAST**2))
    return _compose(values, vectors), _compose(1.0 / values, vectors)


def _sandwich(outer: Array, inner: Array) -> Array:
    """Outer inner outer, all symmetric."""
    a, b, d = outer
    p, q, r = inner
    left = (a * p + b * q, a * q + b * r, b * p + d * q, b * q + d * r)
    return np.stack(
        [left[0] * a + left[1] * b, left[0] * b + left[1] * d, left[2] * b + left[3] * d]
    )


def slopes(height: Height) -> tuple[Height, Height]:
    """(H, W) slopes along x and along y, which points up."""
    down, across = np.gradient(height)
    return np.asarray(across, np.float32), np.asarray(-down, np.float32)
