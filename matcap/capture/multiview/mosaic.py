"""Mosaic: maps of all that the photographs show, not the first one's rectangle alone.

The first photograph's grid is extended by margins. The photographs rarely cover a rectangle: the
exemplar is the bounding box of the coverage, less sides that are mostly unseen, and its unseen
texels are masked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.filters import filled, smoothed
from matcap.capture.rectified import UNION_TIMES
from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, grid_points
from matcap.capture.registration.register import RegisteredView
from matcap.flash.extent import Extent, Margins
from matcap.flash.light import cached_rows, strips

Marks = NDArray[np.bool_]

# Limits of the mosaic; docs/notes/several.md.

# Largest angle of a ray to the plane's normal, degrees; at 60, foreshortening is one half.
STEEPEST = 60.0
LEAST = 0.3  # least visible share of a side; below it the side is cut off
_TEXELS = 4_000_000  # largest number of texels, but no fewer than the first photograph's own
_CELLS = 64  # cells across the first photograph, in which coverage is determined
_FARTHEST = 256  # cells searched on each side
_THINNEST = 3  # least width of a margin, cells


@dataclass(frozen=True)
class Mosaic:
    """Extent of the mosaic."""

    margins: Margins
    """Texels around the first photograph's grid."""
    size: tuple[int, int]
    """(width, height) of the first photograph's grid, texels."""
    covered: float = 1.0
    """Share of the photographs' coverage that lies in the mosaic."""
    known: float = 1.0
    """Share of the mosaic that any photograph shows."""
    limited: bool = False
    """Whether UNION_TIMES or _TEXELS cut it."""

    @property
    def extent(self) -> Extent:
        """Extent of the mosaic on the plane."""
        return self.margins.extent(self.size[0])

    @property
    def times(self) -> float:
        """Area over that of the first photograph's rectangle."""
        width, height = self.margins.around(self.size)
        return width * height / (self.size[0] * self.size[1])

    @staticmethod
    def own(size: tuple[int, int]) -> Mosaic:
        """Extent of the first photograph's rectangle, (width, height) in texels."""
        return Mosaic(Margins(), size)

    def summary(self) -> str:
        """Sentence on the size of the mosaic."""
        width, height = self.margins.around(self.size)
        return (
            f"The maps cover all that the photographs show: {width} x {height} texels, "
            f"{self.times:.1f} times the first photograph's."
        )

    def warning(self) -> str | None:
        """A sentence if the mosaic was cut to its largest size, else None."""
        if not self.limited:
            return None
        return (
            f"{1.0 - self.covered:.0%} of what the photographs show is left out of the maps, which "
            f"have {self.times:.1f} times the first photograph's texels, the largest size: "
            "capture it separately, or give a smaller --detail."
        )

    def document(self) -> dict[str, Any]:
        """JSON (report.py describes the keys)."""
        return {
            "margins": asdict(self.margins),
            "area_ratio": self.times,
            "covered_share": self.covered,
            "limited": self.limited,
            "seen_share": self.known,
        }


def mosaic_of(views: Sequence[RegisteredView], size: tuple[int, int]) -> Mosaic:
    """Extent of what the flash photographs show, around the first one's grid.

    Args:
        views: photographs with their cameras, the first one first.
        size: (width, height) of the first one's grid, texels.
    """
    rows = round(_CELLS * size[1] / size[0])
    seen = _any_sees(views, _cells(rows, size))
    most = min(UNION_TIMES, max(1.0, _TEXELS / (size[0] * size[1])))
    box = _box(seen, rows, most * rows * _CELLS)
    limited = box != _box(seen, rows, math.inf)
    beyond = (
        _FARTHEST - box[0].start,
        box[0].stop - _FARTHEST - rows,
        _FARTHEST - box[1].start,
        box[1].stop - _FARTHEST - _CELLS,
    )
    top, bottom, left, right = (
        round(count * size[0] / _CELLS) if count >= _THINNEST else 0 for count in beyond
    )
    covered = float(seen[box].sum()) / max(float(seen.sum()), 1.0)
    margins = Margins(left, right, top, bottom)
    return Mosaic(margins, size, covered, float(seen[box].mean()), limited)


def seen_by_any(views: Sequence[RegisteredView], mosaic: Mosaic) -> Tensor:
    """(H, W) bool on the mosaic: whether any flash photograph shows the texel."""
    width, height = mosaic.margins.around(mosaic.size)
    seen = np.zeros((height, width), np.bool_)
    for rows in strips(height, cached_rows(width)):
        points = grid_points(width, height, mosaic.extent, rows)
        seen[rows] = _any_sees(views, points)
    return torch.from_numpy(seen)


def _any_sees(views: Sequence[RegisteredView], points: Doubles) -> Marks:
    """(h, w) bool, whether any flash photograph shows plane points (3, h, w)."""
    seen = np.zeros(points.shape[1:], np.bool_)
    for view in views:
        if view.flash:
            up = view.photo.pixels.shape[0] / view.photo.pixels.shape[1]
            seen |= sees(view.camera, points, up, STEEPEST)
    return seen


def sees(camera: PosedCamera, points: Doubles, up: float, steepest: float) -> Marks:
    """(h, w) whether plane points (3, h, w) project into a picture, at less than an angle.

    Args:
        camera: of the picture.
        points: with z = 0, plane units.
        up: height of the picture over its width.
        steepest: largest angle of a ray to the plane's normal, degrees.
    """
    to_camera = camera.place.reshape(3, 1, 1) - points
    upright = to_camera[2] > math.cos(math.radians(steepest)) * np.sqrt(np.square(to_camera).sum(0))
    u, v = camera.sees(points)
    # Far outside of the picture, the lens's polynomial can map points back into it.
    near = np.abs(replace(camera, lens=Lens(camera.lens.focal)).sees(points)).max(0) < 1.5
    return np.asarray(upright & near & (np.abs(u) < 1.0) & (np.abs(v) < up))


def _cells(rows: int, size: tuple[int, int]) -> Doubles:
    """(3, h, w) centres of cells, plane units: `rows` of them in the first photograph's grid of
    (width, height), and _FARTHEST on each side of it.
    """
    across, up, far = 2.0 / _CELLS, size[1] / size[0], _FARTHEST
    x = (np.arange(-far, _CELLS + far) + 0.5) * across - 1.0
    beyond = up + (np.arange(far) + 0.5) * across
    own = up - (np.arange(rows) + 0.5) * 2.0 * up / rows
    y = np.concatenate([beyond[::-1], own, -beyond])
    return np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.zeros((len(y), len(x)))])


def _box(seen: Marks, rows: int, most: float) -> tuple[slice, slice]:
    """Rows and columns of the box around visible cells, including the first photograph's.

    The side with the smallest visible share is cut off until each has at least LEAST and the box at
    most `most` cells.
    """
    own, far = (rows, _CELLS), _FARTHEST
    visible = seen.copy()
    visible[far : far + own[0], far : far + own[1]] = True
    spans = [np.flatnonzero(visible.any(axis)) for axis in (1, 0)]
    low = [int(span[0]) for span in spans]
    high = [int(span[-1]) + 1 for span in spans]
    while True:
        sides = []
        for axis, lines in ((0, seen), (1, seen.T)):
            across = slice(low[1 - axis], high[1 - axis])
            for edge, line, beyond in (
                (low, low[axis], far - low[axis]),
                (high, high[axis] - 1, high[axis] - far - own[axis]),
            ):
                if beyond > 0:
                    share = float(lines[line, across].mean())
                    sides.append((share, -beyond, axis, edge is low))
        small = (high[0] - low[0]) * (high[1] - low[1]) <= most
        if not sides or (small and min(sides)[0] >= LEAST):
            return slice(low[0], high[0]), slice(low[1], high[1])
        _, _, axis, lower = min(sides)
        if lower:
            low[axis] += 1
        else:
            high[axis] -= 1


def extrapolated(maps: MapSet, known: Tensor, slow: float) -> MapSet:
    """Extrapolate maps smoothly over unseen texels, and high-pass the height.

    Biased slopes of a photograph accumulate over a mosaic, and unseen texels leave steps in height.

    Args:
        maps: estimated.
        known: (H, W) bool, texels that a photograph shows.
        slow: standard deviation of the Gaussian high-pass, texels.
    """
    seen = known.numpy()
    planes = np.stack([filled(plane.numpy(), seen) for plane in maps.stacked().float()])
    planes[-1] -= smoothed(planes[-1], slow)
    return MapSet.from_stacked(torch.from_numpy(planes), maps.texel_size)
