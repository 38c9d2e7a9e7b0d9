"""Mosaic: network predictions of all photographs fused, and maps of all that they show."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO, F0, ROUGH
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.relief_spectrum import filled, smoothed
from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.surface import integrated, surface_of
from matcap.capture.multiview.texels import SLOPES, TINT, Estimate, maps_of, parameters_of
from matcap.capture.multiview.views import SharedLight, ViewWarp
from matcap.capture.rectified import UNION_TIMES
from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, grid_points, to_pixels
from matcap.capture.registration.register import RegisteredView
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import Extent, FlashSetup, Margins
from matcap.flash.light import cached_rows, strips
from matcap.flash.rectify import Plane, read_plane

# Mosaic: maps of all that the photographs show, not the first one's rectangle alone.
#
# The first photograph's grid is extended by margins. The photographs rarely cover a rectangle: the
# exemplar is the bounding box of the coverage, less sides that are mostly unseen, and its unseen
# texels are masked.


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


# Network predictions of each photograph of a mosaic, fused in the first one's frame.
#
# Each photograph is rectified to the plane facing its own camera, as in training, with the light
# from registration. Predictions of a parameter, resampled to the first photograph's texels, are
# averaged with weights 1 / sigma^2, sigma being the network's expected error. A share of their
# error variance is a bias common to all predictions, which averaging does not reduce:
#
# variance = shared min sigma^2 + (1 - shared) / sum (1 / sigma^2).


UNPREDICTED = 4.0  # log error of a prediction outside of its photograph
_NOTHING = 1e-8  # weight of a prediction at its border, whose log error then exceeds UNPREDICTED

Floats = NDArray[np.float32]

# How predictions are fused; docs/notes/several.md.
_ACROSS = 384  # texels across the grid of fusion; finer detail is the first photograph's
_STEEPEST = 35.0  # largest tilt in the network's training, degrees
_SHARED = 0.5  # share of the error variance that is common to all predictions
# Width of the border along which weights fall to 0, as a share of the prediction's width.
_FADES = 0.12


@dataclass(frozen=True)
class OwnPlane:
    """Frame of the plane that faces a camera, within the first photograph's frame."""

    setup: FlashSetup
    """Camera and flash in this frame."""
    origin: Doubles
    """(2,) its origin in the first photograph's frame."""
    scale: float
    """Length of its plane unit in the first photograph's."""
    roll: float
    """Angle of its x axis to the first photograph's, radians anticlockwise."""

    @staticmethod
    def of(camera: PosedCamera, light: SharedLight, number: int) -> OwnPlane:
        """Frame of photograph `number` with its camera and the shared light."""
        distance = camera.place[2] / camera.turn[2, 2]
        origin = (camera.place - distance * camera.turn[2])[:2]
        scale = float(distance / camera.lens.focal)
        roll = math.atan2(-camera.turn[1, 0], camera.turn[1, 1])
        c, s = math.cos(roll), math.sin(roll)
        turn = camera.turn @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        tilt = (math.atan2(-turn[1, 2], turn[1, 1]), math.atan2(-turn[2, 0], turn[0, 0]))
        x, y = (light.offset / scale).tolist()
        lost, more = light.vignetting.tolist()
        strength = light.intensity * light.gain[number].exp() / scale**2
        red, green, blue = strength.tolist()
        setup = FlashSetup(
            math.degrees(2.0 * math.atan(1.0 / camera.lens.focal)),
            (x, y, 0.0),
            tilt,
            (red, green, blue),
            lost,
            more,
            light.centre,
        )
        return OwnPlane(setup, origin, scale, roll)

    def coordinates(self, points: Doubles) -> Doubles:
        """(2, ...) coordinates in this frame of points (3, ...) of the first photograph's plane."""
        c, s = math.cos(self.roll), math.sin(self.roll)
        offset = points[:2] - self.origin.reshape(2, *(1,) * (points.ndim - 1))
        return np.asarray(np.tensordot(np.array([[c, s], [-s, c]]), offset, 1)) / self.scale


def predict_views(
    alignment: Aligned,
    first: Estimate,
    coarse: CoarseFit,
    predict: Callable[[Plane, CoarseFit], Estimate],
) -> list[Estimate]:
    """The network's predictions of the photographs with flash and without too large a tilt.

    Args:
        alignment: registration and light of the photographs.
        first: prediction of the first, in the estimated frame.
        coarse: fit of the first, whose mean material all share.
        predict: predicts the maps of one photograph on its own plane.

    Returns:
        The predictions, the first one first, on its grid of fusion.
    """
    extent = alignment.extent
    width, height = first.maps.size
    rectangle_across = min(_ACROSS, round(extent.unit(width)))
    across = extent.across(rectangle_across)
    down = round(height * across / width)
    predictions = [first.resized((down, across), extent)]
    for number, view in enumerate(alignment.views[1:], 1):
        if view.flash and math.degrees(view.camera.tilt) < _STEEPEST:
            own = OwnPlane.of(view.camera, alignment.light, number)
            plane = read_plane(view.photo, own.setup, rectangle_across)
            prediction = predict(plane, replace(coarse, setup=own.setup))
            warp = alignment.warps[number]
            over = resampled_over(prediction, own, view.camera, warp, (across, down))
            predictions.append(over)
    return predictions


def resampled_over(
    prediction: Estimate,
    own: OwnPlane,
    camera: PosedCamera,
    warp: ViewWarp,
    size: tuple[int, int],
) -> Estimate:
    """Resample a prediction from its photograph's own plane to the first one's.

    Args:
        prediction: the network's, on its photograph's plane.
        own: frame of its plane.
        camera: of its photograph.
        warp: of its photograph, by registration.
        size: (across, down) texels of the first one's grid.
    """
    width, height = prediction.maps.size
    points = np.concatenate([*warp.points(*size)], axis=1)
    x, y = to_pixels(own.coordinates(camera.on_plane(camera.sees(points))), width, height)

    def resampled(channel: Tensor, how: int = cv2.INTER_CUBIC) -> Tensor:
        return torch.from_numpy(
            cv2.remap(channel.numpy(), x, y, how, borderMode=cv2.BORDER_REFLECT_101)
        )

    maps = prediction.maps
    logs = torch.cat([maps.diffuse.clamp_min(1e-3).log(), maps.specular.clamp_min(5e-3).log()])
    stacked = torch.stack([resampled(c) for c in torch.cat([logs, maps.roughness, maps.height])])
    log_albedo, log_f0, roughness, relief = stacked.split([3, len(stacked) - 5, 1, 1])
    texel_size = warp.extent.texel(size[0])
    over = MapSet(log_albedo.exp(), log_f0.exp(), roughness, own.scale * relief, texel_size)
    errors = torch.stack([resampled(c, cv2.INTER_LINEAR) for c in prediction.log_error])
    errors = (errors + torch.from_numpy(_fading(x, y, (width, height)))).clamp_max(UNPREDICTED)
    return Estimate(over, errors)


def _fading(x: Floats, y: Floats, size: tuple[int, int]) -> Floats:
    """(H, W) added to log errors: weights then fall smoothly to 0 at a prediction's border."""
    width, height = size
    within = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    share = (within / (_FADES * width)).clip(0.0, 1.0)
    weight = share**2 * (3.0 - 2.0 * share)
    return np.asarray(-0.5 * np.log(np.maximum(weight, _NOTHING)), np.float32)


def fused(predictions: Sequence[Estimate]) -> Estimate:
    """Precision-weighted mean of predictions and its standard deviations (module equation).

    Args:
        predictions: in any order.
    """
    weights = _precisions(predictions)
    whole = weights.sum(0)
    channels = max(len(prediction.maps.specular) for prediction in predictions)
    parameters = torch.stack([_parameters(prediction, channels) for prediction in predictions])
    mean = torch.zeros_like(parameters[0])
    for part, kind in ((ALBEDO, 0), (F0, 1), (ROUGH, 2), (SLOPES, 3), (TINT, 1)):
        for one, weight in zip(parameters, weights, strict=True):
            mean[part] += weight[kind] / whole[kind] * one[part]
    log_error = _fused_error(weights)
    slope_precision = (-2.0 * log_error[3]).exp()
    texel_size = predictions[0].maps.texel_size
    precision = torch.stack([slope_precision, slope_precision, torch.zeros_like(slope_precision)])
    height = surface_of(mean[SLOPES], texel_size, precision)
    return Estimate(maps_of(mean, height, texel_size), log_error)


def _parameters(prediction: Estimate, channels: int) -> Tensor:
    """(PARAMETERS or more, H, W) parameters of a prediction with this many channels of F0."""
    maps = prediction.maps
    specular = maps.specular.expand(channels, -1, -1) if len(maps.specular) == 1 else maps.specular
    return parameters_of(replace(maps, specular=specular))


def _precisions(predictions: Sequence[Estimate]) -> Tensor:
    """(n, 4, H, W) 1 / sigma^2 of predictions."""
    return torch.stack([(-2.0 * one.log_error.clamp(-8.0, 8.0)).exp() for one in predictions])


def _fused_error(precisions: Tensor) -> Tensor:
    """(4, H, W) log standard deviation of the mean of predictions (n, 4, H, W)."""
    # The common part of the error variance is that of the best prediction.
    common = precisions.amax(0).reciprocal()
    return 0.5 * (_SHARED * common + (1.0 - _SHARED) / precisions.sum(0)).log()


def with_others(first: Estimate, predictions: Sequence[Estimate]) -> Estimate:
    """The first photograph's prediction plus the upsampled change by fusion with the others.

    Detail finer than the grid of fusion stays the first photograph's. Its predicted height does not
    extend beyond it: slopes are integrated.

    Args:
        first: prediction of the first photograph.
        predictions: of all photographs on the grid of fusion, the first one first.
    """
    together, alone = fused(predictions), _fused_error(_precisions(predictions[:1]))

    def wide(change: Tensor) -> Tensor:
        return F.interpolate(change[None], size=first.maps.size[::-1], mode="bilinear")[0]

    channels, texel_size = len(together.maps.specular), first.maps.texel_size
    change = _parameters(together, channels) - _parameters(predictions[0], channels)
    parameters = _parameters(first, channels) + wide(change)
    height = integrated(parameters[SLOPES], texel_size)
    log_error = first.log_error + wide(together.log_error - alone)
    return Estimate(maps_of(parameters, height, texel_size), log_error)


def spread_over(prediction: Estimate, margins: Margins) -> Estimate:
    """Extrapolate the first photograph's estimate smoothly over the margins.

    Its error there is the standard deviation of the parameters within the first photograph.

    Args:
        prediction: on the first photograph's grid.
        margins: of the mosaic.
    """
    if not margins.any:
        return prediction
    own = margins.own(prediction.maps.size)
    known = own.numpy()
    padded = margins.padded(prediction.maps.stacked().float()).numpy()
    wide = torch.from_numpy(np.stack([filled(plane, known) for plane in padded]))
    beyond = scatter(prediction)[:, None, None]
    log_error = torch.where(own, margins.padded(prediction.log_error), beyond)
    return Estimate(MapSet.from_stacked(wide, prediction.maps.texel_size), log_error)


def scatter(prediction: Estimate) -> Tensor:
    """(4,) log standard deviation over the exemplar of each map's parameter, errors included."""
    parameters = parameters_of(prediction.maps)
    parts = (parameters[ALBEDO].mean(0), parameters[F0], parameters[ROUGH], parameters[SLOPES])
    variance = torch.stack([part.std() for part in parts]).square()
    error_variance = (2.0 * prediction.log_error.clamp(-8.0, 2.0)).exp().mean((1, 2))
    return 0.5 * (variance + error_variance).log()


def unpredicted(log_error: Tensor, mosaic: Mosaic) -> Tensor:
    """Log errors (4, H, W) set to UNPREDICTED beyond the first photograph."""
    return torch.where(mosaic.margins.own(mosaic.size), log_error, torch.tensor(UNPREDICTED))
