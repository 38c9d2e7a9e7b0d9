"""Relief of one strength everywhere: a stationary sample's slopes do not know where the flash was.

One flash shows the slope along its own light and hardly the other, and under its foot neither; a
network shrinks what it cannot see. Relit, such relief shows a bull's-eye: weak in the middle,
ridges running around it. So band by band the slopes are given the covariance that the photograph
tells (strengths.py) in every neighbourhood: whitened by their own there, coloured by the wanted,
and made a height again.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.believed import believed
from matcap.capture.piece.integrate import integrate, steps
from matcap.capture.piece.smooth import coarse_smoothed, enlarged, split
from matcap.capture.piece.strengths import Strengths, slope_strengths
from matcap.capture.piece.tuned import STRENGTH

Height = NDArray[np.float32]
Doubles = NDArray[np.float64]


def equalise(height: Height, strengths: Strengths | None) -> Height:
    """A height (H, W) in texels whose slopes are as strong everywhere as the photograph says.

    Args:
        height: as the network gives it.
        strengths: of the photograph; None keeps each band's own on the whole.
    """
    # What is slower than all bands is the bowl that a highlight's error leaves, not relief.
    bands = split(height)[:-1]
    with ThreadPoolExecutor() as pool:
        even = np.stack(list(pool.map(_evened, bands)))
    wanted = _wanted(height, strengths)
    factors: Doubles = np.ones(len(even))
    most = STRENGTH.strongest
    for _ in range(STRENGTH.even_rounds):
        drawn = _energies(_sum(factors, even))
        factors = (factors * np.sqrt(wanted / drawn)).clip(1.0 / most, most)
    return _sum(factors, even)


def _sum(factors: Doubles, bands: Height) -> Height:
    """(H, W) bands (N, H, W) times a factor each, added; in one order, so that bits are kept."""
    return np.asarray(np.einsum("n,nhw->hw", factors, bands, optimize=False), np.float32)


def _evened(band: Height) -> Height:
    """A band whose slopes have in every neighbourhood the covariance they have on the whole."""
    x, y = slopes(band)
    gain = _gain(_covariance(x, y), _own(x, y), band.shape)
    across, down = steps(band)
    # One slope is between texels of a row and the other of a column; y points up.
    xx, yy = _between(gain[0], 1), _between(gain[2], 0)
    crossed_x = _between(gain[1], 1) * _between(y, 1)
    crossed_y = _between(gain[1], 0) * _between(x, 0)
    return integrate(xx * across + crossed_x, yy * down - crossed_y)


def _between(plane: Height, axis: int) -> Height:
    """Means of neighbours along an axis."""
    first, last = np.delete(plane, -1, axis), np.delete(plane, 0, axis)
    return np.asarray((first + last) / 2.0, np.float32)


def _energies(height: Height) -> Doubles:
    """(len(BANDS),) of slopes."""
    return np.square(slope_strengths(height)).sum(1).clip(STRENGTH.least_slope**2)


def _wanted(height: Height, strengths: Strengths | None) -> Doubles:
    """(len(BANDS),) energies as the photograph says, as far as its word is to be trusted."""
    drawn = _energies(height)
    if strengths is None:
        return drawn
    return believed(drawn, np.square(strengths.slope).sum(1), strengths.doubt)


def _own(x: Height, y: Height) -> Doubles:
    """(3,) xx, xy and yy of a band's slopes over the whole picture.

    What a flash in the middle does to directions cancels there; what is left is the material's.
    """
    return np.array([np.square(x).mean(), (x * y).mean(), np.square(y).mean()], np.float64)


def _covariance(x: Height, y: Height) -> Doubles:
    """(3, h, w) xx, xy and yy of slopes in every neighbourhood, on a coarser grid."""
    products = (x * x, x * y, y * y)
    return np.stack([coarse_smoothed(p, STRENGTH.even_around) for p in products]).astype(np.float64)


def _gain(local: Doubles, wanted: Doubles, shape: tuple[int, ...]) -> Height:
    """(3, H, W) the symmetric matrix that gives slopes of one covariance another, clipped.

    The one of all such matrices that moves slopes least: W = L^-1/2 (L^1/2 T L^1/2)^1/2 L^-1/2.
    """
    half, inverse = _roots(local)
    target = np.broadcast_to(wanted[:, None, None], local.shape)
    middle, _ = _roots(_sandwich(half, target))
    gain = _sandwich(inverse, middle)
    values, vectors = _eigen(gain)
    gain = _compose(np.clip(values, STRENGTH.even_least, STRENGTH.even_most), vectors)
    return np.stack([enlarged(g.astype(np.float32), shape) for g in gain])


def _eigen(matrix: Doubles) -> tuple[Doubles, Doubles]:
    """Eigenvalues (2, ...) and the first one's direction (2, ...) of [xx, xy, yy] (3, ...)."""
    xx, xy, yy = matrix
    middle, apart = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return np.stack([middle + apart, middle - apart]), np.stack([np.cos(angle), np.sin(angle)])


def _compose(values: Doubles, vectors: Doubles) -> Doubles:
    """The inverse of _eigen."""
    c, s = vectors
    a, b = values
    return np.stack([a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c])


def _roots(matrix: Doubles) -> tuple[Doubles, Doubles]:
    """Square root and its inverse."""
    values, vectors = _eigen(matrix)
    values = np.sqrt(np.maximum(values, STRENGTH.least_slope**2))
    return _compose(values, vectors), _compose(1.0 / values, vectors)


def _sandwich(outer: Doubles, inner: Doubles) -> Doubles:
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
