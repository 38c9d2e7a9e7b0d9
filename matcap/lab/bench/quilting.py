"""Classic texture synthesis by example, a baseline: image quilting.

Efros and Freeman (2001), "Image Quilting for Texture Synthesis and Transfer". Square blocks of the
source are laid side by side, row by row, each overlapping those before it. A block is drawn among
those whose overlap fits nearly as well as the best one's, and joined along the path through the
overlap where both differ least. Every texel is a copy of one in the source, light included: what
comes out is a picture, no material.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.errors import UsageError

Pixels = NDArray[np.float32]


@dataclass(frozen=True)
class QuiltSettings:
    """How a quilt is made.

    Attributes:
        block: texels a side; larger than what the texture repeats, and at least 6.
        overlap: texels that neighbours share; a sixth of the block in the paper.
        tolerance: blocks up to this share worse than the best are drawn among (0.1 in the paper).
    """

    block: int = 48
    overlap: int = 8
    tolerance: float = 0.1


def quilt(
    source: Tensor, width: int, height: int, seed: int, settings: QuiltSettings | None = None
) -> Tensor:
    """A texture like a picture, of any size.

    Args:
        source: (C, h, w) float32, C at most 4; at least a block a side.
        width, height: of the result, in texels.
        seed: of all draws; non-negative.
        settings: how.

    Returns:
        (C, height, width) float32, all of its texels taken from the source.

    Raises:
        UsageError: the source is smaller than a block.
    """
    settings = settings or QuiltSettings()
    block, step = settings.block, settings.block - settings.overlap
    pixels = np.ascontiguousarray(source.permute(1, 2, 0).float().numpy())
    if min(pixels.shape[:2]) < block:
        raise UsageError(
            f"a picture of {pixels.shape[1]} x {pixels.shape[0]} texels has no block of {block}",
            where="quilt",
            remedy="give a larger picture or smaller blocks",
        )
    rng = np.random.default_rng(seed)
    rows, columns = (max(0, -(-(side - block) // step)) + 1 for side in (height, width))
    canvas = np.zeros(
        ((rows - 1) * step + block, (columns - 1) * step + block, pixels.shape[2]), np.float32
    )
    origins: dict[tuple[int, int], tuple[int, int]] = {}
    for row, column in itertools.product(range(rows), range(columns)):
        y, x, left, above = row * step, column * step, column > 0, row > 0
        patch = canvas[y : y + block, x : x + block]
        errors = _errors(pixels, patch, _overlap(settings, left=left, above=above))
        # What continues a neighbour in the source fits best; always taken, it copies the source.
        if left:
            _forbid(errors, origins[row, column - 1], (0, step))
        if above:
            _forbid(errors, origins[row - 1, column], (step, 0))
        place = origins[row, column] = _draw(errors, settings.tolerance, rng)
        fitting = pixels[place[0] : place[0] + block, place[1] : place[1] + block]
        apart = np.square(fitting - patch).sum(axis=2)
        keep = _kept(apart, settings.overlap, left=left, above=above)
        patch[~keep] = fitting[~keep]
    return torch.from_numpy(canvas[:height, :width]).permute(2, 0, 1).contiguous()


def cheapest_path(cost: NDArray[np.float32]) -> NDArray[np.intp]:
    """Column of the path from the top row of (n, m) to the bottom that costs least, (n,).

    From row to row it moves by at most one column.
    """
    total = cost.astype(np.float64)
    for row in range(1, len(total)):
        before = np.pad(total[row - 1], 1, constant_values=np.inf)
        total[row] += np.minimum(np.minimum(before[:-2], before[1:-1]), before[2:])
    path = np.empty(len(total), np.intp)
    path[-1] = total[-1].argmin()
    for row in range(len(total) - 2, -1, -1):
        first = max(0, path[row + 1] - 1)
        path[row] = first + total[row, first : path[row + 1] + 2].argmin()
    return path


def _overlap(settings: QuiltSettings, *, left: bool, above: bool) -> NDArray[np.bool_]:
    """(block, block) where a block lies on its neighbours."""
    found = np.zeros((settings.block, settings.block), bool)
    found[:, : settings.overlap] |= left
    found[: settings.overlap] |= above
    return found


def _errors(source: Pixels, patch: Pixels, overlap: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Squared difference in the overlap of every block of the source, by its left top texel."""
    block = len(patch)
    if not overlap.any():
        return np.zeros([side - block + 1 for side in source.shape[:2]], np.float32)
    mask = np.repeat(overlap[..., None].astype(np.float32), source.shape[2], axis=2)
    found = cv2.matchTemplate(source, patch, cv2.TM_SQDIFF, mask=mask)
    return np.asarray(found, np.float32).clip(0.0)  # by Fourier transform: hardly below 0


def _forbid(errors: NDArray[np.float32], origin: tuple[int, int], shift: tuple[int, int]) -> None:
    """Take the block that lies so far from another out of those to draw from, if it is there."""
    y, x = origin[0] + shift[0], origin[1] + shift[1]
    if y < errors.shape[0] and x < errors.shape[1]:
        errors[y, x] = np.inf


def _draw(
    errors: NDArray[np.float32], tolerance: float, rng: np.random.Generator
) -> tuple[int, int]:
    """Row and column of one of the errors that are nearly the least."""
    good = np.argwhere(errors <= (1.0 + tolerance) * errors.min() + 1e-9)
    y, x = good[rng.integers(len(good))]
    return int(y), int(x)


def _kept(
    apart: NDArray[np.float32], overlap: int, *, left: bool, above: bool
) -> NDArray[np.bool_]:
    """(block, block) where what lies there already stays: before the cut, left or above."""
    kept = np.zeros(apart.shape, bool)
    places = np.arange(overlap)
    if left:
        kept[:, :overlap] |= places < cheapest_path(apart[:, :overlap])[:, None]
    if above:
        kept[:overlap] |= places[:, None] < cheapest_path(apart[:overlap].T)
    return kept
