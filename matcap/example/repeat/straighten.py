"""Resampling of maps so that a lattice and a tile's shifts are straight."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Floats
from matcap.example.lattice import GRID, Frequency, PhasedLattice
from matcap.example.repeat.shifts import Shift

_TURN = 2.0**16
_BENT = 0.25  # texels: smaller displacements are not resampled


def unbent(maps: Floats, lattice: PhasedLattice, bits: int = 0) -> Floats:
    """Maps resampled so that their lattice is straight, of the same mean waves.

    The displacement is the least one that removes the phase offsets. Borders are cropped, so that
    the result is smaller.

    Args:
        maps: (C, H, W).
        lattice: of the maps, in texels 2^bits as large.
        bits: see lattice.
    """
    turns = lattice.phase_offsets / _TURN
    turns = turns - turns.mean(axis=(1, 2), keepdims=True)
    move = displacement(lattice.waves, turns) * 2.0**bits
    if np.abs(move).max() < _BENT:
        return maps
    height, width = maps.shape[1:]
    return _read_inside(maps, *sources(move, 1 << (GRID + bits), (width, height)))


def displacement(waves: Sequence[Frequency], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, rows, columns) the least move, x and y in texels, with phases straight at p + move(p).

    Args:
        waves: mean frequency vectors, cycles per texel.
        turns: (waves, rows, columns) phase offsets from these.
    """
    return np.asarray(np.einsum("dw,wyx->dyx", np.linalg.pinv(np.array(waves)), turns))


def sources(
    move: NDArray[np.float64], step: int, size: tuple[int, int], rounds: int = 1
) -> tuple[Floats, Floats]:
    """(H, W) x and y of the points p whose p + move(p) is each texel.

    Args:
        move: (2, rows, columns) texels, at every `step` texels.
        step: see move.
        size: (width, height) of the maps.
        rounds: of the fixed-point iteration from p = texel; more where the move is long.
    """
    width, height = size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    from_x, from_y = x, y
    for _ in range(rounds):
        grid = from_x / np.float32(step), from_y / np.float32(step)
        across, down = (
            cv2.remap(
                part.astype(np.float32), *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            for part in move
        )
        from_x, from_y = x - across, y - down
    return from_x, from_y


def sheared(maps: Floats, across: Shift, down: Shift) -> tuple[Floats, int, int]:
    """Maps resampled so that two shifts are along the axes, and the shifts' lengths.

    Args:
        maps: (C, H, W).
        across: shift (x, y) that becomes horizontal.
        down: shift (x, y) that becomes vertical.

    Returns:
        Maps; length of `across`; length of `down`, in whole texels.
    """
    along, below = round(math.hypot(*across)), round(math.hypot(*down))
    matrix = np.array([[across[0] / along, down[0] / below], [across[1] / along, down[1] / below]])
    if np.abs(matrix - np.eye(2)).max() * max(along, below) < _BENT:
        return maps, along, below
    height, width = maps.shape[1:]
    x, y = np.meshgrid(np.arange(width) - 0.5 * (width - 1), np.arange(height) - 0.5 * (height - 1))
    from_x = matrix[0, 0] * x + matrix[0, 1] * y + 0.5 * (width - 1)
    from_y = matrix[1, 0] * x + matrix[1, 1] * y + 0.5 * (height - 1)
    return _read_inside(maps, from_x, from_y), along, below


def _inside(inside: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Slices of the largest centred rectangle whose border is all inside, or of the middle."""
    height, width = inside.shape
    most = min(height, width) // 4
    for cut in range(most):
        part = inside[cut : height - cut, cut : width - cut]
        if part[0].all() and part[-1].all() and part[:, 0].all() and part[:, -1].all():
            return slice(cut, height - cut), slice(cut, width - cut)
    return slice(most, height - most), slice(most, width - most)


def _read_inside(maps: Floats, x: NDArray[np.floating], y: NDArray[np.floating]) -> Floats:
    """Maps interpolated at texels (x, y), cropped to where these lie inside.

    At most a quarter of the shorter side is cropped at each border; beyond, borders are repeated.
    """
    height, width = maps.shape[1:]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    rows, columns = _inside(inside)
    at = np.asarray(x[rows, columns], np.float32), np.asarray(y[rows, columns], np.float32)
    read = [cv2.remap(p, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) for p in maps]
    planes = np.stack(read).astype(np.float32, copy=False)
    np.clip(planes[:-1], 0.0, 1.0, out=planes[:-1])
    return planes
