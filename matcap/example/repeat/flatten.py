"""Removes low frequencies of albedo, F0 and roughness, which make a tiling look periodic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import COLOURED, SPECULAR, Floats

# The seamless tile; docs/notes/field.md.

# Parts a side whose medians low frequencies are fitted to. Fewer are less affected by stains,
# and resolve low frequencies less.
_CELLS = 16
# Half periods a side up to which frequencies are removed. More make repeats less visible, and
# remove more of a large pattern.
_SLOW = 4
# F0 of the brightest channel above which a texel is metal, where F0 has a colour. Gems have up
# to 0.17, metals 0.4 and more.
_METAL = 0.25

_BLACK = 1e-3  # lower limit of albedo and F0 in logarithms
_ORDERS = np.arange(_SLOW + 1)


def flatten(maps: Floats) -> Floats:
    """Stacked maps (6 or 8, H, W) without their low frequencies.

    Low frequencies are cosines of up to _SLOW half periods a side, fitted to the medians of
    _CELLS^2 parts; medians, so that a stain has little effect. Albedo and F0 are divided by
    them, roughness is reduced by them; means are kept. Where F0 has a colour, the median of metal,
    or of dielectric, is subtracted first, so that a part with more rust than metal does not count
    as darker.
    """
    flattened = maps.copy()
    metal = maps[SPECULAR].max(axis=0) > _METAL
    classes = (metal, ~metal) if len(maps[SPECULAR]) == COLOURED else ()
    # All maps but the height, whose mean slope join.py removes.
    roughness = len(maps) - 2
    for index in range(roughness + 1):
        if index < roughness:
            logs = np.log(np.maximum(maps[index], _BLACK))
            flattened[index] *= np.exp(-_slow(_less_class_medians(logs, classes)))
        else:
            flattened[index] -= _slow(_less_class_medians(maps[index], classes))
    np.clip(flattened[:-1], 0.0, 1.0, out=flattened[:-1])
    return flattened


def _less_class_medians(plane: Floats, classes: tuple[NDArray[np.bool_], ...]) -> Floats:
    """(H, W) plane less the median of each texel's material class, given as masks."""
    residual = plane.copy()
    for mask in classes:
        if mask.any():
            residual[mask] -= np.median(plane[mask])
    return residual


def _slow(plane: Floats) -> Floats:
    """(H, W) low frequencies of a plane, of zero mean."""
    parts = [
        [part for part in np.array_split(np.arange(side), _CELLS) if part.size]
        for side in plane.shape
    ]
    rows, columns = parts
    medians = np.array(
        [[np.median(plane[r[0] : r[-1] + 1, c[0] : c[-1] + 1]) for c in columns] for r in rows]
    )
    middles = [
        [(part.mean() + 0.5) / side for part in some]
        for some, side in zip(parts, plane.shape, strict=True)
    ]
    down, across = (_waves(np.array(some)) for some in middles)
    amounts = np.linalg.pinv(down) @ medians @ np.linalg.pinv(across).T
    ends = [_waves((np.arange(side) + 0.5) / side) for side in plane.shape]
    amounts[_ORDERS[:, None] + _ORDERS[None, :] > _SLOW] = 0.0
    slow = ends[0] @ amounts @ ends[1].T
    return (slow - slow.mean()).astype(np.float32)


def _waves(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, orders) cosines of 0, 1, ... half periods a side, at positions in [0, 1]."""
    return np.cos(np.pi * places[:, None] * _ORDERS[None, :])
