"""Texels around the mirror point whose albedo still has the flash's highlight.

What the fitted lobe misses of a highlight is put into albedo: a white spot, or a ring. A material
does not know where the flash was, so the mean of log albedo over a ring around the mirror point is
compared with the means over equal rings around other centres. Rings that stand out only far from
the mirror point are shading.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RemainderSettings:
    """Settings of the test of rings."""

    cells: int = 128
    """Cells along the long side, over which log albedo is averaged; finer detail is texture."""
    width: int = 2
    """Width of a ring, cells."""
    widest: int = 20
    """Radius of the largest ring, cells; wider discs are shading, which `flatten` removes."""
    missed: int = 2
    """Rings in a row that do not stand out, at which the disc ends."""
    inside: float = 0.9
    """Least share of a ring inside the picture, at other centres."""
    unusual: float = 4.0
    """Deviations from the mean over other centres at which a ring stands out."""


REMAINDER = RemainderSettings()


def remaining_highlight(
    albedo: Floats, known: NDArray[np.bool_], mirror: tuple[float, float]
) -> NDArray[np.bool_]:
    """(H, W) bool: the disc around the mirror point up to the last ring that stands out.

    Rings are followed outwards until two in a row do not stand out.

    Args:
        albedo: (C, H, W) diffuse albedo, in (0, 1].
        known: (H, W) bool, texels of the photograph.
        mirror: column and row of the mirror point, texels.
    """
    height, width = known.shape
    step = max(1, max(height, width) // REMAINDER.cells)
    size = (width // step, height // step)
    share = np.asarray(
        cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32
    )
    log = np.log(np.maximum(albedo, 1e-3)).mean(0) * known
    total = np.asarray(
        cv2.resize(log.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32
    )
    column, row = (at / step - 0.5 for at in mirror)
    distances = np.hypot(np.arange(size[0]) - column, np.arange(size[1])[:, None] - row)
    radius = missed = 0
    for inner in range(0, REMAINDER.widest, REMAINDER.width):
        stands_out = _stands_out(total, share, distances, inner)
        if stands_out:
            radius, missed = inner + REMAINDER.width, 0
        elif stands_out is not None:
            missed += 1
            if missed == REMAINDER.missed:
                break
    distance = np.hypot(np.arange(width) - mirror[0], np.arange(height)[:, None] - mirror[1])
    return np.asarray(distance < (radius + 1) * step if radius else distance < 0.0)


def _stands_out(
    total: Floats, share: Floats, distances: NDArray[np.float64], inner: int
) -> bool | None:
    """Whether the ring from `inner` on has an unusual mean around the mirror point; None: unknown.

    Args:
        total: (h, w) sums of log albedo over cells.
        share: (h, w) known share of the cells.
        distances: (h, w) distance of the cells from the mirror point, cells.
        inner: inner radius of the ring, cells.
    """
    outer = inner + REMAINDER.width
    offsets = np.arange(-outer, outer + 1)
    radius = np.hypot(offsets, offsets[:, None])
    ring = ((radius >= inner) & (radius < outer)).astype(np.float32)
    counts = cv2.filter2D(share, -1, ring, borderType=cv2.BORDER_CONSTANT)
    means = cv2.filter2D(total, -1, ring, borderType=cv2.BORDER_CONSTANT) / np.maximum(counts, 1e-6)
    at = np.unravel_index(int(distances.argmin()), distances.shape)
    others = means[(counts > REMAINDER.inside * ring.sum()) & (distances > 2.0 * outer)]
    if len(others) < 16 or counts[at] < 0.5 * ring.sum():
        return None
    return bool(abs(means[at] - others.mean()) > REMAINDER.unusual * (others.std() + 1e-3))
