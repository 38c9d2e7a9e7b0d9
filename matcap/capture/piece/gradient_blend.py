"""Gradient-domain composition of maps whose texels are copied from elsewhere [perez2003].

Texel p shows v(p) = m(s(p)), with s(p) = p where the maps are kept. The composition u minimises,
over the texels that are not kept,

    sum_pq (u(q) - u(p) - g(p, q))^2 + sum_p (u(p) - v(p))^2 / reach^2,

over pairs of neighbours p, q. g(p, q) is the mean of m(s(p) + q - p) - m(s(p)) and
m(s(q)) - m(s(q) + p - q), over those whose texels are kept ones. Within a block it is the gradient
of the maps; at a seam it has no step, and the two sides converge within `reach`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Sources = NDArray[np.int64]

_ITERATIONS = 400
_TOLERANCE = 1e-3  # of the residual's norm, over that at the start


def composed(maps: Floats, source: Sources, free: NDArray[np.bool_], reach: float) -> Floats:
    """Maps copied from their sources without steps at seams.

    Args:
        maps: (C, H, W) m.
        source: (2, H, W) row and column of s(p); the texel itself where it is not free.
        free: (H, W) texels that are not kept.
        reach: texels over which the two sides of a seam converge.

    Returns:
        (C, H, W) u; m where not free.
    """
    if not free.any():
        return maps
    rows, columns = (np.flatnonzero(free.any(axis=axis)) for axis in (1, 0))
    box = tuple(
        slice(max(0, line[0] - 1), min(side, line[-1] + 2))
        for line, side in zip((rows, columns), free.shape, strict=True)
    )
    inside, here = free[box], source[:, *box]
    copied = maps[:, here[0], here[1]].astype(np.float64)
    wanted = np.zeros_like(copied)
    for axis in (0, 1):
        first, last = _ends(axis)
        step = np.array([[[1 - axis]], [[axis]]])
        before, after = copied[:, *first], copied[:, *last]
        ahead, has_ahead = _at(maps, here[:, *first] + step, free)
        behind, has_behind = _at(maps, here[:, *last] - step, free)
        drawn = has_ahead * (ahead - before) + has_behind * (after - behind)
        known = has_ahead + has_behind
        mismatch = np.where(known > 0.0, after - before - drawn / np.maximum(known, 1.0), 0.0)
        wanted[:, *first] += mismatch
        wanted[:, *last] -= mismatch
    result = maps.copy()
    shown = copied + _solved(wanted * inside, inside, reach)
    result[:, *box] = np.where(inside, shown, maps[:, *box])
    return result


def _solved(right: NDArray[np.float64], free: NDArray[np.bool_], reach: float) -> Floats:
    """Conjugate gradients for c in (L + reach^-2) c = right, 0 where not free, (C, h, w) each.

    Free texels alone are stored, their channels together; neighbours that are not free share a 0.
    """
    count, one = int(free.sum()), np.float32
    number = np.full((free.shape[0] + 2, free.shape[1] + 2), count, np.int64)
    number[1:-1, 1:-1][free] = np.arange(count)
    in_box = np.pad(np.ones(free.shape, one), 1)
    within, before, after = slice(1, -1), slice(None, -2), slice(2, None)
    sides = ((before, within), (after, within), (within, before), (within, after))
    neighbours = [number[side][free] for side in sides]
    degree = np.stack([in_box[side][free] for side in sides], axis=1).sum(1, keepdims=True)
    diagonal = degree + one(reach**-2)
    residual = np.ascontiguousarray(right[:, free].T, one)
    padded = np.concatenate([residual, np.zeros((1, len(right)), one)])
    direction, solution = padded[:count], np.zeros_like(residual)
    image, some = np.empty_like(residual), np.empty_like(residual)
    energy = start = float(np.vdot(residual, residual))
    for _ in range(_ITERATIONS):
        if energy <= _TOLERANCE**2 * start:
            break
        np.multiply(direction, diagonal, out=image)
        for each in neighbours:
            image -= np.take(padded, each, axis=0, out=some, mode="clip")
        length = one(energy / float(np.vdot(direction, image)))
        solution += np.multiply(direction, length, out=some)
        residual -= np.multiply(image, length, out=image)
        earlier, energy = energy, float(np.vdot(residual, residual))
        direction *= one(energy / earlier)
        direction += residual
    result = np.zeros(right.shape, one)
    result[:, free] = solution.T
    return result


def _ends(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """All but the last and all but the first line along an axis."""
    every, first, last = slice(None), slice(None, -1), slice(1, None)
    return ((first, every), (last, every)) if axis == 0 else ((every, first), (every, last))


def _at(maps: Floats, places: Sources, free: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """(C, h, w) maps at places (2, h, w), and (h, w) 1 where those are kept texels, else 0."""
    rows, columns = (np.clip(p, 0, side - 1) for p, side in zip(places, free.shape, strict=True))
    kept = (rows == places[0]) & (columns == places[1]) & ~free[rows, columns]
    return maps[:, rows, columns], kept.astype(np.float32)
