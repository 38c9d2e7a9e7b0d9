"""Camera rays and the lens's vignetting; vectors, and samples of visible normals."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from matcap.relight.scene import Camera, Film

# Vectors as tuples of three arrays that broadcast against each other.
#
# On a plane seen from straight above x is (1, W), y (H, 1) and z (1, 1), and arithmetic is cheap
# accordingly.

# Of any dtype: the functions below keep it.
Array = NDArray[Any]
Vec = tuple[Array, Array, Array]


def vec(vector: tuple[float, float, float]) -> Vec:
    """A constant vector as three 0-d float32 arrays."""
    x, y, z = (np.asarray(c, dtype=np.float32) for c in vector)
    return x, y, z


def dot(a: Vec, b: Vec) -> Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def scale(a: Vec, factor: Array | float) -> Vec:
    """Every component times a factor."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def add(a: Vec, b: Vec) -> Vec:
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vec, b: Vec) -> Vec:
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def unit3(vector: tuple[float, float, float]) -> NDArray[np.float64]:
    """(3,) float64 unit vector."""
    array = np.asarray(vector, dtype=np.float64)
    return array / np.linalg.norm(array)


# Sample points for GGX's visible normals [dupuy2023].
#
# Light from the direction in which a sampled normal mirrors the view counts F G2 / G1 (lobe_of and
# mirrored in loops/loops.h). All pixels use the same points, a Fibonacci lattice [sloan1994] made
# denser towards the lobe's rim: pictures have no noise. On smooth environments 144 such points are
# as accurate as about 600 of an R2 sequence.

_FIBONACCI = (34, 55, 89, 144, 233, 377, 610, 987, 1597, 2584, 4181)


class LatticePoint(NamedTuple):
    """One sample: height on the spherical cap, cosine and sine of azimuth, quadrature weight."""

    u: float
    cosine: float
    sine: float
    weight: float


@lru_cache(maxsize=8)
def lattice(count: int) -> tuple[LatticePoint, ...]:
    """A lattice of `count` points, rounded up to a Fibonacci number <= 4181; weights sum to 1."""
    index = min(bisect_left(_FIBONACCI, count), len(_FIBONACCI) - 1)
    size = _FIBONACCI[index]
    before = round(size / 1.618033988749895)
    points = []
    for i in range(size):
        rest = 1.0 - (i + 0.5) / size
        angle = 2.0 * math.pi * ((i * before / size) % 1.0)
        # u = 1 - (1 - t)^2 with weight du/dt: denser towards u = 1, the rim.
        weight = 2.0 * rest / size
        points.append(LatticePoint(1.0 - rest * rest, math.cos(angle), math.sin(angle), weight))
    return tuple(points)


# Camera rays through pixel centres, and the lens's vignetting.

# Squared radius of a 4:3 picture's corner, with its long side in [-1, 1]: vignetting's r = 1.
_CORNER_SQUARED = 1.25**2


@dataclass(frozen=True)
class View:
    """A camera at a position with orthonormal axes, and the pixel grid of its picture."""

    position: Array
    """(3,) in plane units."""
    axes: Array
    """(3, 3) unit rows right, up and forward."""
    reach: float
    """Half the picture's long side: at distance 1 (perspective), or in plane units."""
    size: tuple[int, int]
    """(width, height) in pixels."""
    camera: Camera
    """Projection and vignetting."""
    columns: tuple[int, int] | None = None
    """Half-open range of columns that rays are generated for; None is all."""

    @property
    def perspective(self) -> bool:
        """Whether rays start in `position`; else they are parallel."""
        return self.camera.type == "perspective"

    @property
    def across(self) -> tuple[int, int]:
        """Half-open range of columns that rays are generated for."""
        return self.columns or (0, self.size[0])

    @property
    def pixel(self) -> float:
        """A pixel's side: at distance 1 (perspective), or in plane units."""
        return 2.0 * self.reach / max(self.size)

    def part(self, left: int, right: int) -> View:
        """The same view with rays for a half-open range of columns."""
        return replace(self, columns=(left, right))

    def screen(self, top: int, bottom: int) -> tuple[Array, Array]:
        """(1, W) and (bottom - top, 1) offsets of pixel centres along right and up.

        The picture's long side spans [-reach, reach].
        """
        width, height = self.size
        half = max(width, height) / 2.0
        across = (np.arange(*self.across) + 0.5 - width / 2.0) / half * self.reach
        down = (height / 2.0 - np.arange(top, bottom) - 0.5) / half * self.reach
        return across[None, :], down[:, None]

    def share(self, top: int, bottom: int) -> Array:
        """(3, bottom - top, W) vignetting: exp(-(v r^2 + q r^4)), r = 1 in corners of 4:3."""
        offsets = zip(self.screen(top, bottom), self.camera.vignetting_centre, strict=True)
        across, down = (place / self.reach - middle for place, middle in offsets)
        squared = (across * across + down * down) / _CORNER_SQUARED
        quartic = self.camera.vignetting_quartic * squared
        exponents = [squared * (first + quartic) for first in self._vignetting]
        return np.exp(-np.stack(exponents)).astype(np.float32)

    @property
    def vignetted(self) -> bool:
        """Whether the lens loses any light."""
        return any(self._vignetting) or self.camera.vignetting_quartic != 0.0

    @property
    def _vignetting(self) -> list[float]:
        """Coefficient v of the three channels."""
        return [self.camera.vignetting + more for more in self.camera.vignetting_colour]

    @property
    def brightest(self) -> float:
        """Largest factor of the vignetting in the picture, above 1 where the lens brightens."""
        return max(map(self._brightest, self._vignetting))

    def _brightest(self, first: float) -> float:
        """Largest factor in a channel of which v is `first`."""
        sides = zip(self.size, self.camera.vignetting_centre, strict=True)
        farthest = (side / max(self.size) + abs(centre) for side, centre in sides)
        corner = sum(side * side for side in farthest) / _CORNER_SQUARED
        second = self.camera.vignetting_quartic
        # The exponent is a parabola in r^2: extreme at centre, corner, or its vertex.
        turn = -0.5 * first / second if second else 0.0
        places = (0.0, corner, min(max(turn, 0.0), corner))
        return max(math.exp(-s * (first + second * s)) for s in places)

    def rays(self, top: int, bottom: int) -> tuple[Array, Array]:
        """Origins and unit directions of the rays of rows, (3, bottom - top, W) each."""
        across, down = self.screen(top, bottom)
        across, down = np.broadcast_arrays(across, down)
        right, up, forward = (axis[:, None, None] for axis in self.axes)
        offset = right * across + up * down
        place = self.position[:, None, None]
        if self.perspective:
            direction = forward + offset
            length = np.sqrt((direction * direction).sum(axis=0))
            return np.broadcast_to(place, offset.shape), direction / length
        return place + offset, np.broadcast_to(forward, offset.shape)


def view_of(camera: Camera | None, film: Film, long_side: float) -> View:
    """The view of a camera.

    None stands for the photograph's: it looks straight down, 45 degrees across the long side, from
    the distance at which that spans `long_side` plane units.
    """
    size = (film.width, film.height)
    if camera is None:
        reach = math.tan(math.radians(22.5))
        place = np.array([0.0, 0.0, long_side / 2.0 / reach])
        return View(place, np.diag([1.0, 1.0, -1.0]), reach, size, Camera())
    place = np.asarray(camera.position, dtype=np.float64)
    forward = unit3(tuple(np.asarray(camera.target) - place))
    upright = unit3(camera.up)
    # A camera that looks along `up` has -z at the top of its picture; along z, y.
    if abs(forward @ upright) >= 1.0 - 1e-9:
        upright = np.array([0.0, 1.0, 0.0] if abs(forward[2]) >= 1.0 - 1e-9 else [0.0, 0.0, -1.0])
    right = np.cross(forward, upright)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    angle = math.radians(camera.fov / 2.0)
    reach = math.tan(angle) if camera.type == "perspective" else camera.scale
    return View(place, axes, reach, size, camera)
