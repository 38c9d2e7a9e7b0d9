"""Places whose texture departs from the rest by a trend across the exemplar.

The flash shows relief along its own direction only, less of it far from its mirror point: relief
is combed one way at the left of the photograph and another at its top. Patches from all sides make
a quilt under any other light. A stationary material has no such trend, so what departs by one has a
penalty; a material's own variation, as of stains, is no smooth function of place and has none.

Features of a place are the logarithm of the contrast and the orientation of the exemplar, shaded
from the left and from the top. Their trend is a polynomial of place, shrunk by its F ratio.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import SLOPES
from matcap.example.grids import COST_BITS

# Trends of texture; docs/notes/field.md.
_DEGREE = 4  # of the polynomial: orientation around a mirror point is quadratic near to it
_LIGHTS = ((-0.86, 0.0, 0.51), (0.0, 0.86, 0.51))  # unit vectors, y upwards
_DARKEST, _GRAZING = 1e-4, 0.05  # lower limits of albedo and of the cosine to the light
_AROUND = 16.0  # texels, standard deviation of local averages, of contrast and of its high-pass
_INDEPENDENT = 56  # texels between independent local averages, 2 sqrt(pi) deviations
_CHANCE = 2.0  # F ratio up to which a trend may be chance
# Change of log contrast, and of the orientation's components, that the eye sees between patches.
_VISIBLE = (0.12, 0.15, 0.15)
_FREE = 0.3  # share of the known places that has no penalty, those nearest to each other
_LEAST = 0.5  # departure without a penalty, in visible changes
_SLOPE, _MOST = 0.5, 60.0  # departure beyond those at which the penalty is largest; its value
_THINNED = 8  # squares between the places that are compared

Floats = NDArray[np.float32]


def trend_penalty(planes: Floats, known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Penalty of the squares of an exemplar that depart from most by a trend.

    Args:
        planes: (PLANES, H, W) of the exemplar (features.planes_of).
        known: (rows, columns) whether a square of 2^COST_BITS texels may be shown at all.
    """
    trend = _trend(_local_features(planes, known.shape)) / np.tile(_VISIBLE, 2)[:, None, None]
    some = trend[:, ::_THINNED, ::_THINNED].reshape(len(trend), -1).T
    some = some[known[::_THINNED, ::_THINNED].ravel()]
    if not len(some):
        return np.zeros(known.shape)
    distances = np.sqrt(np.square(some[:, None] - some[None]).mean(axis=2))
    nearest = np.quantile(distances, _FREE, axis=1)
    middle = some[int(nearest.argmin())][:, None, None]
    departure = np.sqrt(np.square(trend - middle).mean(axis=0))
    free = max(_LEAST, float(nearest.min()))
    return np.asarray(_MOST * ((departure - free) / _SLOPE).clip(0.0, 1.0), np.float64)


def _local_features(planes: Floats, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(6, rows, columns): log contrast and two components of orientation, by light.

    With J the local mean of the gradient's outer product, log sqrt(trace J),
    (J_xx - J_yy) / trace J and 2 J_xy / trace J.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    tone = np.log(np.square(planes[:3]).mean(axis=0).clip(_DARKEST))
    right, down = planes[SLOPES]
    upright = 1.0 / np.sqrt(1.0 + np.square(right) + np.square(down))
    size, deviation = shape[::-1], _AROUND * shape[1] / planes.shape[2]

    def local(product: Floats) -> Floats:
        thin = cv2.resize(product, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(thin, (0, 0), deviation), np.float32)

    features = []
    for x, y, z in _LIGHTS:
        cosine = ((z - x * right + y * down) * upright).clip(_GRAZING)
        log = np.asarray(tone + np.log(cosine), np.float32)
        fine = cv2.GaussianBlur(log, (0, 0), 1.0) - cv2.GaussianBlur(log, (0, 0), _AROUND)
        along_y, along_x = np.gradient(fine)
        xx, yy, xy = (local(p) for p in (along_x**2, along_y**2, along_x * along_y))
        total = xx + yy + np.float32(1e-9)
        features += [0.5 * np.log(total), (xx - yy) / total, 2.0 * xy / total]
    return np.stack(features).astype(np.float64)


def _trend(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares polynomials of place, times 1 - _CHANCE / F, F their F ratio."""
    count, rows, columns = features.shape
    y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    design = np.stack([(x**i * y**j).ravel() for i, j in powers], axis=1)
    basis = np.linalg.qr(design)[0]
    flat = features.reshape(count, -1).T
    fitted = basis @ (basis.T @ flat)
    terms, squares = len(powers) - 1, (_INDEPENDENT >> COST_BITS) ** 2
    free = max(rows * columns / squares - terms - 1.0, 1.0)
    left = np.square(flat - fitted).mean(axis=0) / free
    ratio = fitted.var(axis=0) / terms / np.maximum(left, 1e-12)
    kept = (1.0 - _CHANCE / np.maximum(ratio, _CHANCE)) * fitted
    return np.asarray(kept.T.reshape(features.shape), np.float64)
