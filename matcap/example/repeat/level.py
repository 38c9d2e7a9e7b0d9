"""Removes low frequencies of colour and gloss: in a tiling they would show as a chequer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import COLOURED, SPECULAR, Floats
from matcap.example.repeat.tuned import REPEAT

_BLACK = 1e-3  # of albedo and F0: what is darker is as dark
_ORDERS = np.arange(REPEAT.slow + 1)


def levelled(maps: Floats) -> Floats:
    """Stacked maps (6 or 8, H, W) without the slow waves nearest to the medians of their parts.

    Albedo and F0 are divided by theirs, and roughness is moved; means stay. Medians, so that what
    stands in one place alone, a stain, is not taken for a slope. Where F0 has a colour, metal and
    what is none are each taken from their own median: a part with a little more rust than metal is
    no darker for that.
    """
    flattened = maps.copy()
    metal = maps[SPECULAR].max(axis=0) > REPEAT.metal
    kinds = (metal, ~metal) if len(maps[SPECULAR]) == COLOURED else ()
    # All but the height, whose slope closing takes away; light multiplies albedo and F0.
    roughness = len(maps) - 2
    for index in range(roughness + 1):
        if index < roughness:
            logs = np.log(np.maximum(maps[index], _BLACK))
            flattened[index] *= np.exp(-_slow(_of_one_kind(logs, kinds)))
        else:
            flattened[index] -= _slow(_of_one_kind(maps[index], kinds))
    np.clip(flattened[:-1], 0.0, 1.0, out=flattened[:-1])
    return flattened


def _of_one_kind(plane: Floats, kinds: tuple[NDArray[np.bool_], ...]) -> Floats:
    """(H, W) a plane less the median of its kind, at every texel; itself where there are none."""
    if not kinds:
        return plane
    flattened = plane.copy()
    for kind in kinds:
        if kind.any():
            flattened[kind] -= np.median(plane[kind])
    return flattened


def _slow(plane: Floats) -> Floats:
    """(H, W) the slow waves nearest to medians of parts, of zero mean."""
    parts = [
        [part for part in np.array_split(np.arange(side), REPEAT.cells) if part.size]
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
    amounts[_ORDERS[:, None] + _ORDERS[None, :] > REPEAT.slow] = 0.0
    slow = ends[0] @ amounts @ ends[1].T
    return (slow - slow.mean()).astype(np.float32)


def _waves(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, orders): half waves over a side, at places in [0, 1]."""
    return np.cos(np.pi * places[:, None] * _ORDERS[None, :])
