"""Mosaic: the extent of all that several photographs show, and its prediction and maps.

The first photograph's grid is extended by margins. The photographs rarely cover a rectangle: the
exemplar is the bounding box of the coverage, less sides that are mostly unseen, and its unseen
texels are masked. Within the first photograph the network's prediction is that of the first; beyond
it, the mean of the predictions of the others, each on the plane that faces its own camera, as in
training, weighted by the distance to its border.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO, ROUGH
from matcap.brdf.cook_torrance import F0 as LOG_F0
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.octaves import filled, smoothed
from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.surface import integrated
from matcap.capture.multiview.texels import SLOPES, Estimate, maps_of, parameters_of, slopes_of
from matcap.capture.multiview.views import SharedLight
from matcap.capture.registration.camera import Doubles, PosedCamera, grid_points, to_pixels
from matcap.capture.registration.register import RegisteredView
from matcap.capture.settings import UNION_TIMES
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import Extent, FlashSetup, Margins
from matcap.flash.light import cached_rows, strips
from matcap.flash.rectify import Plane, read_plane

Marks = NDArray[np.bool_]

# Largest angle of a ray to the plane's normal, degrees; at 60, foreshortening is one half.
STEEPEST = 60.0
LEAST = 0.3  # least visible share of a side; below it the side is cut off
_TEXELS = 4_000_000  # largest number of texels, but no fewer than the first photograph's own
_CELLS = 64  # cells across the first photograph, in which coverage is determined
_FARTHEST = 256  # cells searched on each side
_THINNEST = 3  # least width of a margin, cells
_STEEPEST_PREDICTED = 35.0  # largest tilt in the network's training, degrees
# Width of the border along which a prediction's weight falls to 0, as a share of its width.
_FADES = 0.12


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
        left_out = 100.0 - 100.0 * self.covered
        return (
            f"{left_out:.0f} % of what the photographs show is left out of the maps, which "
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
    cells, far = (_CELLS, round(_CELLS * size[1] / size[0])), Margins(*(_FARTHEST,) * 4)
    seen = _any_sees(views, grid_points(*far.around(cells), far.extent(_CELLS)))
    most = min(UNION_TIMES, max(1.0, _TEXELS / (size[0] * size[1])))
    box, whole = (_box(seen, cells, times * cells[0] * cells[1]) for times in (most, math.inf))
    rows, columns = _lines(box, cells)
    covered = float(seen[rows, columns].sum()) / max(float(seen.sum()), 1.0)
    texels = (round(count * size[0] / _CELLS) if count >= _THINNEST else 0 for count in box)
    known = float(seen[rows, columns].mean())
    return Mosaic(Margins(*texels), size, covered, known, box != whole)


def _box(seen: Marks, cells: tuple[int, int], most: float) -> list[int]:
    """Cells left, right, above and below the first photograph's `cells` (across, down).

    From the bounding box of visible cells, the side with the smallest visible share is cut off
    until each has at least LEAST and the box at most `most` cells.
    """
    visible = seen.copy()
    visible[_lines([0, 0, 0, 0], cells)] = True
    (top, bottom), (left, right) = (
        np.flatnonzero(visible.any(axis))[[0, -1]].tolist() for axis in (1, 0)
    )
    box = [_FARTHEST - left, right + 1 - _FARTHEST - cells[0]]
    box += [_FARTHEST - top, bottom + 1 - _FARTHEST - cells[1]]
    while True:
        rows, columns = _lines(box, cells)
        inside = seen[rows, columns]
        edges = (inside[:, 0], inside[:, -1], inside[0], inside[-1])
        # Of equal shares the side that reaches farthest.
        sides = [
            (float(edge.mean()), -count, side)
            for side, (edge, count) in enumerate(zip(edges, box, strict=True))
            if count > 0
        ]
        if not sides or (inside.size <= most and min(sides)[0] >= LEAST):
            return box
        box[min(sides)[2]] -= 1


def _lines(box: Sequence[int], cells: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a box (left, right, above, below) around `cells` (across, down)."""
    left, right, top, bottom = box
    far = _FARTHEST
    return slice(far - top, far + cells[1] + bottom), slice(far - left, far + cells[0] + right)


def seen_by_any(views: Sequence[RegisteredView], mosaic: Mosaic) -> Tensor:
    """(H, W) bool on the mosaic: whether any flash photograph shows the texel."""
    width, height = mosaic.margins.around(mosaic.size)
    parts = [
        _any_sees(views, grid_points(width, height, mosaic.extent, rows))
        for rows in strips(height, cached_rows(width))
    ]
    return torch.from_numpy(np.concatenate(parts))


def _any_sees(views: Sequence[RegisteredView], points: Doubles) -> Marks:
    """(h, w) bool, whether any flash photograph shows plane points (3, h, w)."""
    seen = np.zeros(points.shape[1:], np.bool_)
    for view in views:
        if view.flash:
            up = view.photo.pixels.shape[0] / view.photo.pixels.shape[1]
            seen |= view.camera.shows(points, up, STEEPEST)
    return seen


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


class OwnPlane(NamedTuple):
    """The frame of the plane that faces a camera, within the first photograph's frame."""

    setup: FlashSetup
    """Camera and flash of the photograph in this frame."""
    unit: float
    """Its plane unit in the first photograph's."""
    coordinates: Callable[[Doubles], Doubles]
    """Its (2, ...) coordinates of points (3, ...) of the first photograph's plane."""


def own_plane(camera: PosedCamera, light: SharedLight, number: int) -> OwnPlane:
    """The frame of the plane that faces the camera of photograph `number`."""
    distance = camera.place[2] / camera.turn[2, 2]
    origin = (camera.place - distance * camera.turn[2])[:2]
    scale = float(distance / camera.lens.focal)
    roll = math.atan2(-camera.turn[1, 0], camera.turn[1, 1])
    c, s = math.cos(roll), math.sin(roll)
    turn = camera.turn @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x, y = (light.offset / scale).tolist()
    lost, more = light.vignetting.tolist()
    red, green, blue = (light.intensity * light.gain[number].exp() / scale**2).tolist()
    setup = FlashSetup(
        math.degrees(2.0 * math.atan(1.0 / camera.lens.focal)),
        (x, y, 0.0),
        (math.atan2(-turn[1, 2], turn[1, 1]), math.atan2(-turn[2, 0], turn[0, 0])),
        (red, green, blue),
        lost,
        more,
        light.centre,
        light.colour,
    )

    def coordinates(points: Doubles) -> Doubles:
        offset = points[:2] - origin.reshape(2, *(1,) * (points.ndim - 1))
        return np.asarray(np.tensordot(np.array([[c, s], [-s, c]]), offset, 1)) / scale

    return OwnPlane(setup=setup, unit=scale, coordinates=coordinates)


def predicted_beyond(
    alignment: Aligned,
    first: Estimate,
    mosaic: Mosaic,
    coarse: CoarseFit,
    predict: Callable[[Plane, CoarseFit], Estimate],
) -> Estimate:
    """The first photograph's prediction, beyond it that of the others.

    Args:
        alignment: registration and light of the photographs.
        first: the first one's prediction, extrapolated over the mosaic (spread_over).
        coarse: fit of the first, whose mean material all share.
        predict: predicts the maps of one photograph on its own plane.
    """
    texel_size, parameters = first.maps.texel_size, parameters_of(first.maps)
    others, errors = torch.zeros_like(parameters), torch.zeros_like(first.log_error)
    total = torch.zeros(parameters.shape[1:])
    for number, view in enumerate(alignment.views[1:], 1):
        if view.flash and math.degrees(view.camera.tilt) < _STEEPEST_PREDICTED:
            own = own_plane(view.camera, alignment.light, number)
            plane = read_plane(view.photo, own.setup, mosaic.size[0])
            prediction = predict(plane, replace(coarse, setup=own.setup))
            over, error, weight = resampled(prediction, own, alignment, number, first.maps.size)
            count = max(len(others), len(over))
            others = with_channels(others, count) + weight * with_channels(over, count)
            errors, total = errors + weight * error, total + weight
    inside = mosaic.margins.own(mosaic.size).numpy().astype(np.uint8)
    within = np.asarray(cv2.distanceTransform(inside, cv2.DIST_L2, 3), np.float32)
    # Where nothing is predicted, at the outermost borders, the extrapolated first one is left.
    share = (1.0 - torch.from_numpy(_faded(within, mosaic.size[0]))) * (8.0 * total).clamp_max(1.0)
    total = total.clamp_min(1e-6)
    parameters = torch.lerp(with_channels(parameters, len(others)), others / total, share)
    height = integrated(parameters[SLOPES], texel_size)
    log_error = torch.lerp(first.log_error, errors / total, share)
    return Estimate(maps_of(parameters, height, texel_size), log_error)


def with_channels(parameters: Tensor, count: int) -> Tensor:
    """Parameters of `count` rows: with those of a tint, 0 where they had none."""
    return F.pad(parameters, (0, 0, 0, 0, 0, count - len(parameters)))


def resampled(
    prediction: Estimate, own: OwnPlane, alignment: Aligned, number: int, size: tuple[int, int]
) -> tuple[Tensor, Tensor, Tensor]:
    """Photograph `number`'s prediction, resampled from its own plane to the first one's.

    Parameters (PARAMETERS or more, H, W), log errors (4, H, W), and their weight (H, W), which is 0
    at the photograph's border and beyond.

    Args:
        prediction: the network's, on its photograph's plane.
        number: of the photograph.
        size: (across, down) texels of the grid.
    """
    camera, warp = alignment.views[number].camera, alignment.warps[number]
    points = np.concatenate([*warp.points(*size)], axis=1)
    width, height = prediction.maps.size
    x, y = to_pixels(own.coordinates(camera.on_plane(camera.sees(points))), width, height)

    def over(planes: Tensor, how: int) -> Tensor:
        each = (cv2.remap(p.numpy(), x, y, how, borderMode=cv2.BORDER_REFLECT_101) for p in planes)
        return torch.from_numpy(np.stack(list(each)))

    # Slopes are those of the resampled height: axes of the two planes differ.
    maps = prediction.maps
    height_over = own.unit * over(maps.height, cv2.INTER_CUBIC)
    parameters = over(parameters_of(maps), cv2.INTER_LINEAR)
    parameters[SLOPES] = slopes_of(height_over, warp.extent.texel(size[0]))
    within = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    weight = torch.from_numpy(_faded(within, width))
    return parameters, over(prediction.log_error, cv2.INTER_LINEAR), weight


def _faded(within: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """(H, W) weights that rise smoothly from 0 to 1 with the distance to a border, in texels."""
    share = (within / (_FADES * width)).clip(0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share), np.float32)


def spread_over(prediction: Estimate, margins: Margins) -> Estimate:
    """Extrapolate the first photograph's estimate smoothly over the mosaic's margins.

    Its error there is the standard deviation of the parameters within the first photograph, errors
    included.
    """
    if not margins.any:
        return prediction
    own = margins.own(prediction.maps.size)
    padded = margins.padded(prediction.maps.stacked().float()).numpy()
    wide = torch.from_numpy(np.stack([filled(plane, own.numpy()) for plane in padded]))
    parameters = parameters_of(prediction.maps)
    parts = (parameters[ALBEDO].mean(0), parameters[LOG_F0], parameters[ROUGH], parameters[SLOPES])
    variance = torch.stack([part.var() for part in parts])
    variance += (2.0 * prediction.log_error.clamp(-8.0, 2.0)).exp().mean((1, 2))
    beyond = 0.5 * variance.log()[:, None, None]
    log_error = torch.where(own, margins.padded(prediction.log_error), beyond)
    return Estimate(MapSet.from_stacked(wide, prediction.maps.texel_size), log_error)
