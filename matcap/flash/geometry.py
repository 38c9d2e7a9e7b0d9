"""Geometry of a flash photograph: camera, flash, plane, and the exemplar's extent on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

# Geometry of a flash photograph: camera, flash and plane.
#
# Two frames share the origin, the point of the plane on the optical axis:
#
# - the *camera frame*: camera at (0, 0, d) looking down -z, x right, y up; d = 1 / tan(fov / 2);
# - the *plane frame*: the plane is z = 0. A point p of it is R p in the camera frame,
# R = Ry(tilt_y) Rx(tilt_x), right-handed. Positive tilt_x turns the plane's upper edge towards
# the camera, positive tilt_y its left edge.
#
# Plane units are half of the long side of the photographed rectangle. Maps are in the plane frame,
# so a tilted photograph is rectified before it is compared with them.


@dataclass(frozen=True)
class FlashSetup:
    """Camera and flash of one photograph."""

    fov: float = 45.0
    """Field of view across the long side, in degrees."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the flash relative to the camera, plane units, camera frame."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """(tilt_x, tilt_y) in radians."""
    intensity: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Radiant intensity of the flash by channel; proportional to the picture's radiance."""
    vignetting: float = 0.0
    """a of the falloff exp(-a s - b s^2), with s = (r / 1.25)^2, 1 in the corner of a 4:3 picture.
    May be negative, as tone mapping changes it."""
    vignetting_quartic: float = 0.0
    """b of the falloff; large for a flash that lights a cone."""
    vignetting_centre: tuple[float, float] = (0.0, 0.0)
    """Image coordinates from which r is measured: a flash need not light along the lens's axis."""
    vignetting_colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to a in each channel, with mean 0: white LEDs are yellower off their axis."""
    turned: bool = False
    """The photograph is a portrait: both frames are those of the picture rotated 90 degrees
    anticlockwise, to landscape, but maps are upright."""

    @property
    def distance(self) -> float:
        """d, from the camera to the origin, in plane units."""
        return 1.0 / math.tan(math.radians(self.fov) / 2.0)

    def with_intensity(self, intensity: tuple[float, float, float]) -> FlashSetup:
        """This setup with another radiant intensity of the flash."""
        return replace(self, intensity=intensity)

    def dimmed(self, factor: float) -> FlashSetup:
        """The same setup with the flash's intensity divided by `factor`."""
        red, green, blue = (channel / factor for channel in self.intensity)
        return self.with_intensity((red, green, blue))


def to_upright(setup: FlashSetup, vector: Tensor) -> Tensor:
    """Rotate a vector (3,) from a setup's plane frame to that of its maps, upright if turned."""
    return torch.stack([vector[1], -vector[0], vector[2]]) if setup.turned else vector


def setup_rotation(setup: FlashSetup, dtype: torch.dtype = torch.float64) -> Tensor:
    """(3, 3) R = Ry(tilt_y) Rx(tilt_x) of a setup, plane frame to camera frame."""
    tilt_x, tilt_y = (torch.tensor(angle, dtype=dtype) for angle in setup.tilt)
    cx, sx, cy, sy = tilt_x.cos(), tilt_x.sin(), tilt_y.cos(), tilt_y.sin()
    zero = torch.zeros_like(cx)
    return torch.stack(
        [
            torch.stack([cy, sy * sx, sy * cx]),
            torch.stack([zero, cx, -sx]),
            torch.stack([-sy, cy * sx, cy * cx]),
        ]
    )


def camera_in_plane(setup: FlashSetup) -> tuple[Tensor, Tensor]:
    """Positions of camera and flash in the plane frame, two float64 (3,) tensors."""
    turn = setup_rotation(setup)
    camera = torch.tensor([0.0, 0.0, setup.distance], dtype=torch.float64)
    light = camera + torch.tensor(setup.offset, dtype=torch.float64)
    return turn.T @ camera, turn.T @ light


def flash_mirror_point(setup: FlashSetup) -> tuple[float, float]:
    """(x, y) of the mirror point, where a mirror in the plane shows the flash; plane units."""
    camera, light = camera_in_plane(setup)
    share = camera[2] / (camera[2] + light[2])
    x, y = (camera + share * (light - camera))[:2].tolist()
    return x, y


def plane_points(
    x: int, y: int, width: int, height: int, extent: tuple[int, int], *, dtype: torch.dtype
) -> Tensor:
    """(3, height, width) plane points of a rectangle of texels of a picture-sized grid.

    The grid has `extent` = (W, H) texels, W along x in [-1, 1]; texel (0, 0) is the top left one
    and its centre lies half a texel inside. The rectangle may extend beyond the grid.
    """
    grid_width, grid_height = extent
    texel = 2.0 / grid_width
    xs = (torch.arange(x, x + width, dtype=dtype) + 0.5 - grid_width / 2.0) * texel
    ys = (grid_height / 2.0 - torch.arange(y, y + height, dtype=dtype) - 0.5) * texel
    return torch.stack(
        [
            xs.expand(height, width),
            ys[:, None].expand(height, width),
            torch.zeros(height, width, dtype=dtype),
        ]
    )


def project(points: Tensor, setup: FlashSetup) -> Tensor:
    """(2, ...) image coordinates (u right, v up; long side in [-1, 1]) of (3, ...) plane points."""
    in_camera = torch.tensordot(setup_rotation(setup, points.dtype), points, dims=1)
    distance = setup.distance
    return in_camera[:2] * (distance / (distance - in_camera[2]))


def unproject(image: Tensor, setup: FlashSetup) -> Tensor:
    """(3, ...) plane points seen at (2, ...) image coordinates; the inverse of project()."""
    turn = setup_rotation(setup, image.dtype)
    distance = setup.distance
    normal = turn[:, 2]
    ray = torch.cat([image, torch.full_like(image[:1], -distance)])
    # n . (camera + t ray) = 0, the plane passing through the origin.
    along = -(normal[2] * distance) / torch.tensordot(normal, ray, dims=1)
    point = along * ray
    point = torch.cat([point[:2], point[2:] + distance])
    return torch.tensordot(turn.T, point, dims=1)


# Extent of the exemplar on the plane: the first photograph's rectangle, or larger.
#
# Plane units are the first photograph's whatever the rectangle: half of its long side.


@dataclass(frozen=True)
class Extent:
    """A rectangle of the plane, covered by square texels."""

    middle: tuple[float, float] = (0.0, 0.0)
    """(x, y) of its centre, plane units."""
    half: float = 1.0
    """Half of its width, plane units."""

    def texel(self, across: int) -> float:
        """Side of a texel, plane units, of a grid of `across` texels."""
        return 2.0 * self.half / across

    def unit(self, across: int) -> float:
        """Texels along the first photograph's long side, of a grid of `across` texels."""
        return across / self.half

    def across(self, unit: float) -> int:
        """The inverse of unit(), rounded."""
        return round(unit * self.half)

    def placed(self, points: Tensor) -> Tensor:
        """Map plane points (3, ...) of a grid over OWN to this rectangle."""
        middle = torch.tensor([*self.middle, 0.0], dtype=points.dtype)
        middle = middle.reshape(3, *(1,) * (points.ndim - 1))
        return points if self == OWN else self.half * points + middle


OWN = Extent()


def points_of(
    size: torch.Size | tuple[int, ...],
    rows: slice = slice(None),
    extent: Extent = OWN,
    columns: slice = slice(None),
) -> Tensor:
    """(3, h, w) plane points of a grid (height, width), or of some rows and columns of it."""
    height, width = size
    line = plane_points(0, 0, width, 1, (width, height), dtype=torch.float32)[0, :, columns]
    column = plane_points(0, 0, 1, height, (width, height), dtype=torch.float32)[1, rows]
    x, y = torch.broadcast_tensors(line, column)
    return extent.placed(torch.stack([x, y, torch.zeros(x.shape)]))


@dataclass(frozen=True)
class Margins:
    """Margins of a mosaic around the first photograph's grid, texels."""

    left: int = 0
    right: int = 0
    top: int = 0
    bottom: int = 0

    @property
    def any(self) -> bool:
        """Whether any margin is not 0."""
        return max(self.left, self.right, self.top, self.bottom) > 0

    def around(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the mosaic around a grid of `size` = (width, height)."""
        return size[0] + self.left + self.right, size[1] + self.top + self.bottom

    def extent(self, across: int) -> Extent:
        """Extent of the mosaic, the first photograph's grid being `across` texels wide."""
        middle = (self.right - self.left) / across, (self.top - self.bottom) / across
        return Extent(middle, (across + self.left + self.right) / across)

    def turned(self) -> Margins:
        """Margins of the mosaic rotated 90 degrees clockwise."""
        return Margins(self.bottom, self.top, self.left, self.right)

    def inside_of(self, shape: tuple[int, int]) -> tuple[int, int]:
        """(rows, columns) of the first photograph's grid, from those of the mosaic."""
        return shape[0] - self.top - self.bottom, shape[1] - self.left - self.right

    def padded(self, planes: Tensor, value: float = 0.0) -> Tensor:
        """Pad (..., h, w) on the first photograph's grid to the mosaic's (..., H, W)."""
        return F.pad(planes, (self.left, self.right, self.top, self.bottom), value=value)

    def inside(self, size: tuple[int, int]) -> tuple[slice, slice]:
        """Slices of rows and columns of the first photograph's grid (width, height)."""
        return (slice(self.top, self.top + size[1]), slice(self.left, self.left + size[0]))

    def own(self, size: tuple[int, int]) -> Tensor:
        """(H, W) bool on the mosaic: the first photograph's grid of (width, height) texels."""
        return self.padded(torch.ones(size[::-1], dtype=torch.bool))
