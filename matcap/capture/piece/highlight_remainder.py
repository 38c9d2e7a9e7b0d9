"""Texels around the mirror point whose albedo still has the flash's highlight.

What the fitted lobe misses of a highlight is put into albedo: a white spot, or a ring. A material
does not know where the flash was, so the mean of log albedo over a ring around the mirror point is
compared with the means over equal rings around other centres. Rings that stand out only far from
the mirror point are shading. A narrow core may lie off the fitted mirror point, or be long: discs
near it that stand out more than any elsewhere belong to the highlight too.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.photo.shrink import area_averaged

Floats = NDArray[np.float32]


_CELLS = 128  # along the long side, over which log albedo is averaged; finer detail is texture
_WIDTH = 2  # of a ring, cells
_WIDEST = 20  # radius of the largest ring, cells; wider discs are shading, which `flatten` removes
_MISSED = 2  # rings in a row that do not stand out, at which the disc ends
_AROUND = 6  # width of the ring around the largest, cells
_INSIDE = 0.9  # least share of a ring inside the picture, at other centres
_NEAR = 12  # farthest centre of a disc of the highlight from the mirror point, cells
_UNUSUAL = 4.0  # deviations from the mean over other centres at which a ring stands out


def remaining_highlight(
    albedo: Floats, known: NDArray[np.bool_], distance: Floats
) -> NDArray[np.bool_]:
    """(H, W) bool: the disc around the mirror point up to the last ring that stands out, before two
    that do not, and small discs near it that stand out more than any elsewhere.

    Args:
        albedo: (C, H, W) diffuse albedo, in (0, 1].
        known: (H, W) bool, texels of the photograph, clipped ones included.
        distance: (H, W) distance from the mirror point, texels.
    """
    step = max(1, max(known.shape) // _CELLS)
    size = (known.shape[1] // step, known.shape[0] // step)
    log = np.log(np.maximum(albedo, 1e-3)).mean(0) * known
    total, share, distances = (
        area_averaged(plane, size) for plane in (log, known.astype(np.float32), distance / step)
    )
    surroundings = _ring_means(total, share, _WIDEST, _WIDEST + _AROUND)
    rings = [_unusual(total, share, surroundings, distances, i) for i in range(0, _WIDEST, _WIDTH)]
    centre = np.unravel_index(int(distances.argmin()), distances.shape)
    radius = _radius([float(ring[centre]) for ring in rings]) if distances[centre] <= 1.0 else 0
    discs = np.nan_to_num(rings[0])
    spots = (distances <= _NEAR) & (discs > discs[distances > _WIDEST].max(initial=_UNUSUAL))
    grown = cv2.dilate(spots.astype(np.uint8), np.ones((2 * _WIDTH + 1,) * 2, np.uint8))
    texels = cv2.resize(grown, known.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(texels | ((distance < (radius + 1) * step) & (radius > 0)))


def _radius(unusual: list[float]) -> int:
    """Outer radius in cells of the last ring that stands out, before two that do not; or 0."""
    radius = missed = 0
    for number, contrast in enumerate(unusual):
        if contrast > _UNUSUAL:
            radius, missed = (number + 1) * _WIDTH, 0
        elif np.isfinite(contrast):
            missed += 1
            if missed == _MISSED:
                break
    return radius


def _unusual(
    total: Floats, share: Floats, surroundings: Floats, distances: Floats, inner: int
) -> Floats:
    """(h, w) how far the contrast of the ring around each cell is from its mean over those far from
    the mirror point, in their standard deviations; NaN where it is unknown.

    Args:
        total: (h, w) sums of log albedo over cells.
        share: (h, w) known share of the cells.
        surroundings: (h, w) mean over the ring around the largest disc, NaN where unknown.
        distances: (h, w) distance of the cells from the mirror point, cells.
        inner: inner radius of the ring, cells.
    """
    outer = inner + _WIDTH
    contrast = _ring_means(total, share, inner, outer) - surroundings
    others = contrast[np.isfinite(contrast) & (distances > _WIDEST + outer)]
    if len(others) < 16:
        return np.full_like(contrast, np.nan)
    return np.abs((contrast - others.mean()) / (others.std() + 1e-3)).astype(np.float32)


def _ring_means(total: Floats, share: Floats, inner: int, outer: int) -> Floats:
    """(h, w) means over the ring around each cell; NaN where much of it is outside the picture."""
    offsets = np.arange(-outer, outer + 1)
    radius = np.hypot(offsets, offsets[:, None])
    ring = ((radius >= inner) & (radius < outer)).astype(np.float32)
    sums, counts = (
        cv2.filter2D(plane, -1, ring, borderType=cv2.BORDER_CONSTANT) for plane in (total, share)
    )
    return np.where(counts > _INSIDE * ring.sum(), sums / np.maximum(counts, 1e-6), np.nan)
